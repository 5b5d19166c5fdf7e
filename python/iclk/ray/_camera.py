"""Cameras as `iclk --camera` and `--distortion` take them, and what takes a distortion out."""

from __future__ import annotations

from typing import Any

import cv2 as opencv
import numpy as np
import numpy.typing as npt

from .. import _core
from .._core import CameraFile as Camera
from ._manifest import read

Image = npt.NDArray[Any]
Distortion = tuple[str, tuple[float, ...]]  #: "none", "radtan" or "equidistant", and its coefficients
cv2: Any = opencv  # whose stubs know neither None nor numbers as arguments


def parse_distortion(text: str) -> Distortion:
    """Raises InvalidArgument."""
    return _core.parse_distortion(text)


def load_camera(text: str) -> Camera:
    """`fx,fy,cx,cy[,width,height]`, or a file: camera.txt, Kalibr, EuRoC, OpenCV or ROS YAML.

    Raises InvalidArgument, OSError.
    """
    return _core.load_camera(text, read)


class Undistorter:
    """Images, depth and points as a pinhole camera would have seen them. Threads may share it."""

    def __init__(self, camera: Camera, distortion: Distortion) -> None:
        model, k = distortion
        self._K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        self._k, self._radtan = np.array(k), model != "equidistant"
        size = (camera.width, camera.height)
        make = cv2.initUndistortRectifyMap if self._radtan else cv2.fisheye.initUndistortRectifyMap
        self._u, self._v = make(self._K, self._k, np.eye(3), self._K, size, cv2.CV_32FC1)
        v, u = np.mgrid[: camera.height, : camera.width]
        r = np.hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
        inside = (self._u >= 0) & (self._v >= 0) & (self._u <= camera.width - 1) & (self._v <= camera.height - 1)
        self.seen: Image = np.where(inside & (r < _core.lens_radius(model, k)), np.uint8(255), np.uint8(0))

    def image(self, image: Image) -> Image:
        out: Image = cv2.remap(image, self._u, self._v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return out

    def depth(self, depth: Image) -> Image:
        out: Image = cv2.remap(depth, self._u, self._v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        out[self.seen == 0] = 0
        return out

    def points(self, uv: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        out = uv.copy()
        good = np.isfinite(uv).all(axis=1)
        if good.any():
            until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
            some = uv[good].reshape(-1, 1, 2)
            if self._radtan:
                some = cv2.undistortPointsIter(some, self._K, self._k, None, self._K, until)
            else:
                some = cv2.fisheye.undistortPoints(some, self._K, self._k, None, np.eye(3), self._K)
            out[good] = some.reshape(-1, 2)
        return out
