"""Six-degree-of-freedom image alignment with sparse depth, on any Vulkan device or the CPU.

    import iclk
    r = iclk.align(reference, target, uv, depth, K)   # images as arrays, N pixels of the reference and their depths
    if r.converged: print(r.T_10, r.covariance)

Poses ``T_10`` take points of camera 0 (reference) to camera 1 (target), X_1 = R X_0 + t; camera: x right, y down, z forward;
pixel centres at whole numbers; images of three channels are red, green, blue. A pair that cannot be aligned has a status that
says why. Wrong arguments raise ValueError; failures of the machine raise ``iclk.Error``.
"""

from ._align import Aligner, Options, Pair, align, detect
from ._core import version as __version__
from ._depth import DepthMap, depth_map
from ._devices import Device, devices
from ._errors import Error, InvalidArgument
from ._locate import Located, Map, Sequence, SequencePose
from ._models import model_info
from ._render import RenderedPair, Terrain
from ._results import Alignment, Attempt, Rival, Stage, Status
from ._track import TrackedFrame, Tracker

__all__ = [
    "Aligner",
    "Alignment",
    "Attempt",
    "Rival",
    "DepthMap",
    "Device",
    "Error",
    "InvalidArgument",
    "Located",
    "Map",
    "Options",
    "Pair",
    "RenderedPair",
    "Sequence",
    "SequencePose",
    "Stage",
    "Status",
    "Terrain",
    "TrackedFrame",
    "Tracker",
    "__version__",
    "align",
    "depth_map",
    "detect",
    "devices",
    "model_info",
]
