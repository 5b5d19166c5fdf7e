"""Arrays of every kind give the answer of their packed copies."""

from __future__ import annotations

import iclk
import numpy as np
import pytest
from conftest import Scene


def answer(s: Scene, reference: object, target: object, uv: object = None, z: object = None) -> np.ndarray:
    at, depth = (s.uv, s.z) if uv is None else (uv, z)
    r = iclk.align(reference, target, at, depth, s.K, device="cpu", model="classical")
    assert r.converged, r.reason
    return r.T_10


def padded(a: np.ndarray) -> np.ndarray:
    wide = np.full((a.shape[0], a.shape[1] + 7, *a.shape[2:]), 255, a.dtype)
    wide[:, 3:-4] = a
    return wide[:, 3:-4]


def upside_down(a: np.ndarray) -> np.ndarray:
    return a[::-1].copy()[::-1]


def mirrored(a: np.ndarray) -> np.ndarray:
    return a[:, ::-1].copy()[:, ::-1]


def every_other(a: np.ndarray) -> np.ndarray:
    return np.repeat(a, 2, axis=1)[:, ::2]


def read_only(a: np.ndarray) -> np.ndarray:
    b = a.copy()
    b.flags.writeable = False
    return b


def unaligned(a: np.ndarray) -> np.ndarray:
    raw = np.zeros(a.nbytes + 1, np.uint8)
    view = raw[1:].view(a.dtype).reshape(a.shape) if a.itemsize == 1 else np.ndarray(a.shape, a.dtype, raw, 1)
    view[...] = a
    return view


def broadcast_planes(a: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.ascontiguousarray(np.moveaxis(a, -1, 0)), 0, -1)


LAYOUTS = [padded, upside_down, mirrored, every_other, np.asfortranarray, read_only, unaligned, broadcast_planes]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, ">u2", ">f4"])
def test_layouts(small: Scene, colour: Scene, layout, kind) -> None:
    if layout is broadcast_planes:
        if kind not in (np.uint8, np.float32):
            return
        small = colour
    scale = 1 / 255 if np.dtype(kind).kind == "f" else 257 if np.dtype(kind).itemsize == 2 else 1

    def convert(a: np.ndarray) -> np.ndarray:
        return (a.astype(float) * scale).astype(kind)

    first, second = convert(small.reference), convert(small.target)
    a, b = layout(first), layout(second)
    np.testing.assert_array_equal(a, first)
    kept = a.copy()
    got = answer(small, a, b)
    np.testing.assert_array_equal(got, answer(small, first, second))
    np.testing.assert_array_equal(a, kept)  # nobody wrote there


def test_features_of_any_kind(small: Scene) -> None:
    expected = answer(small, small.reference, small.target)
    whole = small.uv.astype(np.int32)
    for uv, z in (
        (whole, small.z),
        (small.uv.tolist(), small.z.tolist()),
        (small.uv[::-1].copy()[::-1], small.z[::-1].copy()[::-1]),
        (np.asfortranarray(small.uv), small.z),
    ):
        np.testing.assert_array_equal(answer(small, small.reference, small.target, uv, z), expected)
    with pytest.raises(ValueError, match="it must be numbers"):
        answer(small, small.reference, small.target, small.uv.astype(str), small.z)


def test_colours_are_red_green_blue() -> None:
    """Luma of pure red is 0.299, of pure blue 0.114: features are found where there is texture of the one or the other."""
    random = np.random.default_rng(3)
    texture = random.integers(0, 255, (120, 160)).astype(np.uint8)
    red, blue = (np.zeros((120, 160, 3), np.uint8) for _ in range(2))
    red[..., 0] = texture
    blue[..., 2] = texture
    grey = np.round(texture * 0.299).astype(np.uint8)
    depth = np.ones((120, 160), np.float32)
    uv, _ = iclk.detect(red, depth, 30)
    same, _ = iclk.detect(grey, depth, 30)
    np.testing.assert_array_equal(uv, same)
    K = (100, 100, 79.5, 59.5)
    aligner = iclk.Aligner(160, 120, "classical", "cpu", refine=False, photometric=False)
    aligner.set_reference(0, red, uv, np.ones(len(uv)), K)
    assert aligner.align(0, red, np.eye(4)).stages[0].cost < 1e-12
    assert aligner.align(0, blue, np.eye(4)).stages[0].cost > 1e-4


class Interface:
    """Speaks __array_interface__ alone."""

    def __init__(self, a: np.ndarray) -> None:
        self.a = a
        self.__array_interface__ = a.__array_interface__


class Dlpack:
    """Speaks DLPack alone."""

    def __init__(self, a: np.ndarray) -> None:
        self.a = a

    def __dlpack__(self, **how: object) -> object:
        return self.a.__dlpack__(**how)  # type: ignore[arg-type]

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.a.__dlpack_device__()


@pytest.mark.parametrize("wrapper", [Interface, Dlpack, memoryview])
def test_protocols(small: Scene, wrapper) -> None:
    expected = answer(small, small.reference, small.target)
    np.testing.assert_array_equal(answer(small, wrapper(small.reference), wrapper(small.target)), expected)


def test_an_array_elsewhere_is_refused(small: Scene) -> None:
    class Cuda(Dlpack):
        def __dlpack_device__(self) -> tuple[int, int]:
            return 2, 0

        def __dlpack__(self, **how: object) -> object:
            raise BufferError("this tensor lies on cuda:0")

    with pytest.raises(ValueError, match="target cannot be read as an array: .*"):
        answer(small, small.reference, Cuda(small.target))


def test_torch_on_the_cpu_without_a_copy(small: Scene) -> None:
    torch = pytest.importorskip("torch")
    expected = answer(small, small.reference, small.target)
    np.testing.assert_array_equal(answer(small, torch.from_numpy(small.reference), torch.from_numpy(small.target)), expected)
