"""Pairs from files, as `iclk batch` loads them."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from . import _features, _images
from ._camera import Camera, Distortion, Undistorter, load_camera, parse_distortion
from ._manifest import BadPair, Request, name_of
from ._settings import Settings

Image = npt.NDArray[Any]


@dataclass
class Pair:
    """As a pinhole camera would have seen it."""

    reference: Image  #: as iclk takes images
    target: Image
    mask: Image | None  #: of the target, 0 = hidden
    camera: Camera
    features: _features.Features
    T_10: npt.NDArray[np.float64] | None

    @property
    def kind(self) -> tuple[Any, ...]:
        """Pairs of one kind go to the device together."""
        a, b = self.reference, self.target
        return a.shape, a.dtype.str, b.shape, b.dtype.str, self.mask is None


def _require_size(image: Image, name: str, like: Image, like_name: str) -> None:
    (h, w), (height, width) = image.shape[:2], like.shape[:2]
    if (h, w) != (height, width):
        raise BadPair(f"{name} is {w}x{h} but {like_name} is {width}x{height}: they must have the same size")


class Loader:
    """Loads pairs. Threads share it."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        _features.say_sigma(settings.depth_sigma, 1, _features.Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0)))
        self._distortion = parse_distortion(settings.distortion) if settings.distortion else None
        self._cameras: dict[str, Camera] = {}
        self._undistorters: dict[Any, Undistorter] = {}
        self._lock = threading.Lock()
        if settings.camera:
            self._camera(settings.camera)
        self._mask = _images.load_mask(settings.mask, "mask", settings.max_pixels) if settings.mask else None

    def _camera(self, text: str) -> Camera:
        if not text:
            raise BadPair("key 'camera' is missing; add it to the line, or give --camera")
        with self._lock:
            if text not in self._cameras:
                if len(self._cameras) >= 1000:
                    self._cameras.clear()
                self._cameras[text] = load_camera(text)
            return self._cameras[text]

    def _undistorter(self, camera: Camera, distortion: Distortion) -> Undistorter:
        key = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, distortion)
        with self._lock:
            if key not in self._undistorters:
                if len(self._undistorters) >= 16:  # 9 bytes a pixel each
                    self._undistorters.clear()
                self._undistorters[key] = Undistorter(camera, distortion)
            return self._undistorters[key]

    def _seen(self, own: Any, key: str, image: Image, name: str, undistorter: Undistorter | None) -> Image | None:
        """255 where the image is to be looked at, else 0; None: everywhere."""
        seen = undistorter.seen.copy() if undistorter else np.full(image.shape[:2], 255, np.uint8)
        for source, mask in ((self._settings.mask, self._mask), (own, None)):
            if not source:
                continue
            if mask is None:
                mask = _images.load_mask(source, key, self._settings.max_pixels)
            _require_size(mask, name_of(source, key), image, name)
            # Bilinear, as the image is: a pixel into which a hidden one went is hidden.
            seen[(undistorter.image(mask) if undistorter else mask) != 255] = 0
        return None if seen.all() else seen

    def load(self, request: Request) -> Pair:
        """Raises BadPair that names the file (no image, of another size, without depth), OSError for one that is not there."""
        settings = self._settings
        name = name_of(request.reference, "reference")
        camera = self._camera(settings.camera if request.camera is None else request.camera)
        image_0 = _images.load_image(request.reference, "reference", settings.max_pixels)
        image_1 = _images.load_image(request.target, "target", settings.max_pixels)
        _require_size(image_1, name_of(request.target, "target"), image_0, name)
        image_0, image_1 = _images.level([image_0, image_1])
        height, width = image_0.shape[:2]
        distortion = self._distortion or camera.distortion
        if request.distortion is not None:
            distortion = parse_distortion(request.distortion)
        camera, scale = camera.fitted(width, height), request.depth_scale or settings.depth_scale or camera.depth_scale
        depth = features = None
        if request.depth is not None:
            depth = _images.load_depth(request.depth, "depth", scale, settings.max_pixels)
            _require_size(depth, name_of(request.depth, "depth"), image_0, name)
        if request.features is not None:
            features = _features.load_features(request.features, "features")
        undistorter = None if distortion[0] == "none" else self._undistorter(camera, distortion)
        seen_0 = self._seen(request.reference_mask, "reference_mask", image_0, name, undistorter)
        mask = self._seen(request.target_mask, "target_mask", image_1, name_of(request.target, "target"), undistorter)
        if undistorter:
            image_0, image_1 = undistorter.image(image_0), undistorter.image(image_1)
            depth = depth if depth is None else undistorter.depth(depth)
            if features:
                features.uv = undistorter.points(features.uv)
        if seen_0 is not None:
            self._hide(seen_0, depth, features)
        reference = _images.rgb(image_0)
        if features is None:
            assert depth is not None  # request_of() has seen to it
            features = _features.detect(reference, depth, seen_0, settings.detector, settings.count)
        _features.say_sigma(settings.depth_sigma, camera.fx, features)
        return Pair(reference, _images.rgb(image_1), mask, camera, features, request.T_10)

    @staticmethod
    def _hide(seen: Image, depth: Image | None, features: _features.Features | None) -> None:
        """What the reference does not show has no depth: its pixels, and features of the file whose patch they are in."""
        if depth is not None:
            depth[seen == 0] = 0
        if features is None:
            return
        whole = _features.eroded(seen)
        for i, (u, v) in enumerate(features.uv):
            if 0 <= u < seen.shape[1] and 0 <= v < seen.shape[0] and not whole[int(v), int(u)]:
                features.inverse_depth[i] = 0


def use_one_thread() -> None:
    """The worker has threads of its own."""
    cv2.setNumThreads(1)
