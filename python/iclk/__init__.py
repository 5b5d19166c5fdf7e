"""Six-degree-of-freedom image alignment with sparse depth, on any Vulkan device or the CPU.

    import iclk
    r = iclk.align(reference, target, uv, depth, K)   # images as arrays, N pixels of the reference and their depths
    if r.converged: print(r.T_10, r.covariance)

Poses ``T_10`` take points of camera 0 (reference) to camera 1 (target), X_1 = R X_0 + t; camera: x right, y down, z forward;
pixel centres at whole numbers; images of three channels are red, green, blue. Everything that can fail to align says so in a
status; wrong arguments raise ValueError, the machine's failures ``iclk.Error``.
"""

from ._align import Aligner, Options, Pair, align, detect
from ._core import version as __version__
from ._devices import devices
from ._errors import Error, InvalidArgument
from ._models import model_info
from ._results import Alignment, Attempt, Stage, Status

__all__ = [
    "Aligner",
    "Alignment",
    "Attempt",
    "Error",
    "InvalidArgument",
    "Options",
    "Pair",
    "Stage",
    "Status",
    "__version__",
    "align",
    "detect",
    "devices",
    "model_info",
]
