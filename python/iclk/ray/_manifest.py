"""What a pair asks for: a line of the manifest of `iclk batch`, or a row with the same keys, read as the command reads it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from .. import _core
from .._errors import InvalidArgument

#: A path, or what is in the file.
Source = Union[str, bytes]


class BadPair(InvalidArgument):
    """What is wrong with a pair, in words. Its row says so, and nobody tries it again."""

    def __init__(self, message: str) -> None:
        super().__init__("invalid_argument", message)


@dataclass
class Request:
    reference: Source
    target: Source
    depth: Source | None
    features: Source | None
    reference_mask: Source | None
    target_mask: Source | None
    camera: str | None
    distortion: str | None
    depth_scale: float | None
    T_10: npt.NDArray[np.float64] | None
    truth: npt.NDArray[np.float64] | None


def name_of(source: Source, key: str) -> str:
    return source if isinstance(source, str) else f"the bytes of '{key}'"


def read(path: str, most: int | None = None) -> bytes:
    """Raises OSError; BadPair for what is no file."""
    if "\0" in path:
        raise BadPair(f"cannot read {path.split(chr(0))[0]}: the name contains a zero byte")
    if os.path.isdir(path):
        raise BadPair(f"cannot read {path}: it is a folder")
    if os.path.exists(path) and not os.path.isfile(path):
        raise BadPair(f"cannot read {path}: it is not a regular file")
    with open(path, "rb") as file:
        data = file.read() if most is None else file.read(most + 1)
    if most is not None and len(data) > most:
        raise BadPair(f"cannot read {path}: longer than {most} bytes")
    return data


def request_of(row: dict[str, Any], folder: str) -> Request:
    """Raises InvalidArgument that names the key. Relative paths begin at `folder`. None is as good as a missing key."""
    files = {key: bytes(x) for key, x in row.items() if isinstance(x, (bytes, bytearray, memoryview)) and key != "meta"}
    said = {key: "bytes" if key in files else value for key, value in row.items() if key not in ("id", "meta")}
    where = "pair"
    try:
        text = json.dumps(said, default=lambda x: np.asarray(x).tolist())
        found = _core.parse_request(text, where, folder, read)
    except InvalidArgument as e:
        raise BadPair(str(e).removeprefix(where + ": ")) from None
    return Request(**{**found, **files})
