"""Pictures located on a map: an orthophoto with its elevation."""

from __future__ import annotations

import collections.abc
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arrays, _core
from ._models import default_model, folders
from ._results import Status

Floats = npt.NDArray[np.float64]
Corner = tuple[float, float, float, float]
Numbers = collections.abc.Sequence[float]


@dataclass(frozen=True)
class Located:
    """Where a picture was taken (docs/guide/locate.md). Map: x east, y north, z up, m."""

    status: Status
    reason: str  #: the status in words
    T_WC: Floats  #: 4 x 4, camera (x right, y down, z forward) to map; only valid if converged
    covariance: Floats  #: 6 x 6 of [rho, phi], T_WC = mean Exp(xi), in the camera's frame; NaN unless converged
    rivals: list[Floats]  #: T_WC of other poses that fit as well; only with the status "ambiguous"
    model: str  #: that answered
    hypotheses: int  #: poses that were compared
    rounds: int  #: views rendered for this answer
    inliers: int  #: features that agree with the pose
    visible: int  #: features that lie in the picture
    sigma: float  #: px, robust standard deviation of the reprojection residuals

    @property
    def converged(self) -> bool:
        """True if pose and covariance are valid."""
        return self.status == "converged"

    @property
    def position(self) -> Floats:
        """Of the camera on the map, m."""
        return self.T_WC[:3, 3]


@dataclass(frozen=True)
class SequencePose:
    """Where a frame of a sequence was taken."""

    time: float  #: s
    located: Located  #: on the map, without the other frames
    known: bool  #: whether T_WC is: from the map, or by the motion from frames that were located
    T_WC: Floats  #: 4 x 4, camera to map, by all that is known
    covariance: Floats  #: 6 x 6 of [rho, phi]; NaN unless known

    @staticmethod
    def _of(fields: dict[str, Any]) -> SequencePose:
        return SequencePose(**{**fields, "located": Located(**fields["located"])})


class Sequence:
    """Frames that follow each other, from ``Map.sequence``. Frames that the map does not show get a pose by their motion."""

    def __init__(self, core: _core.Map, K: Any, masks: bool) -> None:
        self._map, self._intrinsics, self._masks = core, _arrays.intrinsics(K), masks
        self._core: _core.Sequence | None = None

    def locate(
        self,
        image: Any,
        time: float,
        T_WC: Any = None,
        *,
        sigma: tuple[float, float] = (10.0, 5.0),
        height_sigma: float | None = None,
        heading_sigma: float | None = None,
        mask: Any = None,
    ) -> SequencePose:
        """The next frame, with its live pose. The first frame needs an approximate pose; later ones may have one.

        time: s, later than that of the frame before. Other arguments: as for ``Map.locate``. Raises what that raises, and
        ValueError for a first frame without T_WC.
        """
        pixels = _arrays.image(image, "image")
        if self._core is None:
            self._core = _core.Sequence(self._map, self._intrinsics, pixels.shape[1], pixels.shape[0], self._masks)
        where = None if T_WC is None else _arrays.pose(T_WC, "T_WC")
        hidden = None if mask is None else _arrays.mask(mask, "mask")
        sigmas = _sigmas(sigma, height_sigma, heading_sigma)
        return SequencePose._of(self._core.locate(float(time), pixels, where, sigmas, hidden))

    def all(self) -> list[SequencePose]:
        """The poses of all frames so far, from all frames: what came later also counts."""
        return [] if self._core is None else [SequencePose._of(fields) for fields in self._core.all()]


class Map:
    """An orthophoto with its elevation, in memory.

    ortho: H x W or H x W x 3 (RGB) or x 4 (alpha 0: no data), uint8. elevation: H x W metres, NaN: no data; its grid may be
    another one. Their places are GDAL geotransforms ``(left, step, 0, top, 0, -step)`` in one projected system in metres, with
    north up. Instead of arrays, both may be paths of GeoTIFFs, which rasterio reads (``pip install 'iclk[maps]'``). model,
    device: as for ``iclk.Aligner``, but not device "cpu". Raises ValueError for arrays, geotransforms and heights that do not
    fit together, and what ``iclk.Aligner`` raises.
    """

    def __init__(
        self,
        ortho: Any,
        elevation: Any,
        geotransform: Numbers | None = None,
        elevation_geotransform: Numbers | None = None,
        *,
        model: str | None = None,
        device: str | int | None = None,
    ) -> None:
        if device == "cpu":
            raise _arrays.refuse('rendering needs Vulkan: device="cpu" does not work, but lavapipe (mesa-vulkan-drivers) does')
        if isinstance(ortho, (str, os.PathLike)) and isinstance(elevation, (str, os.PathLike)):
            ortho, geotransform, elevation, elevation_geotransform = _read(ortho, elevation)
        pixels, heights = _mosaic(ortho), np.ascontiguousarray(_arrays.array(elevation, "elevation"), np.float32)
        if heights.ndim != 2:
            raise _arrays.refuse(f"elevation has the shape {heights.shape}; give H x W heights in metres")
        corner = _corner(geotransform, "geotransform")
        self._corner = corner if elevation_geotransform is None else _corner(elevation_geotransform, "elevation_geotransform")
        chosen = default_model() if model is None else model
        self._core = _core.Map(pixels, corner, heights, self._corner, chosen, "" if device is None else str(device), folders())

    def locate(
        self,
        image: Any,
        K: Any,
        T_WC: Any,
        *,
        sigma: tuple[float, float] = (10.0, 5.0),
        height_sigma: float | None = None,
        heading_sigma: float | None = None,
        mask: Any = None,
    ) -> Located:
        """Finds where a picture was taken. A picture that cannot be located has a status; it raises no exception.

        image: H x W or H x W x 3 (RGB), undistorted. K: 3 x 3, or fx, fy, cx, cy. T_WC: the approximate pose, 4 x 4, camera to
        map. sigma: its standard deviations, m and degrees. height_sigma (m) and heading_sigma (degrees; 180: unknown) are those
        of sigma unless they are given. mask: H x W; pixels that are 0 are not used. Raises ValueError for wrong shapes and
        values, and ``iclk.Error`` for a lost device.
        """
        sigmas = _sigmas(sigma, height_sigma, heading_sigma)
        hidden = None if mask is None else _arrays.mask(mask, "mask")
        where = _arrays.pose(T_WC, "T_WC")
        return Located(**self._core.locate(_arrays.image(image, "image"), _arrays.intrinsics(K), where, sigmas, hidden))

    def sequence(self, K: Any, *, masks: bool = False) -> Sequence:
        """Starts a sequence of frames of one camera. masks: frames may have masks."""
        return Sequence(self._core, K, masks)

    def view(self, T_WC: Any, K: Any, width: int, height: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        """Renders the map from a pose: H x W x 3 uint8 RGB, and H x W metres along the optical axis, 0 without ground."""
        rgb, depth = self._core.view(_arrays.pose(T_WC, "T_WC"), _arrays.intrinsics(K), width, height)
        return rgb, depth

    def ground(
        self, located: Located, K: Any, width: int, height: int, uv: Any, *, elevation_sigma: float | None = None
    ) -> tuple[Floats, Floats]:
        """Places on the ground that pixels of a located picture show: N x 3 (m) and their covariances, N x 3 x 3.

        uv: N x 2 pixels of the undistorted picture. elevation_sigma: standard deviation of the heights, m; default: a quarter
        of their spacing. NaN where the map has no ground. Raises ValueError unless the picture was located.
        """
        if not located.converged:
            raise _arrays.refuse(f"the picture was not located: {located.status}")
        spread = max(self._corner[2:]) / 4 if elevation_sigma is None else float(elevation_sigma)
        covariance = np.ascontiguousarray(located.covariance).reshape(-1, 2)
        at = _arrays.points(uv, "uv")
        X, C = self._core.ground(
            _arrays.pose(located.T_WC, "T_WC"), covariance, _arrays.intrinsics(K), width, height, at, spread
        )
        return X, C


def _sigmas(
    sigma: tuple[float, float], height: float | None, heading: float | None
) -> tuple[float, float, float, float]:
    """m, m, rad, rad."""
    metres, degrees = sigma
    return (
        float(metres),
        float(metres if height is None else height),
        float(np.radians(degrees)),
        float(np.radians(degrees if heading is None else heading)),
    )


def _mosaic(ortho: Any) -> npt.NDArray[np.uint8]:
    pixels = _arrays.array(ortho, "ortho")
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] not in (3, 4)):
        raise _arrays.refuse(f"ortho is {pixels.dtype} {pixels.shape}; give uint8, H x W, H x W x 3 or H x W x 4")
    out = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    channels = pixels.shape[2] if pixels.ndim == 3 else 3
    out[..., :channels] = pixels if pixels.ndim == 3 else pixels[..., None]
    out[..., 3] = np.where(out[..., 3] < 128, 0, 255)
    out[out[..., 3] == 0] = 0
    return out


def _corner(geotransform: Numbers | None, name: str) -> Corner:
    if geotransform is None or len(geotransform) != 6:
        raise _arrays.refuse(f"{name} must have six numbers: left, step, 0, top, 0, -step")
    left, step_x, turn_x, top, turn_y, step_y = (float(x) for x in geotransform)
    if turn_x or turn_y or not step_x > 0 or not step_y < 0:
        raise _arrays.refuse(f"{name} {tuple(geotransform)} is not one with north up: left, step, 0, top, 0, -step")
    return left, top, step_x, -step_y


def _read(ortho: Any, elevation: Any) -> tuple[Any, Numbers, Any, Numbers]:
    try:
        import rasterio
    except ImportError:
        raise _arrays.refuse("paths of maps need rasterio (pip install 'iclk[maps]'); or give arrays") from None
    with rasterio.open(ortho) as picture, rasterio.open(elevation) as relief:
        for path, crs in ((ortho, picture.crs), (elevation, relief.crs)):
            metric = crs and crs.is_projected and crs.linear_units_factor[1] == 1 and crs.to_dict().get("proj") != "merc"
            if not metric or crs != picture.crs:
                raise _arrays.refuse(f"{path} is in {crs}: both maps must be in one projected system with metres on the "
                                     "ground; `iclk locate` takes others")
        if relief.units[0] not in (None, "", "m", "metre", "meter", "metres", "meters"):
            raise _arrays.refuse(f"{elevation} has heights in {relief.units[0]!r}; convert them to metres")
        bands = np.moveaxis(picture.read(range(1, min(picture.count, 3) + 1)), 0, -1)
        pixels = np.dstack([np.broadcast_to(bands, (*bands.shape[:2], 3)), picture.dataset_mask()])
        heights = relief.read(1, masked=True).astype(np.float64) * relief.scales[0] + relief.offsets[0]
        return pixels, picture.transform.to_gdal(), heights.filled(np.nan), relief.transform.to_gdal()
