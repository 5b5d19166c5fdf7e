"""Pictures located on a map: an orthophoto with its elevation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arrays, _core
from ._models import default_model, folders
from ._results import Status

Floats = npt.NDArray[np.float64]
Corner = tuple[float, float, float, float]


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


class Map:
    """An orthophoto with its elevation, in memory.

    ortho: H x W or H x W x 3 (RGB) or x 4 (alpha 0: no data), uint8. elevation: H x W metres, NaN: no data; its grid may be
    another one. Their places are GDAL geotransforms ``(left, step, 0, top, 0, -step)`` in one projected system in metres, with
    north up. Instead of arrays, both may be paths of GeoTIFFs, which rasterio reads (``pip install rasterio``). model, device:
    as for ``iclk.Aligner``, but not device "cpu". Raises ValueError for arrays, geotransforms and heights that do not fit
    together, and what ``iclk.Aligner`` raises.
    """

    def __init__(
        self,
        ortho: Any,
        elevation: Any,
        geotransform: Sequence[float] | None = None,
        elevation_geotransform: Sequence[float] | None = None,
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
        metres, degrees = sigma
        sigmas = (
            float(metres),
            float(metres if height_sigma is None else height_sigma),
            float(np.radians(degrees)),
            float(np.radians(degrees if heading_sigma is None else heading_sigma)),
        )
        hidden = None if mask is None else _arrays.mask(mask, "mask")
        where = _arrays.pose(T_WC, "T_WC")
        return Located(**self._core.locate(_arrays.image(image, "image"), _arrays.intrinsics(K), where, sigmas, hidden))

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


def _corner(geotransform: Sequence[float] | None, name: str) -> Corner:
    if geotransform is None or len(geotransform) != 6:
        raise _arrays.refuse(f"{name} must have six numbers: left, step, 0, top, 0, -step")
    left, step_x, turn_x, top, turn_y, step_y = (float(x) for x in geotransform)
    if turn_x or turn_y or not step_x > 0 or not step_y < 0:
        raise _arrays.refuse(f"{name} {tuple(geotransform)} is not one with north up: left, step, 0, top, 0, -step")
    return left, top, step_x, -step_y


def _read(ortho: Any, elevation: Any) -> tuple[Any, Sequence[float], Any, Sequence[float]]:
    try:
        import rasterio
    except ImportError:
        raise _arrays.refuse("paths of maps need rasterio (pip install rasterio); or give arrays with geotransforms") from None
    with rasterio.open(ortho) as picture, rasterio.open(elevation) as relief:
        if picture.crs != relief.crs or not picture.crs or not picture.crs.is_projected:
            raise _arrays.refuse(f"{ortho} is in {picture.crs}, {elevation} in {relief.crs}: both must be in one projected "
                                 "system; `iclk locate` takes others")
        bands = np.moveaxis(picture.read(range(1, min(picture.count, 3) + 1)), 0, -1)
        pixels = np.dstack([np.broadcast_to(bands, (*bands.shape[:2], 3)), picture.dataset_mask()])
        heights = relief.read(1, masked=True).astype(np.float64) * relief.scales[0] + relief.offsets[0]
        return pixels, picture.transform.to_gdal(), heights.filled(np.nan), relief.transform.to_gdal()
