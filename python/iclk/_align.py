"""Alignment of images in memory, with the same results as `iclk align`, bit for bit."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt

from . import _arrays, _core
from ._models import default_model, folders
from ._results import Alignment

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Options(TypedDict, total=False):
    """How to align. Names, defaults and values are those of `iclk align`; `iclk align --help` explains them."""

    solver: str  #: "host" (default), "device", which is faster for batches on a GPU, or "cpu"
    search: str  #: "auto" (default: on where no T_10 is given), "on" or "off"
    levels: int | None
    iterations: int | None  #: most per level
    damping: str  #: "fixed" (default) or "adaptive"
    carry: float | None
    robust: str | None  #: "unit", "huber", "tukey" or "cauchy"
    photometric: bool | None
    refine: bool  #: False: stop after ICLK
    refine_rounds: int
    recolour: bool
    rolling_shutter: bool  #: False: do not correct for a rolling shutter
    structure: bool  #: also refine the inverse depths
    camera_sigma: float | None  #: px, sigma of focal length and principal point; None: from the residuals; 0: exact


class Pair(NamedTuple):
    """A target for a prepared reference; a tuple ``(slot, target)`` works too."""

    slot: int
    target: Any  #: like the reference
    T_10: Any = None  #: first guess, 4 x 4; None: search the whole target
    mask: Any = None  #: H x W, bool or uint8; pixels that are 0 are ignored: moving objects, a border


def detect(
    image: Any, depth: Any, count: int = 200, *, detector: str = "shi-tomasi", mask: Any = None, seed: int = 0
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Chooses at most ``count`` features of an image where its depth is known, as `iclk align` does; depth edges come last.

    image: H x W or H x W x 3 (RGB), uint8, uint16 or float32. depth: H x W metres along the optical axis, float. Pixels without
    depth are 0, negative, NaN, infinite or masked; a largest value that many pixels share (a saturated sensor) counts as no
    depth too. detector: "shi-tomasi", corners spread over the image; "grid", even spacing; "random", drawn from ``seed``.
    mask: H x W, bool or uint8; pixels that are 0 are ignored.

    Returns uv (N x 2, px, centres at whole numbers) and their depths (N, metres); N is below ``count`` if the image has fewer.
    The GIL is released. Raises ValueError for a wrong shape, type, detector or count.
    """
    pixels = _arrays.image(image, "image")
    metres = _arrays.depth_map(depth, "depth")
    seen = None if mask is None else _arrays.mask(mask, "mask")
    uv, inverse_depth = _core.detect(pixels, metres, seen, detector, count, seed)
    return uv, 1.0 / inverse_depth


class Aligner:
    """Aligns targets with prepared references (keyframes) of one image size, on one device; set-up is paid only once.

    width, height: pixels of every image. model: "auto" (classical; pairs that do not converge go to sd6dof-small, then
    to sd6dof), "classical", "sd6dof-small", "sd6dof" or a path; default: ICLK_MODEL, else "auto". device: index, UUID or part
    of the name of a Vulkan device (``iclk.devices()``), or "cpu", which needs no Vulkan; default: ICLK_DEVICE, else the best.
    references: number of slots. batch: pairs that are aligned together; longer lists are split. features: expected maximum
    per reference; a reference with more costs a new plan. Other options: ``iclk.Options``.

    8-bit and grey images take less device memory. The first images decide the kind; images of another kind cost a new plan.
    One thread works at a time, others wait; the GIL is released. An aligner cannot be pickled: make one in each worker. An
    aligner that was made before a fork raises ``iclk.Error`` in the child.

    Raises ValueError for invalid sizes and options, TypeError for unknown options, and ``iclk.Error`` if Vulkan (code
    "no_driver"), the device or the model is missing, or the memory does not suffice.
    """

    def __init__(
        self,
        width: int,
        height: int,
        model: str | None = None,
        device: str | int | None = None,
        *,
        references: int = 16,
        batch: int = 16,
        features: int = 200,
        **options: Unpack[Options],
    ) -> None:
        chosen = {**options, "model": default_model() if model is None else model}
        if device is not None:
            chosen["device"] = str(device)
        self._core = _core.Aligner(width, height, references, batch, features, chosen, folders())

    @property
    def device(self) -> str:
        """Name of the device."""
        return self._core.device

    def set_reference(
        self,
        slot: int,
        image: Any,
        uv: Any,
        depth: Any,
        K: Any,
        *,
        sigma: Any = None,
        count: int = 200,
    ) -> list[str]:
        """Prepares a reference (keyframe) for any number of targets. Its pixels are copied.

        slot: 0 to ``references - 1``. image: H x W or H x W x 3 (RGB), uint8 and uint16 (their range is 0 to 1) or float32 (0
        to 1). uv: N x 2 pixels, centres at whole numbers, or None: then ``detect`` chooses at most ``count``. depth: N metres
        along the optical axis, one per uv, or H x W if uv is None. Another unit works too; the pose then has it. K: 3 x 3, or
        fx, fy, cx, cy, of undistorted images. sigma: N standard deviations of the depths, if known.

        Returns for each feature "ok", or why it is not used ("not_finite", "no_depth", "outside_image"). Raises ValueError for
        a wrong shape, type or size, NaN in an image, and a slot out of range.
        """
        pixels = _arrays.image(image, "reference")
        at, inverse_depth = _features(pixels, uv, depth, count)
        deviation = np.zeros(0)
        if sigma is not None:
            deviation = _arrays.vector(sigma, "sigma")
            if len(deviation) != len(at):
                raise _arrays.refuse(f"{len(at)} features, but {len(deviation)} sigmas; give one sigma per feature")
            deviation = deviation * inverse_depth**2  # dq = dz / z^2
        return self._core.set_reference(slot, pixels, at, inverse_depth, deviation, _arrays.intrinsics(K))

    def align_batch(self, pairs: Iterable[Pair | Sequence[Any]]) -> list[Alignment]:
        """Returns one result per pair, in order. A pair that cannot be aligned has a status; it raises no exception.

        pairs: ``(slot, target)``, ``(slot, target, T_10)`` or ``iclk.Pair``. Results do not depend on other pairs. Ctrl-C stops
        after the current batch. Raises ValueError for bad input, before any alignment, and ``iclk.Error`` for a lost device.
        """
        work = []
        for i, item in enumerate(pairs):
            pair = Pair(*item)
            guess = None if pair.T_10 is None else _arrays.pose(pair.T_10, f"pair {i}: T_10")
            mask = None if pair.mask is None else _arrays.mask(pair.mask, f"pair {i}: mask")
            work.append((int(pair.slot), _arrays.image(pair.target, f"pair {i}: target"), guess, mask))
        return [Alignment._of(fields) for fields in self._core.align(work)]

    def align(self, slot: int, target: Any, T_10: Any = None, mask: Any = None) -> Alignment:
        """Aligns one pair, as ``align_batch`` does."""
        return self.align_batch([Pair(slot, target, T_10, mask)])[0]


def _features(
    pixels: npt.NDArray[Any], uv: Any, depth: Any, count: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    if uv is None:
        return _core.detect(pixels, _arrays.depth_map(depth, "depth"), None, "shi-tomasi", count, 0)
    at, metres = _arrays.points(uv, "uv"), _arrays.depths(depth, "depth")
    if metres.ndim == 2 and metres.shape == pixels.shape[:2]:
        raise _arrays.refuse("depth is a map: give None for uv, or the depths at uv, such as depth[v, u]")
    if len(at) != metres.size or metres.ndim != 1:
        raise _arrays.refuse(f"{len(at)} features (uv), but depth has the shape {metres.shape}; give one depth per feature")
    return at, _arrays.inverse(metres)


_kept = threading.local()  # aligners of `align`, by what they were made for
_MOST_KEPT = 4


def align(
    reference: Any,
    target: Any,
    uv: Any,
    depth: Any,
    K: Any,
    *,
    T_10: Any = None,
    mask: Any = None,
    sigma: Any = None,
    count: int = 200,
    model: str | None = None,
    device: str | int | None = None,
    **options: Unpack[Options],
) -> Alignment:
    """Aligns a target image with a reference image that has depth at some pixels; the result is that of `iclk align`.

    reference, target: H x W or H x W x 3 (RGB), uint8, uint16 or float32, of one size and camera, undistorted. uv, depth, K,
    sigma, count: as for ``Aligner.set_reference``; with ``uv=None`` iclk chooses features where the H x W depth is known. T_10:
    first guess, 4 x 4; default: search the whole target. mask: H x W; pixels of the target that are 0 are ignored. model,
    device, options: as for ``Aligner``.

    Each thread keeps the aligners of its last few image sizes, so later calls are fast. For many targets of one reference,
    and for batches, use ``iclk.Aligner``. Raises what ``Aligner`` raises.
    """
    first, second = _arrays.image(reference, "reference"), _arrays.image(target, "target")
    if first.shape[:2] != second.shape[:2]:
        raise _arrays.refuse(f"target is {second.shape[1]}x{second.shape[0]}, reference {first.shape[1]}x{first.shape[0]}: "
                             "they must have the same size")
    chosen_model = default_model() if model is None else model
    kinds = (first.ndim, first.dtype.str, second.ndim, second.dtype.str, mask is None)
    environment = (os.getpid(), os.environ.get("ICLK_DEVICE"))
    key = (first.shape[:2], kinds, chosen_model, device, tuple(sorted(options.items())), environment)
    kept: OrderedDict[Any, Aligner] = _kept.__dict__.setdefault("aligners", OrderedDict())
    aligner = kept.pop(key, None)
    if aligner is None:
        height, width = first.shape[:2]
        aligner = Aligner(width, height, chosen_model, device, references=1, batch=1, features=1, **options)
    aligner.set_reference(0, first, uv, depth, K, sigma=sigma, count=count)
    result = aligner.align(0, second, T_10, mask)
    kept[key] = aligner
    while len(kept) > _MOST_KEPT:
        kept.popitem(last=False)
    return result
