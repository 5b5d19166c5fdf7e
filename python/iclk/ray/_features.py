"""Features of a reference: from its file, or chosen as `iclk batch` chooses them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2 as opencv
import numpy as np
import numpy.typing as npt

from ._images import grey_8bit
from ._manifest import BadPair, Source, name_of, number, read

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[Any]
cv2: Any = opencv  # whose stubs know no numbers as arguments

PATCH, BEFORE = 8, 3  # of shaders/shared.h: the pixels of a patch, and how many of a row lie before its centre
_DEPTH_SPREAD = 0.05
_TEXTURE = 4 * 1e-4  # cornerMinEigenVal of the least texture
_DISTANCE = 8
_BORDER = 17


@dataclass
class Features:
    uv: Floats  #: N x 2
    inverse_depth: Floats  #: N
    sigma: Floats  #: N, of the inverse depth; 0: unknown. Empty: of none


def load_features(source: Source, key: str) -> Features:
    """A CSV file `u,v,depth[,sigma]` or `u,v,inverse_depth[,sigma]`. Raises BadPair `<file>:<line>: ...`, OSError."""
    name, data = name_of(source, key), read(source, 256 << 20) if isinstance(source, str) else source
    columns: list[str] = []
    rows: list[tuple[float, float, float, float]] = []
    at: dict[str, int] = {}
    for i, line in enumerate(data.decode("utf-8", "replace").removeprefix("\ufeff").split("\n"), 1):
        line = line.strip(" \t\r\n")
        if not line or line.startswith("#"):
            continue
        cells = [cell.strip(" \t\r\n") for cell in line.split(",")]
        if not columns:
            columns, at = cells, {c: cells.index(c) for c in cells}
            if "u" not in at or "v" not in at or ("depth" in at) == ("inverse_depth" in at):
                raise BadPair(
                    f"{name}:{i}: the first line must be the header 'u,v,depth' or 'u,v,inverse_depth' (optionally with "
                    f"',sigma'), not '{line[:40]}'"
                )
            continue
        if len(cells) != len(columns):
            raise BadPair(f"{name}:{i}: {len(cells)} cells where the header has {len(columns)}")

        def value(column: str) -> float:
            x = number(cells[at[column]])
            if x is None:
                raise BadPair(f"{name}:{i}: '{cells[at[column]][:40]}' is not a number")
            return x

        given = value("depth" if "depth" in at else "inverse_depth")
        q = given if "depth" not in at else 0.0 if given == 0 else 1 / given
        sigma = value("sigma") if "sigma" in at else 0.0
        if "sigma" in at and not sigma > 0:
            raise BadPair(f"{name}:{i}: sigma {cells[at['sigma']][:40]} must be positive")
        rows.append((value("u"), value("v"), q, sigma * q * q if "depth" in at else sigma))  # dq = dz / z^2
    if not columns:
        raise BadPair(f"{name}:1: the file is empty; the header 'u,v,depth' or 'u,v,inverse_depth' is needed")
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    sigmas = table[:, 3].copy() if "sigma" in at else np.zeros(0)
    return Features(table[:, :2].copy(), table[:, 2].copy(), sigmas)


@dataclass(frozen=True)
class DepthSigma:
    """`--depth-sigma`: a standard deviation of the inverse depth q, constant + disparity / fx + relative q."""

    constant: float = 0
    disparity: float = 0
    relative: float = 0

    def apply(self, fx: float, features: Features) -> None:
        if self == DepthSigma():
            return
        said = self.constant + self.disparity / fx + self.relative * features.inverse_depth
        own = features.sigma if len(features.sigma) else np.zeros(len(said))
        features.sigma = np.where(np.isfinite(own) & (own > 0), own, said)


def parse_depth_sigma(text: str) -> DepthSigma:
    def positive(word: str) -> float:
        x = number(word)
        return x if x is not None and math.isfinite(x) and x > 0 else 0

    sigma = DepthSigma()
    if text == "auto":
        return sigma
    if text == "rendered":
        sigma = DepthSigma(relative=1e-6)
    elif text == "structured-light":
        sigma = DepthSigma(constant=0.0014)
    elif text.startswith("stereo:"):
        px, _, baseline = text.removeprefix("stereo:").partition(",")
        if positive(px) and positive(baseline):
            sigma = DepthSigma(disparity=positive(px) / positive(baseline))
    elif text.endswith("%"):
        sigma = DepthSigma(relative=positive(text[:-1]) / 100)
    if sigma == DepthSigma():
        raise BadPair(
            f"--depth-sigma '{text[:40]}' is not one of: auto, 1.5% (of the depth), stereo:PX,BASELINE (sigma of the "
            "disparity, metres), structured-light, rendered"
        )
    return sigma


def eroded(seen: Image) -> Image:
    """Not 0 where the whole patch is seen."""
    patch = np.ones((PATCH, PATCH), np.uint8)
    whole: Image = cv2.erode(seen, patch, anchor=(BEFORE, BEFORE), borderType=cv2.BORDER_REPLICATE)
    return whole


class _Picker:
    """Features on a map of occupied places, so that no two lie closer than `distance`."""

    def __init__(self, depth: Image) -> None:
        self.distance = min(max(min(depth.shape) // 8, 1), _DISTANCE)
        self.free: Image = np.full(depth.shape, 255, np.uint8)
        self.at: list[tuple[int, int]] = []

    def take(self, x: int, y: int) -> None:
        self.at.append((x, y))
        cv2.circle(self.free, (x, y), self.distance - 1, 0, cv2.FILLED)


def _cells(width: int, height: int, count: int, border: int) -> list[tuple[slice, slice]]:
    """Row by row, nearly square."""
    w, h = width - 2 * border, height - 2 * border
    if w <= 0 or h <= 0:
        return []
    rows = min(max(math.floor(math.sqrt(count * h / w) + 0.5), 1), count)
    out = []
    for r in range(rows):
        columns = count * (r + 1) // rows - count * r // rows
        y = slice(border + h * r // rows, border + h * (r + 1) // rows)
        for c in range(columns):
            x = slice(border + w * c // columns, border + w * (c + 1) // columns)
            if x.stop > x.start and y.stop > y.start:
                out.append((y, x))
    return out


def _corners(grey: Image, smooth: Image, some: Image, count: int, border: int, picker: _Picker) -> None:
    response = cv2.cornerMinEigenVal(grey, 7, ksize=3)
    buckets = _cells(grey.shape[1], grey.shape[0], count, border)
    # Good corners on smooth depth first, one a bucket and round; then weaker ones; then depth edges.
    for where, threshold in ((smooth, _TEXTURE), (smooth, 0.0), (some, 0.0)):
        strong = cv2.bitwise_and(cv2.compare(response, threshold, cv2.CMP_GT), where)
        live, found = buckets, True
        while found and len(picker.at) < count:
            corners, still = [], []
            mask = cv2.bitwise_and(strong, picker.free)
            for bucket in live:
                _, value, _, (x, y) = cv2.minMaxLoc(response[bucket], mask[bucket])
                if value > 0:
                    corners.append((value, x + bucket[1].start, y + bucket[0].start))
                    still.append(bucket)
            live = still  # a bucket without a place gets none any more
            corners.sort(key=lambda corner: -corner[0])
            found = False
            for _, x, y in corners:
                if len(picker.at) == count:
                    break
                if picker.free[y, x]:
                    picker.take(x, y)
                    found = True


def _grid(smooth: Image, some: Image, count: int, border: int, picker: _Picker) -> None:
    """The candidate nearest to each cell's centre, within the cell."""
    for y, x in _cells(some.shape[1], some.shape[0], count, border):
        v, u = np.mgrid[y, x]
        distance = (u - (x.start + x.stop) // 2) ** 2 + (v - (y.start + y.stop) // 2) ** 2
        for where in (smooth[y, x], some[y, x]):
            if where.any():
                row, column = divmod(int(np.where(where != 0, distance, np.iinfo(np.int64).max).argmin()), where.shape[1])
                picker.take(x.start + column, y.start + row)
                break


def detect(image: Image, depth: Image, seen: Image | None, detector: str, count: int) -> Features:
    """At most `count` places with depth, at whole pixels. `seen`: 0 where the image does not really show anything; or None."""
    height, width = depth.shape
    border = min(_BORDER, min(width, height) // 4)
    patch = np.ones((PATCH, PATCH), np.uint8)
    low = cv2.erode(depth, patch, anchor=(BEFORE, BEFORE), borderType=cv2.BORDER_REPLICATE)
    high = cv2.dilate(depth, patch, anchor=(BEFORE, BEFORE), borderType=cv2.BORDER_REPLICATE)
    smooth = (low > 0) & (high - low <= np.float32(_DEPTH_SPREAD) * depth)
    some = depth > 0
    inside = np.zeros(depth.shape, bool)
    inside[border : height - border, border : width - border] = True
    if seen is not None:
        inside &= eroded(seen) != 0
    masks = [np.where(where & inside, np.uint8(255), np.uint8(0)) for where in (smooth, some)]
    picker = _Picker(depth)
    if detector == "shi-tomasi":
        _corners(grey_8bit(image), masks[0], masks[1], count, border, picker)
    if not picker.at:
        _grid(masks[0], masks[1], count, border, picker)
    at = np.array(picker.at, dtype=np.int64).reshape(-1, 2)
    return Features(at.astype(np.float64), 1.0 / depth[at[:, 1], at[:, 0]].astype(np.float64), np.zeros(0))
