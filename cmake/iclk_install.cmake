# Install rules of the libraries.
