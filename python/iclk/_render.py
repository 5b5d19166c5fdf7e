"""Rendered views of a procedural landscape, with depth and poses: for examples, tests, and training."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays, _core

Floats = npt.NDArray[np.float64]


class RenderedPair(NamedTuple):
    """Two views with their true depth and poses."""

    reference: npt.NDArray[np.uint8]  #: H x W x 3, RGB
    target: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]  #: H x W, of the reference, m; 0: no ground
    T_10: Floats  #: 4 x 4, camera 0 to camera 1
    T_W0: Floats  #: camera to map
    T_W1: Floats


class Terrain:
    """A procedural landscape of hills, fields, villages and woods, rendered on a Vulkan device (docs/guide/render.md).

    size: m per side; making 128 m takes a second, 1024 m about ten. The map starts at (0, 0): x east, y north, z up. device:
    as for ``iclk.Aligner``, but not "cpu". Raises ValueError for an invalid size, ``iclk.Error`` without Vulkan.
    """

    def __init__(self, seed: int = 0, size: float = 256.0, device: str | int | None = None) -> None:
        if device == "cpu":
            raise _arrays.refuse('rendering needs Vulkan: device="cpu" does not work, but lavapipe (mesa-vulkan-drivers) does')
        self._core = _core.Terrain(seed, size, "" if device is None else str(device))

    def height_at(self, x: float, y: float) -> float:
        """Height of the ground, m; NaN outside the map."""
        return self._core.height_at(x, y)

    def render(self, T_WC: Any, K: Any, width: int, height: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """Renders a view: H x W x 3 uint8 RGB, and H x W metres along the optical axis, 0 where there is no ground.

        T_WC: 4 x 4, camera (x right, y down, z forward) to map. Raises ValueError for a camera at or below the ground.
        """
        rgb, depth = self._core.render(_arrays.pose(T_WC, "T_WC"), _arrays.intrinsics(K), width, height)
        return rgb, depth

    def pair(
        self,
        index: int,
        K: Any,
        width: int,
        height: int,
        *,
        altitude: tuple[float, float] = (40.0, 70.0),
        tilt: float = 0.26,
        translation: float = 2.0,
        rotation: float = 0.05,
        seed: int = 0,
    ) -> RenderedPair:
        """Renders pair ``index`` of the infinite set of a seed, drawn as by `iclk render --pairs`. Camera 0 looks down from an
        altitude (m above ground), tilted by up to ``tilt`` rad. Camera 1 is camera 0 after a motion of up to ``translation`` m
        and ``rotation`` rad per axis. Raises ValueError if a view does not fit into the map.
        """
        first, second, T_10, T_W0, T_W1 = self._core.pair(
            index, _arrays.intrinsics(K), width, height, *altitude, tilt, translation, rotation, seed
        )
        return RenderedPair(first[0], second[0], first[1], T_10, T_W0, T_W1)
