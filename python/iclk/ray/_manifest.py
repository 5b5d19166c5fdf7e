"""What a pair asks for: a line of the manifest of `iclk batch`, or a row with the same keys. Same meaning, same defaults."""

from __future__ import annotations

import json
import math
import os
import re
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
import numpy.typing as npt

KEYS = (
    "id", "reference", "target", "depth", "features", "reference_mask", "target_mask", "depth_scale", "camera", "distortion",
    "initial_pose", "truth", "meta",
)  # fmt: skip
NUMBER = re.compile(r"\+?-?(\d+\.?\d*([eE][+-]?\d+)?|\.\d+([eE][+-]?\d+)?|inf|infinity|nan)", re.IGNORECASE)

#: A path, or what is in the file.
Source = Union[str, bytes]


class BadPair(Exception):
    """What is wrong with a pair, in words. Its row says so, and nobody tries it again."""


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


def number(word: str) -> float | None:
    return float(word) if NUMBER.fullmatch(word) else None


def numbers(text: str, what: str) -> list[float]:
    out = []
    for word in re.split(r"[ \t\r\n,;\[\]]+", text):
        if not word:
            continue
        value = number(word)
        if value is None:
            raise BadPair(f"{what}: '{word[:40]}' is not a number")
        out.append(value)
    return out


def read(path: str, most: int | None = None) -> bytes:
    """Raises OSError; BadPair for what is no file."""
    if "\0" in path:
        raise BadPair(f"cannot read {path.split(chr(0))[0]}: the name holds a zero byte")
    if os.path.isdir(path):
        raise BadPair(f"cannot read {path}: it is a folder")
    if os.path.exists(path) and not os.path.isfile(path):
        raise BadPair(f"cannot read {path}: it is no regular file")
    with open(path, "rb") as file:
        data = file.read() if most is None else file.read(most + 1)
    if most is not None and len(data) > most:
        raise BadPair(f"cannot read {path}: longer than {most} bytes")
    return data


def pose(value: Any, what: str, folder: str) -> npt.NDArray[np.float64]:
    """4 x 4 of nested lists, of a TUM line `tx ty tz qx qy qz qw`, or of a file with one."""
    if isinstance(value, str):
        text = value
        if text.strip(" \t\r\n0123456789.,;+-eE[]"):
            path = os.path.join(folder, value)
            text = read(path, 1 << 20).decode("utf-8", "replace")
            what += " " + path
    else:
        text = json.dumps(np.asarray(value).tolist())
    x = numbers("\n".join(line.split("#")[0] for line in text.splitlines()), what)
    if not all(map(math.isfinite, x)):
        raise BadPair(f"{what}: the pose is not finite")
    T = np.eye(4)
    if len(x) in (7, 8):
        q = np.array(x[-4:])
        norm = float(np.sqrt((q * q).sum()))
        if abs(norm - 1) > 1e-2:
            raise BadPair(f"{what}: the quaternion qx qy qz qw has norm {norm:.6f}, not 1: not a rotation")
        qx, qy, qz, qw = q / norm
        T[:3, :3] = [
            [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
            [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
            [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
        ]
        T[:3, 3] = x[-7:-4]
    elif len(x) in (12, 16):
        T.ravel()[: len(x)] = x
    else:
        raise BadPair(f"{what}: a TUM line (tx ty tz qx qy qz qw) or a 4x4 matrix is needed, found {len(x)} numbers")
    return T


def request_of(row: dict[str, Any], folder: str) -> Request:
    """Raises BadPair that names the key. Relative paths begin at `folder`. None is as good as a missing key."""
    for key in row:
        if key not in KEYS:
            raise BadPair(f"key '{key[:40]}' is not known: {', '.join(KEYS)}; put what is yours into \"meta\"")
    have = {key: value for key, value in row.items() if value is not None}

    def text(key: str) -> str:
        if not isinstance(have[key], str) or not have[key]:
            raise BadPair(f"key '{key}' is {str(have[key])[:40]}, not a text")
        return str(have[key])

    def source(key: str) -> Source | None:
        if key not in have:
            return None
        value = have[key]
        return bytes(value) if isinstance(value, (bytes, bytearray, memoryview)) else os.path.join(folder, text(key))

    for key in ("reference", "target"):
        if key not in have:
            raise BadPair(f"key '{key}' is missing")
    if "depth" not in have and "features" not in have:
        raise BadPair("key 'depth' or 'features' is missing")
    camera = None
    if isinstance(have.get("camera"), (list, np.ndarray)):
        camera = ",".join(repr(float(x)) for x in have["camera"])
    elif "camera" in have:
        camera = text("camera")
        if camera.strip("0123456789.,+-eE \t"):
            camera = os.path.join(folder, camera)
    scale = have.get("depth_scale")
    if scale is not None and (isinstance(scale, (bool, str)) or not (math.isfinite(scale) and scale > 0)):
        raise BadPair(f"key 'depth_scale' is {str(scale)[:40]}; a positive number is needed")
    reference, target = source("reference"), source("target")
    assert reference is not None and target is not None
    return Request(
        reference,
        target,
        source("depth"),
        source("features"),
        source("reference_mask"),
        source("target_mask"),
        camera,
        text("distortion") if "distortion" in have else None,
        None if scale is None else float(scale),
        pose(have["initial_pose"], "key 'initial_pose'", folder) if "initial_pose" in have else None,
        pose(have["truth"], "key 'truth'", folder) if "truth" in have else None,
    )
