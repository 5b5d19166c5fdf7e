"""Cameras as `iclk --camera` and `--distortion` take them, and what takes a distortion out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2 as opencv
import numpy as np
import numpy.typing as npt
import yaml

from ._manifest import BadPair, numbers, read

Image = npt.NDArray[Any]
cv2: Any = opencv  # whose stubs know neither None nor numbers as arguments


@dataclass(frozen=True)
class Distortion:
    model: str = "none"  #: "none", "radtan" or "equidistant"
    k: tuple[float, ...] = ()


@dataclass(frozen=True)
class Camera:
    fx: float
    fy: float
    cx: float
    cy: float
    width: int = 0  #: 0: not stated, so those of the image
    height: int = 0
    depth_scale: float = 0  #: 0: not stated
    distortion: Distortion = Distortion()
    source: str = ""  #: for messages

    def matrix(self) -> npt.NDArray[np.float64]:
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def fitted(self, width: int, height: int) -> Camera:
        """For an image of that size: scaled where the camera was stated for another one of the same aspect."""
        if self.width == 0 or (self.width, self.height) == (width, height):
            return replace(self, width=width, height=height)
        scale = width / self.width
        if abs(self.height * scale - height) > 1 + scale:
            raise BadPair(
                f"{self.source}: the intrinsics belong to {self.width}x{self.height}, the image is {width}x{height}: another "
                "aspect, so it was cropped; give the intrinsics of the cropped image"
            )
        sx, sy = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return replace(self, fx=self.fx * sx, fy=self.fy * sy, cx=cx, cy=cy, width=width, height=height)


def distortion_of(model: str, k: list[float], where: str) -> Distortion:
    if not all(map(math.isfinite, k)):
        raise BadPair(f"{where}: a distortion coefficient is not finite")
    while len(k) > 5 and k[-1] == 0:
        k = k[:-1]
    if model in ("none", ""):
        if any(k):
            raise BadPair(f"{where}: distortion coefficients without a model")
        return Distortion()
    if model in ("radtan", "radial-tangential", "plumb_bob"):
        if len(k) not in (4, 5):
            raise BadPair(f"{where}: distortion {model} takes 4 or 5 coefficients k1,k2,p1,p2[,k3], not {len(k)}")
        return Distortion("radtan", tuple(k))
    if model in ("equidistant", "fisheye"):
        if len(k) != 4:
            raise BadPair(f"{where}: distortion {model} takes 4 coefficients k1,k2,k3,k4, not {len(k)}")
        return Distortion("equidistant", tuple(k))
    raise BadPair(f"{where}: distortion model '{model[:40]}' is not known; radtan or equidistant is")


def parse_distortion(text: str) -> Distortion:
    model, colon, k = text.partition(":")
    return distortion_of(model, numbers(k, f"--distortion {text[:40]}"), f"--distortion {text[:40]}")


def _of_numbers(k: list[float], source: str, most: int) -> Camera:
    if len(k) not in (4, 6, 7) or len(k) > most:
        raise BadPair(f"{source}: fx,fy,cx,cy[,width,height] expected, found {len(k)} numbers")
    sides = k[4:6]
    for side in sides:
        if not (1 <= side <= 65536 and side == int(side)):
            raise BadPair(f"{source}: image size {side} is not a whole number from 1 to 65536")
    if len(k) == 7 and not (math.isfinite(k[6]) and k[6] > 0):
        raise BadPair(f"{source}: depth_scale {k[6]} must be positive")
    if not all(map(math.isfinite, k[:4])):
        raise BadPair(f"{source}: camera fx,fy,cx,cy = {k[:4]} is not finite")
    if k[0] == 0 or k[1] == 0:
        raise BadPair(f"{source}: camera focal length fx,fy = {k[0]},{k[1]} must not be zero")
    width, height = map(int, sides or (0, 0))
    return Camera(k[0], k[1], k[2], k[3], width, height, k[6] if len(k) == 7 else 0, source=source)


class _Loader(yaml.SafeLoader):  # type: ignore[misc,unused-ignore]
    """OpenCV's matrices are maps with a tag."""


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True))


def _of_yaml(text: str, source: str) -> Camera:
    try:
        tree = yaml.load(text.replace("%YAML:1.0", ""), Loader=_Loader)  # a safe loader: maps, lists and scalars
    except (yaml.YAMLError, AttributeError) as e:
        raise BadPair(f"{source}: not YAML: {str(e).splitlines()[0]}") from None
    if not isinstance(tree, dict):
        raise BadPair(f"{source}: not a map of keys")

    def first(node: dict[str, Any], *keys: str) -> Any:
        value = next((node[key] for key in keys if node.get(key) is not None), None)
        return value["data"] if isinstance(value, dict) and "data" in value else value

    def flat(value: Any, key: str, count: int = 0) -> list[float]:
        try:
            out = [float(x) for x in np.ravel(value)]
        except (TypeError, ValueError):
            raise BadPair(f"{source}: key '{key}' is not a list of numbers") from None
        if count and len(out) != count:
            raise BadPair(f"{source}: key '{key}' has {len(out)} numbers, not {count}")
        return out

    node = tree.get("cam0", tree)
    if "intrinsics" in node:  # Kalibr, EuRoC
        if node.get("camera_model", "pinhole") != "pinhole":
            raise BadPair(f"{source}: key 'camera_model' is '{node['camera_model']}'; only pinhole cameras are known")
        k = flat(node["intrinsics"], "intrinsics", 4) + flat(node.get("resolution"), "resolution", 2)
        coefficients = first(node, "distortion_coeffs", "distortion_coefficients")
        model = node.get("distortion_model")
        if model is None and coefficients is not None:
            raise BadPair(f"{source}: key 'distortion_model' is missing")
        d = [] if model in (None, "none") else flat(coefficients, "distortion_coeffs")
        return replace(_of_numbers(k, source, 6), distortion=distortion_of(model or "none", d, source))
    matrix = first(tree, "camera_matrix", "Camera_Matrix", "K")
    if matrix is None:
        raise BadPair(f"{source}: key 'intrinsics' (EuRoC), 'cam0' (Kalibr) or 'camera_matrix' (OpenCV) is missing")
    m = flat(matrix, "camera_matrix", 9)
    if m[1] != 0:
        raise BadPair(f"{source}: key 'camera_matrix' has a skew of {m[1]}; only cameras without are known")
    size = [first(tree, "image_width", "image_Width"), first(tree, "image_height", "image_Height")]
    k = [m[0], m[4], m[2], m[5]] + ([] if size == [None, None] else flat(size, "image_width", 2))
    coefficients = first(tree, "distortion_coefficients", "Distortion_Coefficients", "D", "dist_coeffs")
    if coefficients is None:
        return _of_numbers(k, source, 6)
    model = str(tree.get("distortion_model") or ("fisheye" if str(tree.get("fisheye_model")) == "1" else "radtan"))
    model = "radtan" if model == "rational_polynomial" else model
    d = flat(coefficients, "distortion_coefficients")
    return replace(_of_numbers(k, source, 6), distortion=distortion_of(model, d, source))


def load_camera(text: str) -> Camera:
    """`fx,fy,cx,cy[,width,height]`, or a file: camera.txt, Kalibr, EuRoC, OpenCV or ROS YAML. Raises BadPair, OSError."""
    text = text.strip()
    if not text:
        raise BadPair("--camera: fx,fy,cx,cy[,width,height] or a camera file is needed")
    if "," in text and not text.strip("0123456789.,+-eE "):
        return _of_numbers(numbers(text, f"--camera {text}"), f"--camera {text[:60]}", 6)
    source = f"camera {text}"
    content = read(text, 1 << 20).decode("utf-8", "replace")
    lines = [line.split("#")[0].strip() for line in content.splitlines()]
    lines = [line for line in lines if line]
    if not lines:
        raise BadPair(f"{source}: the file is empty")
    if ":" not in lines[0] and not lines[0].startswith("---"):
        return _of_numbers(numbers(" ".join(lines), source), source, 7)
    return _of_yaml(content, source)


class Undistorter:
    """Images, depth and points as a pinhole camera would have seen them. Threads may share it."""

    def __init__(self, camera: Camera, distortion: Distortion) -> None:
        self._K, self._k, self._radtan = camera.matrix(), np.array(distortion.k), distortion.model == "radtan"
        size = (camera.width, camera.height)
        make = cv2.initUndistortRectifyMap if self._radtan else cv2.fisheye.initUndistortRectifyMap
        self._u, self._v = make(self._K, self._k, np.eye(3), self._K, size, cv2.CV_32FC1)
        v, u = np.mgrid[: camera.height, : camera.width]
        r = np.hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
        inside = (self._u >= 0) & (self._v >= 0) & (self._u <= camera.width - 1) & (self._v <= camera.height - 1)
        self.seen: Image = np.where(inside & (r < self._domain()), np.uint8(255), np.uint8(0))

    def _domain(self) -> float:
        """The radius up to which the radial polynomial grows: beyond it the model folds back into the image."""
        if not self._radtan:
            return 1e300
        k1, k2, k3 = self._k[0], self._k[1], self._k[4] if len(self._k) > 4 else 0.0
        r = 0.0
        while r < 4:
            r2 = r * r
            if 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3)) <= 0:
                return r
            r += 1e-3
        return 4

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
