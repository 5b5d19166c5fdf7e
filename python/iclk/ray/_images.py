"""Images, depth and masks with the pixels that `iclk batch` reads: both decode with OpenCV."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")  # OpenCV asks once, when it is first needed
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
import cv2  # noqa: E402

from .. import _core  # noqa: E402
from ._manifest import BadPair, Source, name_of, read  # noqa: E402

Image = npt.NDArray[Any]


def _is_truncated(data: bytes) -> bool:
    """A JPEG or PNG file ends before its image does: decoders put grey there and call it success."""
    if data.startswith(b"\xff\xd8"):
        at = 2
        while True:  # from marker to marker, over what is embedded in one: a thumbnail has an end too
            at = data.find(b"\xff", at) + 1
            if at == 0 or at >= len(data):
                return True
            marker = data[at]
            if marker == 0xFF:
                continue
            at += 1
            if marker == 0xD9:
                return False
            if marker > 1 and not 0xD0 <= marker <= 0xD8:
                at += max(int.from_bytes(data[at : at + 2], "big"), 2)
    return data.startswith(b"\x89PNG\r\n\x1a\n") and data.find(b"IEND", 8) < 0


def decode(source: Source, key: str, most_pixels: int) -> Image:
    """As the file has it, BGR. Raises BadPair that names the file, OSError where it cannot be read."""
    name = name_of(source, key)
    data = read(source) if isinstance(source, str) else source
    if not data:
        raise BadPair(f"cannot read {name}: the file is empty")
    if _is_truncated(data):
        raise BadPair(f"cannot read {name}: the file is truncated")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as e:
        raise BadPair(f"cannot read {name}: damaged, or in a format that OpenCV cannot read ({e.err})") from None
    if image is None:
        raise BadPair(f"cannot read {name}: damaged, or in a format that OpenCV cannot read")
    if image.shape[0] * image.shape[1] > most_pixels:
        raise BadPair(
            f"{name} is {image.shape[1]}x{image.shape[0]}, but --set max-pixels allows {most_pixels} pixels; "
            "set it higher if the image is meant to be this large"
        )
    return image


def type_name(image: Image) -> str:
    count = image.shape[2] if image.ndim == 3 else 1
    return f"{image.dtype} with {count} channel{'' if count == 1 else 's'}"


def load_image(source: Source, key: str, most_pixels: int) -> Image:
    """H x W or H x W x 3 (BGR; float: RGB), uint8, uint16 or float32. Alpha is dropped."""
    image = decode(source, key, most_pixels)
    if image.dtype == np.float64:
        image = image.astype(np.float32)
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise BadPair(f"{name_of(source, key)} is {type_name(image)}; 8-bit, 16-bit or 32-bit float is needed")
    if image.ndim == 3:
        if image.shape[2] == 4:
            image = cv2.cvtColor(image, cv2.COLOR_BGRA2BGR)
        elif image.shape[2] <= 2:
            image = np.ascontiguousarray(image[:, :, 0])
    if image.dtype == np.float32:
        if not np.isfinite(image).all():
            raise BadPair(f"{name_of(source, key)} has NaN or infinite pixels; replace them, and hide them with --mask")
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return image


def level(images: list[Image]) -> list[Image]:
    """16-bit images of few bits between a common black and white, as `iclk batch` has them (apps/iclk/io/levels.cpp)."""
    deep = [image.ravel() for image in images if image.dtype == np.uint16]
    if not deep:
        return images
    counts = np.bincount(np.concatenate(deep), minlength=65536)
    most = int(1e-3 * counts.sum())
    low, high = int(np.argmax(np.cumsum(counts) > most)), 65535 - int(np.argmax(np.cumsum(counts[::-1]) > most))
    if high - low >= 16384:
        return images
    scale = 65535 / (1.5 * max(high - low, 1024))
    table = np.rint(np.clip(32767.5 + scale * (np.arange(65536) - 0.5 * (low + high)), 0, 65535)).astype(np.uint16)
    return [table[image] if image.dtype == np.uint16 else image for image in images]


def load_mask(source: Source, key: str, most_pixels: int) -> Image:
    """255 where the file is not 0 in any of its channels but alpha, else 0."""
    image = load_image(source, key, most_pixels)
    shown = image != 0 if image.ndim == 2 else (image != 0).any(axis=2)
    return np.where(shown, np.uint8(255), np.uint8(0))


def load_depth(source: Source, key: str, scale: float, most_pixels: int) -> Image:
    """H x W float32, metres, 0 where there is none. 16 bits are divided by `scale`; float is metres already."""
    raw, name = decode(source, key, most_pixels), name_of(source, key)
    remedy = "; a depth image is 16-bit with --depth-scale, or 32-bit float in metres, with 1 channel"
    if raw.ndim == 3 and raw.dtype.kind == "f" and raw.shape[2] == 3 and (raw == raw[:, :, :1]).all():
        raw = np.ascontiguousarray(raw[:, :, 0])  # EXR writers repeat a single channel as grey colour
    if raw.ndim != 2:
        raise BadPair(f"{name} is {type_name(raw)}{remedy}")
    if raw.dtype == np.uint16:
        if not scale > 0:
            raise BadPair(
                f"{name} is 16-bit: give the raw units per metre as --depth-scale (TUM RGB-D: 5000, millimetres: 1000)"
            )
        depth = raw.astype(np.float32) * np.float32(1 / scale)
        depth[raw == 65535] = 0
    elif raw.dtype in (np.float32, np.float64):
        if scale not in (0, 1):
            raise BadPair(
                f"{name} is float, so its values are metres, but the depth scale is {scale:g} units per metre; leave it "
                "out, or give --depth-scale 1, if they are metres"
            )
        depth = raw.astype(np.float32)
    else:
        raise BadPair(f"{name} is {type_name(raw)}{remedy}")
    depth = _core.keep_measured(depth)
    if not depth.any():
        raise BadPair(
            f"{name} has no depth (all pixels are 0, negative or not finite); give the depth image of the reference"
        )
    return depth


def rgb(image: Image) -> Image:
    """As the library takes it."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 and image.dtype != np.float32 else image
