"""Sequences: what `iclk track` does, a frame at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _arrays, _core
from ._models import folders

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TrackedFrame:
    """Where a frame was. World: the camera of its map's first keyframe."""

    time: float  #: s
    status: Literal["tracked", "keyframe", "lost"]  #: keyframe: tracked, and others will be aligned with it
    confirmed: bool  #: by the features; else the pose is the alignment's alone, and weaker
    reason: str
    map: int  #: poses of different maps have nothing to do with each other
    keyframe: int  #: it was aligned with; of a keyframe, itself
    T_CK: Floats  #: 4 x 4, camera of that keyframe to this one: stays while the keyframe's pose may still be adjusted
    T_WC: Floats  #: 4 x 4, this camera to the world, as it is known now; of a lost frame, the last one that was known
    covariance: Floats  #: 6 x 6 of T_CK, [rho, phi]; 0 if lost, and of a keyframe, whose T_CK is exact
    #: Of a keyframe: the other one that it was aligned with, T_CK of that one, and its covariance. None for a map's first
    origin: tuple[int, Floats, Floats] | None
    features: int  #: of that alignment, as are the three below
    visible: int
    inliers: int
    sigma: float  #: px, of its residuals
    #: Number and time of the frame that was tracked last, which became a keyframe after all; else None
    before: tuple[int, float] | None

    @property
    def lost(self) -> bool:
        """There is no pose."""
        return self.status == "lost"


class Tracker:
    """Visual odometry with depth: keyframes, windows of them adjusted together; docs/explain/tracking.md says how.

    K: 3 x 3, or fx, fy, cx, cy, of undistorted images. model: "classical", the name of a model or a path. device: as of
    ``iclk.Aligner``. solver: "device", "host" or "cpu". features: a keyframe. keyframes: held at most. window: newest that are
    adjusted together. min_visible: a frame that sees less of its keyframe's features becomes one. readout: s from an image's
    first row to its last, of a rolling shutter. depth_sigma: how wrong depths are, "structured-light", "stereo:PX,BASELINE",
    "1.5%" or "rendered"; "auto" is the default. masks: frames come with masks.

    The first frame says how large images are. One thread at a time. Raises ValueError for options that cannot be, and what
    ``iclk.Aligner`` raises.
    """

    def __init__(
        self,
        K: Any,
        *,
        model: str = "classical",
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
        self._model, self._solver = model, solver
        self._options = (features, keyframes, window, min_visible, readout, depth_sigma, masks)
        self._made: _core.Tracker | None = None
        self._state: bytes | None = None

    def _core_of(self, width: int, height: int) -> _core.Tracker:
        if self._made is None:
            made = _core.Tracker(
                self._intrinsics, width, height, self._model, self._solver, self._device, folders(), *self._options
            )
            if self._state is not None:
                made.restore(self._state)
            self._made, self._state = made, None
        return self._made

    def track(self, image: Any, depth: Any, stamp: float, mask: Any = None) -> TrackedFrame:
        """Where the camera was. A frame that is lost is a status.

        image: H x W or H x W x 3 (RGB), uint8, uint16 or float32. depth: H x W metres along the optical axis, 0 or NaN where
        there is none; or None. stamp: s, later than the frame before. mask: H x W, 0 where the image is not to be looked at.
        Raises ValueError for an image, depth or mask of another size, and a stamp that is not finite or not later.
        """
        pixels = _arrays.image(image, "image")
        core = self._core_of(pixels.shape[1], pixels.shape[0])
        metres = None if depth is None else _arrays.depth_map(depth, "depth")
        hidden = None if mask is None else _arrays.mask(mask, "mask")
        return TrackedFrame(**core.track(float(stamp), pixels, metres, hidden))

    def keyframe_poses(self) -> Floats:
        """K x 4 x 4: T_WC of all keyframes that ever were, as they are known now."""
        if self._made is None:
            return np.zeros((0, 4, 4))
        poses: Floats = self._made.keyframe_poses()
        return poses

    def state(self) -> bytes:
        """All that is known, some 0.5 MB a keyframe at 640x480: ``restore`` goes on from it, to the bit."""
        return self._made.state() if self._made is not None else (self._state or b"")

    def restore(self, state: bytes) -> None:
        """Into a tracker of the same camera and options. Raises ValueError for what ``state`` did not return."""
        if self._made is not None:
            self._made.restore(state)
        elif state:
            self._state = state
