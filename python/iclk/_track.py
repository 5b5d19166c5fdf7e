"""Tracking of sequences frame by frame, as `iclk track` does it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _arrays, _core
from ._models import default_model, folders

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TrackedFrame:
    """Pose of a frame. World: the camera of the first keyframe of its map."""

    time: float  #: s
    status: Literal["tracked", "keyframe", "lost"]  #: keyframe: tracked, and later frames are aligned with it
    confirmed: bool  #: by features; else the pose is from the alignment alone, and weaker
    reason: str
    map: int  #: poses of different maps are unrelated
    keyframe: int  #: that it was aligned with; for a keyframe, itself
    T_CK: Floats  #: 4 x 4, camera of that keyframe to this one; final, though the keyframe may still move
    T_WC: Floats  #: 4 x 4, this camera to the world, current estimate; for a lost frame, the last known pose
    covariance: Floats  #: 6 x 6 of T_CK, [rho, phi]; 0 if lost, and for a keyframe, whose T_CK is exact
    #: For a keyframe: the keyframe that it was aligned with, T_CK from there, and its covariance. None for the first of a map
    origin: tuple[int, Floats, Floats] | None
    features: int  #: in that alignment, like the next three
    visible: int
    inliers: int
    sigma: float  #: px, of its residuals
    #: Number and time of the previous frame, if it became a keyframe afterwards; else None
    before: tuple[int, float] | None

    @property
    def lost(self) -> bool:
        """True if there is no pose."""
        return self.status == "lost"


class Tracker:
    """Visual odometry with depth: keyframes, refined by windowed bundle adjustment; see docs/explain/tracking.md.

    K: 3 x 3, or fx, fy, cx, cy, of undistorted images. model, device: as for ``iclk.Aligner``; with "auto",
    the learned models place frames that the classical method cannot. solver: "device", "host" or "cpu". features: per keyframe.
    keyframes: most to keep. window: newest keyframes that are adjusted together. min_visible: a frame that sees a smaller share
    of its keyframe becomes a keyframe. readout: rolling shutter, s from the first row of an image to the last. depth_sigma:
    error of the depths, "structured-light" (default, and "auto"), "stereo:PX,BASELINE", "1.5%" or "rendered". masks: frames
    have masks.

    The first frame sets the image size. Use it from one thread at a time. Raises ValueError for invalid options, and what
    ``iclk.Aligner`` raises.
    """

    def __init__(
        self,
        K: Any,
        *,
        model: str | None = None,
        device: str | int | None = None,
        solver: str = "device",
        features: int = 200,
        keyframes: int = 32,
        window: int = 8,
        min_visible: float = 0.7,
        readout: float = 0.0,
        depth_sigma: str = "structured-light",
        masks: bool = False,
    ) -> None:
        self._intrinsics = _arrays.intrinsics(K)
        self._device = "" if device is None else str(device)
        self._model, self._solver = default_model() if model is None else model, solver
        self._options = (features, keyframes, window, min_visible, readout, depth_sigma, masks)
        self._made: _core.Tracker | None = None
        self._state: bytes | None = None
        self._starts = False

    def _core_of(self, width: int, height: int) -> _core.Tracker:
        if self._made is None:
            made = _core.Tracker(
                self._intrinsics, width, height, self._model, self._solver, self._device, folders(), *self._options
            )
            if self._state is not None:
                made.restore(self._state, self._starts)
            self._made, self._state = made, None
        return self._made

    def track(self, image: Any, depth: Any, stamp: float, mask: Any = None, *, features: Any = None) -> TrackedFrame:
        """Tracks the next frame. A frame that is lost has that status; it raises no exception.

        image: H x W or H x W x 3 (RGB), uint8, uint16 or float32. depth: H x W metres along the optical axis, 0 or NaN if
        unknown; or None. stamp: s, later than the frame before. mask: H x W; pixels that are 0 are ignored. features: points
        with known depth, used instead of ``depth``: N x 3 (u, v, depth) or N x 4 (with the standard deviation of the depth; 0:
        ``depth_sigma``). Those that cannot be used are left out. Raises ValueError for an image, depth or mask of another size,
        features of another shape or with an invalid sigma, and a stamp that is not finite or not later.
        """
        pixels = _arrays.image(image, "image")
        core = self._core_of(pixels.shape[1], pixels.shape[0])
        metres = None if depth is None else _arrays.depth_map(depth, "depth")
        hidden = None if mask is None else _arrays.mask(mask, "mask")
        given = None if features is None else _arrays.features(features, "features")
        return TrackedFrame(**core.track(float(stamp), pixels, metres, hidden, given))

    def keyframe_poses(self) -> Floats:
        """Returns T_WC of all keyframes so far, K x 4 x 4: current estimates."""
        if self._made is None:
            return np.zeros((0, 4, 4))
        poses: Floats = self._made.keyframe_poses()
        return poses

    def state(self) -> bytes:
        """Returns the whole state, about 0.5 MB per keyframe at 640x480. ``restore`` continues from it, bit for bit."""
        return self._made.state() if self._made is not None else (self._state or b"")

    def restore(self, state: bytes) -> None:
        """Restores a state of a tracker with the same camera and options. Raises ValueError for anything else."""
        self._restore(state, False)

    def start_in(self, state: bytes) -> None:
        """Starts a recording in the map of an earlier one, of which ``state`` is. The camera may be anywhere in it, and stamps
        start anew. `iclk track` writes the state as map.state. Raises ValueError as ``restore`` does.
        """
        self._restore(state, True)

    def _restore(self, state: bytes, starts: bool) -> None:
        if self._made is not None:
            self._made.restore(state, starts)
        elif state:
            self._state, self._starts = state, starts
