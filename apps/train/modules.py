"""What Python must bring, said in words instead of a traceback."""
import importlib.util
import sys


def need(*modules):
    """Ends the program with what to install if one of the modules is not there."""
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if not missing:
        return
    print(f'{sys.argv[0]}: {sys.executable} has no module {", ".join(missing)}. On Debian: apt install python3-torch '
          f'python3-numpy python3-opencv, then /usr/bin/python3 {" ".join(sys.argv)}; elsewhere, in an environment of yours: '
          'pip install torch numpy opencv-python', file=sys.stderr)
    sys.exit(2)
