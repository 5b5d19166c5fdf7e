"""Features of a reference: from its file, or chosen as `iclk batch` chooses them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2 as opencv
import numpy as np
import numpy.typing as npt

from .. import _core
from ._manifest import Source, name_of, read

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
    """A CSV file `u,v,depth[,sigma]` or `u,v,inverse_depth[,sigma]`. Raises InvalidArgument `<file>:<line>: ...`, OSError."""
    data = read(source, 256 << 20) if isinstance(source, str) else source
    return Features(*_core.parse_features(data, name_of(source, key)))


def say_sigma(text: str, fx: float, features: Features) -> None:
    """`--depth-sigma`, of features without a sigma of their own. Raises InvalidArgument."""
    features.sigma = _core.depth_sigma(text, fx, features.inverse_depth, features.sigma)


def eroded(seen: Image) -> Image:
    """Not 0 where the whole patch is seen."""
    patch = np.ones((PATCH, PATCH), np.uint8)
    whole: Image = cv2.erode(seen, patch, anchor=(BEFORE, BEFORE), borderType=cv2.BORDER_REPLICATE)
    return whole


def detect(image: Image, depth: Image, seen: Image | None, detector: str, count: int) -> Features:
    """At most `count` places with depth, at whole pixels. `seen`: 0 where the image does not really show anything; or None."""
    uv, inverse_depth = _core.detect(image, depth, seen, detector, count, 0)
    return Features(uv, inverse_depth, np.zeros(0))
