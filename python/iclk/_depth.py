"""Dense depth maps, as `iclk depth` computes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays, _core


class DepthMap(NamedTuple):
    """Depth of the pixels of the reference."""

    depth: npt.NDArray[np.float32]  #: H x W metres along the optical axis, 0: none
    confidence: npt.NDArray[np.float32]  #: H x W, 0 to 1: by how much the second-best plane is worse
    valid: float  #: share of pixels with depth
    near: float  #: range that was searched, m
    far: float
    planes: int
    status: str  #: "converged", "low_overlap", "degenerate" or "diverged", as for `iclk depth`: docs/guide/depth.md
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
    """Computes a dense depth map of an image from 1 to 8 other images with known poses; see docs/explain/depth.md.

    reference: H x W or H x W x 3 (RGB), uint8, uint16 or float32. views: pairs of such an image, of the same size, and its
    T_10: 4 x 4, takes points of the camera of the reference to the camera of the view, metres. K: 3 x 3, or fx, fy, cx, cy;
    view_K: K of the views, if it differs. near, far: depth range to search, m. uv (N x 2 px), depth (N): sparse depths of the
    reference; they are priors, and give the range if near and far are missing. planes: 0 means one per pixel of motion. fill:
    fill pixels without depth with the depth of the background around them. device: a Vulkan device; "cpu" does not work.

    Raises ValueError for a wrong shape or type, a view without motion, and an invalid range; ``iclk.Error`` without Vulkan.
    """
    if device == "cpu":
        raise _arrays.refuse('depth maps need Vulkan: device="cpu" does not work, but lavapipe (mesa-vulkan-drivers) does')
    if (uv is None) != (depth is None):
        raise _arrays.refuse("give both uv and depth, or neither")
    if near is None and far is not None:
        raise _arrays.refuse("far needs near; give both")
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
