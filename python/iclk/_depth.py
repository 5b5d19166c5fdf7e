"""Dense depth maps: what `iclk depth` does."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays, _core


class DepthMap(NamedTuple):
    """Of the reference's pixels."""

    depth: npt.NDArray[np.float32]  #: H x W metres along the optical axis, 0: none
    confidence: npt.NDArray[np.float32]  #: H x W, by how much the second best plane is worse, 0 to 1
    valid: float  #: share of pixels with depth
    near: float  #: where it was looked for, m
    far: float
    planes: int
    status: str  #: "converged", "low_overlap", "degenerate" or "diverged", as `iclk depth` says it: docs/guide/depth.md
    reason: str


def depth_map(
    reference: Any,
    views: Iterable[tuple[Any, Any]],
    K: Any,
    *,
    near: float | None = None,
    far: float | None = None,
    uv: Any = None,
    depth: Any = None,
    view_K: Any = None,
    planes: int = 0,
    fill: bool = False,
    device: str | int | None = None,
) -> DepthMap:
    """A dense depth map of an image from 1 to 8 others whose poses are known; docs/explain/depth.md says how.

    reference: H x W or H x W x 3 (RGB), uint8, uint16 or float32. views: pairs of such an image, of the same size, and its
    T_10, 4 x 4, which takes points of the reference's camera to its own, metres. K: 3 x 3, or fx, fy, cx, cy; view_K: the
    views', where it is another. near, far: m, between which depth is looked for; or uv (N x 2 px) and depth (N), sparse depths
    of the reference, which are priors and say the range where near and far do not. planes: 0: one a pixel of motion. fill:
    pixels without an answer get the depth of what lies behind around them. device: of Vulkan; there is no depth on "cpu".

    Raises ValueError for another shape or type, a view that did not move, a range that is none; ``iclk.Error`` where there is
    no Vulkan.
    """
    if device == "cpu":
        raise _arrays.refuse('depth maps need Vulkan (lavapipe does): device="cpu" has none')
    if (uv is None) != (depth is None):
        raise _arrays.refuse("uv and depth go together")
    if near is None and far is not None:
        raise _arrays.refuse("far without near")
    at = np.zeros((0, 2)) if uv is None else _arrays.points(uv, "uv")
    q = np.zeros(0) if depth is None else _arrays.inverse(_arrays.vector(_arrays.depths(depth, "depth"), "depth"))
    if near is not None and not near > 0:
        raise _arrays.refuse(f"near {near} must be positive")
    intrinsics = _arrays.intrinsics(K)
    others = intrinsics if view_K is None else _arrays.intrinsics(view_K)
    sources = [
        (_arrays.image(image, f"view {i}"), _arrays.pose(T_10, f"view {i}: T_10"), others)
        for i, (image, T_10) in enumerate(views)
    ]
    found = _core.depth_map(
        _arrays.image(reference, "reference"),
        intrinsics,
        sources,
        0.0 if near is None else float(near),
        np.inf if far is None else float(far),
        at,
        q,
        planes,
        fill,
        "" if device is None else str(device),
    )
    return DepthMap(*found)
