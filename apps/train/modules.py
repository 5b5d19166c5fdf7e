"""Checks for Python modules; the message names the packages to install."""
import importlib.util
import sys

# Module: package of Debian, package of PyPI.
PACKAGES = {'torch': ('python3-torch', 'torch'), 'numpy': ('python3-numpy', 'numpy'),
            'cv2': ('python3-opencv', 'opencv-python')}


def need(*modules):
    """Ends the program with what to install if one of the modules is not there."""
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if not missing:
        return
    debian, pypi = (' '.join(names) for names in zip(*(PACKAGES.get(module, (module, module)) for module in modules)))
    print(f'{sys.argv[0]}: {sys.executable} has no module {", ".join(missing)}. On Debian: apt install {debian}, then '
          f'/usr/bin/python3 {" ".join(sys.argv)}; elsewhere, in a virtual environment: pip install {pypi}', file=sys.stderr)
    sys.exit(2)
