"""Arrays as they come, made into what iclk._core takes. Nothing is copied that need not be."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._errors import InvalidArgument

_PIXELS = (np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float32))


def refuse(message: str) -> InvalidArgument:
    return InvalidArgument("invalid_argument", message)


def array(x: Any, name: str) -> npt.NDArray[Any]:
    """NumPy, ``__array_interface__``, ``__array__`` (PyTorch on the CPU), the buffer protocol, DLPack, or nested lists."""
    if isinstance(x, np.ndarray):
        return x
    try:
        if hasattr(x, "__dlpack__") and not (hasattr(x, "__array_interface__") or hasattr(x, "__array__")):
            return np.from_dlpack(x)
        return np.asarray(x)
    except (TypeError, ValueError, RuntimeError, BufferError) as e:
        raise refuse(f"{name} cannot be read as an array: {e}") from e


def _unmasked(a: npt.NDArray[Any], name: str) -> npt.NDArray[Any]:
    """Raises InvalidArgument for an array of numpy.ma that hides something."""
    if np.ma.is_masked(a):
        raise refuse(f"{name} is a masked array with masked values; fill them, or give a mask")
    return a.data if isinstance(a, np.ma.MaskedArray) else a


def _metres(x: Any, name: str) -> npt.NDArray[Any]:
    """Depths as floating-point numbers; masked ones are 0, which is none."""
    a = array(x, name)
    if isinstance(a, np.ma.MaskedArray):
        a = a.filled(0)
    if a.size and a.dtype.kind != "f":
        hint = "raw / 5000.0 for TUM RGB-D, raw / 1000.0 for millimetres"
        raise refuse(f"{name} is {a.dtype}; it must be metres, as floating-point numbers: {hint}")
    return a


def _native(a: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return a if a.dtype.isnative else a.astype(a.dtype.newbyteorder("="))


def image(x: Any, name: str) -> npt.NDArray[Any]:
    """H x W or H x W x 3, uint8, uint16 or float32; rows that are packed in themselves and follow each other downwards."""
    a = _native(_unmasked(array(x, name), name))
    if a.ndim != 2 and not (a.ndim == 3 and a.shape[2] == 3):
        raise refuse(f"{name} has the shape {a.shape}; it must be H x W (grey) or H x W x 3 (red, green, blue)")
    if a.dtype not in _PIXELS:
        raise refuse(f"{name} is {a.dtype}; it must be uint8, uint16 or float32 (from 0 to 1)")
    if a.dtype == np.float32 and not np.isfinite(a).all():
        raise refuse(f"{name} has NaN or infinite pixels; replace them by any number, and hide them with a mask")
    pixel = a.itemsize * (a.shape[2] if a.ndim == 3 else 1)
    packed = a.strides[-1] == a.itemsize and a.strides[1] == pixel and a.strides[0] >= a.shape[1] * pixel
    if packed and a.flags.aligned and a.strides[0] % a.itemsize == 0:
        return a
    return np.ascontiguousarray(a)


def mask(x: Any, name: str) -> npt.NDArray[np.uint8]:
    """H x W, bool or uint8: 0 and False hide."""
    a = _unmasked(array(x, name), name)
    if a.ndim != 2 or a.dtype not in (np.dtype(bool), np.dtype(np.uint8)):
        raise refuse(f"{name} is {a.dtype} of the shape {a.shape}; it must be H x W, of bool or uint8")
    return np.ascontiguousarray(a).view(np.uint8)


def depth_map(x: Any, name: str) -> npt.NDArray[np.float32]:
    """H x W metres; 0 where `iclk align` would see no measurement either."""
    a = _metres(x, name)
    if a.ndim != 2:
        raise refuse(f"{name} has the shape {a.shape}; it must be H x W, or give uv of the features and N depths")
    return _core.keep_measured(np.ascontiguousarray(a, dtype=np.float32))


def depths(x: Any, name: str) -> npt.NDArray[np.float64]:
    """Of features, or a map."""
    return np.ascontiguousarray(_metres(x, name), dtype=np.float64)


def vector(x: Any, name: str) -> npt.NDArray[np.float64]:
    a = numbers(x, name)
    if a.ndim != 1:
        raise refuse(f"{name} has the shape {a.shape}; it must be N numbers")
    return a


def points(x: Any, name: str) -> npt.NDArray[np.float64]:
    a = numbers(x, name)
    if a.size == 0 and a.ndim < 2:
        return np.zeros((0, 2))
    if a.ndim != 2 or a.shape[1] != 2:
        raise refuse(f"{name} has the shape {a.shape}; it must be N x 2 (u, v)")
    return a


def pose(x: Any, name: str) -> npt.NDArray[np.float64]:
    a = numbers(x, name)
    if a.shape != (4, 4):
        raise refuse(f"{name} has the shape {a.shape}; it must be a 4 x 4 matrix")
    return a


def numbers(x: Any, name: str) -> npt.NDArray[np.float64]:
    a = _unmasked(array(x, name), name)
    if a.dtype.kind not in "fiu":
        raise refuse(f"{name} is {a.dtype}; it must be numbers")
    return np.ascontiguousarray(a, dtype=np.float64)


def intrinsics(K: Any) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of four numbers or of a 3 x 3 matrix."""
    a = numbers(K, "K")
    if a.shape == (4,):
        return float(a[0]), float(a[1]), float(a[2]), float(a[3])
    if a.shape != (3, 3):
        raise refuse(f"K has the shape {a.shape}; it must be fx, fy, cx, cy or a 3 x 3 matrix")
    zeros = (a[0, 1], a[1, 0], a[2, 0], a[2, 1])
    if any(z != 0 for z in zeros) or a[2, 2] != 1:
        raise refuse("K is not a camera matrix without skew: it must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return float(a[0, 0]), float(a[1, 1]), float(a[0, 2]), float(a[1, 2])


def features(x: Any, name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Positions, inverse depths and their sigmas (or none) of N x 3 or N x 4 numbers."""
    a = numbers(x, name)
    if a.ndim != 2 or a.shape[1] not in (3, 4):
        raise refuse(f"{name} has the shape {a.shape}; it must be N x 3 (u, v, depth) or N x 4 (u, v, depth, sigma)")
    q = inverse(a[:, 2])
    sigma = a[:, 3] * q**2 if a.shape[1] == 4 else np.zeros(0)  # dq = dz / z^2
    return np.ascontiguousarray(a[:, :2]), q, sigma


def inverse(depth: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """As the command's feature files: a depth of 0 is none."""
    with np.errstate(divide="ignore"):
        return np.where(depth == 0, 0.0, 1.0 / depth)
