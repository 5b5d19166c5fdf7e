"""Features of a reference: from its file, or chosen as `iclk batch` chooses them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2 as opencv
import numpy as np
import numpy.typing as npt

from .. import _core
from ._manifest import BadPair, Source, name_of, number, read

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[Any]
cv2: Any = opencv  # whose stubs know no numbers as arguments

PATCH, BEFORE = 8, 3  # of shaders/shared.h: the pixels of a patch, and how many of a row lie before its centre


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


def detect(image: Image, depth: Image, seen: Image | None, detector: str, count: int) -> Features:
    """At most `count` places with depth, at whole pixels. `seen`: 0 where the image does not really show anything; or None."""
    uv, inverse_depth = _core.detect(image, depth, seen, detector, count, 0)
    return Features(uv, inverse_depth, np.zeros(0))
