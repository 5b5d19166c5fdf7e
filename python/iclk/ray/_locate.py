"""Pictures located on a map: a worker with the map in memory, which answers in rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

import iclk
from iclk._errors import InvalidArgument

from . import _images
from ._camera import Undistorter, load_camera, parse_distortion
from ._manifest import BadPair

_numbers = pa.list_(pa.float64())
#: Of the rows. T_WC: 16 numbers row by row, camera to map; covariance: 36.
SCHEMA = pa.schema(
    [
        ("id", pa.string()),
        ("status", pa.string()),
        ("reason", pa.string()),
        ("T_WC", _numbers),
        ("covariance", _numbers),
        ("inliers", pa.int32()),
        ("sigma", pa.float64()),
        ("model", pa.string()),
    ]
)


@dataclass(frozen=True)
class LocateSettings:
    ortho: str
    elevation: str
    camera: str
    distortion: str
    sigma: tuple[float, float]
    height_sigma: float | None
    heading_sigma: float | None
    model: str
    device: str
    max_pixels: int


class LocateWorker:
    """A step of ``Dataset.map_batches``. Raises ``iclk.Error`` if the device fails: Ray then starts another worker."""

    def __init__(self, settings: LocateSettings) -> None:
        self._settings = settings
        self._camera = load_camera(settings.camera)
        self._distortion = parse_distortion(settings.distortion) if settings.distortion else self._camera.distortion
        self._undistorters: dict[tuple[int, int], Undistorter] = {}
        self._map = iclk.Map(settings.ortho, settings.elevation, model=settings.model, device=settings.device or None)

    def __call__(self, batch: pa.Table) -> pa.Table:
        return pa.Table.from_pylist([self._row(row) for row in batch.to_pylist()], SCHEMA)

    def _row(self, row: dict[str, Any]) -> dict[str, Any]:
        image = row.get("image")
        name = row.get("id") or (image if isinstance(image, str) else "")
        try:
            located = self._locate(row)
        except (InvalidArgument, OSError) as e:
            return {"id": name, "status": "error", "reason": str(e)}
        out = {"id": name, "status": located.status, "reason": located.reason, "model": located.model}
        if located.converged:
            out |= {"T_WC": located.T_WC.ravel(), "covariance": located.covariance.ravel()}
            out |= {"inliers": located.inliers, "sigma": located.sigma}
        return out

    def _locate(self, row: dict[str, Any]) -> iclk.Located:
        for key in ("image", "T_WC"):
            if row.get(key) is None:
                raise BadPair(f"column '{key}' is missing or empty")
        settings = self._settings
        image = _images.level([_images.load_image(row["image"], "image", settings.max_pixels)])[0]
        height, width = image.shape[:2]
        camera, seen = self._camera.fitted(width, height), None
        if self._distortion[0] != "none":
            if (width, height) not in self._undistorters:
                self._undistorters[width, height] = Undistorter(camera, self._distortion)
            lens = self._undistorters[width, height]
            image, seen = lens.image(image), lens.seen
        prior = np.asarray(row["T_WC"], float)
        if prior.size != 16:
            raise BadPair(f"T_WC has {prior.size} numbers, not 16")
        return self._map.locate(
            _images.rgb(image), (camera.fx, camera.fy, camera.cx, camera.cy), prior.reshape(4, 4), sigma=settings.sigma,
            height_sigma=settings.height_sigma, heading_sigma=settings.heading_sigma, mask=seen,
        )  # fmt: skip
