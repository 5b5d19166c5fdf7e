"""Views of a landscape that is made in code, with depth and poses: for examples, tests, and training."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import _arrays, _core

Floats = npt.NDArray[np.float64]


class RenderedPair(NamedTuple):
    """Two views with their truth."""

    reference: npt.NDArray[np.uint8]  #: H x W x 3, RGB
    target: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]  #: H x W, of the reference, m; 0: no ground
    T_10: Floats  #: 4 x 4, camera 0 to camera 1
    T_W0: Floats  #: camera to map
    T_W1: Floats


class Terrain:
    """Hills, fields, villages, woods, of a seed; rendered by ray casting on a Vulkan device (docs/guide/render.md).

    size: m of a side, 128 m take a second and 1024 some ten. The map begins at (0, 0): x east, y north, z up. device: as of
    ``iclk.Aligner``, but not "cpu". Raises ValueError for a size that cannot be, ``iclk.Error`` where there is no Vulkan.
    """

    def __init__(self, seed: int = 0, size: float = 256.0, device: str | int | None = None) -> None:
        if device == "cpu":
            raise _arrays.refuse('rendering needs Vulkan (lavapipe does): device="cpu" has none')
        self._core = _core.Terrain(seed, size, "" if device is None else str(device))

    def height_at(self, x: float, y: float) -> float:
        """Of the ground, m; NaN outside."""
        return self._core.height_at(x, y)

    def render(self, T_WC: Any, K: Any, width: int, height: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """What a camera sees: H x W x 3 uint8 RGB, and H x W metres along the optical axis, 0 where there is no ground.

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
        """Pair ``index`` of the endless set of a seed, as `iclk render --pairs` draws them: a camera that looks down from an
        altitude (m above ground), tilted by up to ``tilt`` rad, and one that is moved by up to ``translation`` m and
        ``rotation`` rad an axis. Raises ValueError where a view does not fit into the map.
        """
        first, second, T_10, T_W0, T_W1 = self._core.pair(
            index, _arrays.intrinsics(K), width, height, *altitude, tilt, translation, rotation, seed
        )
        return RenderedPair(first[0], second[0], first[1], T_10, T_W0, T_W1)
