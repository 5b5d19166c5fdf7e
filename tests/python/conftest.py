"""Pairs with known truth, made with NumPy alone: a plane with a smooth texture, seen by two cameras."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import iclk
import numpy as np
import pytest

VULKAN = bool(iclk.devices())
DEVICES = ["cpu", *([None] if VULKAN else [])]
if not VULKAN and os.environ.get("ICLK_ALLOW_NO_DEVICE") != "1" and "ICLK_COMMAND" in os.environ:
    raise RuntimeError("no Vulkan device here; ICLK_ALLOW_NO_DEVICE=1 lets the tests that need one be left out")

needs_vulkan = pytest.mark.skipif(not VULKAN, reason="no Vulkan device")


def pose(rho: tuple[float, ...], phi: tuple[float, ...]) -> np.ndarray:
    """t = rho, R = Exp(phi)."""
    angle = np.linalg.norm(phi)
    x, y, z = np.asarray(phi) / angle
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + np.sin(angle) * hat + (1 - np.cos(angle)) * hat @ hat
    T[:3, 3] = rho
    return T


@dataclass
class Scene:
    reference: np.ndarray
    target: np.ndarray
    depth: np.ndarray  # H x W, m
    K: tuple[float, float, float, float]
    T_10: np.ndarray
    uv: np.ndarray
    z: np.ndarray  # at uv

    def error(self, T_10: np.ndarray) -> float:
        """px, the most that a feature lies beside its true place."""
        fx, fy, cx, cy = self.K
        X0 = np.column_stack([(self.uv - (cx, cy)) / (fx, fy), np.ones(len(self.uv))]) * self.z[:, None]

        def project(T: np.ndarray) -> np.ndarray:
            X = X0 @ T[:3, :3].T + T[:3, 3]
            return X[:, :2] / X[:, 2:] * (fx, fy) + (cx, cy)

        return float(np.abs(project(T_10) - project(self.T_10)).max())

    def like(self, convert) -> Scene:
        return replace(self, reference=convert(self.reference), target=convert(self.target))


def make_scene(
    width: int = 320, height: int = 240, seed: int = 1, colour: bool = False, T_10: np.ndarray | None = None
) -> Scene:
    random = np.random.default_rng(seed)
    f = 0.95 * width
    K = (f, f, (width - 1) / 2, (height - 1) / 2)
    T_10 = pose((0.06, -0.04, 0.05), (0.01, 0.015, -0.02)) if T_10 is None else T_10
    waves = random.normal(size=(60, 2)) * 18
    phases, heights = random.uniform(0, 2 * np.pi, 60), random.uniform(0.3, 1, 60)
    normal = np.array([0.1, -0.15, 1.0])

    def look(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        v, u = np.mgrid[:height, :width]
        rays = np.stack([(u - K[2]) / f, (v - K[3]) / f, np.ones_like(u, float)], -1)
        back = rays @ T[:3, :3]  # R^T ray
        origin = -T[:3, :3].T @ T[:3, 3]
        z = (4 - normal @ origin) / (back @ normal)
        X = origin + z[..., None] * back
        value = (heights * np.sin(X[..., :2] @ waves.T + phases)).sum(-1)
        return value, z

    reference, z = look(np.eye(4))
    target, _ = look(T_10)
    low, high = reference.min(), reference.max()

    def pixels(value: np.ndarray) -> np.ndarray:
        grey = np.clip((value - low) / (high - low), 0, 1)
        if colour:
            grey = np.stack([grey, grey**1.3, 0.8 * grey + 0.1], -1)
        return np.round(grey * 255).astype(np.uint8)

    columns, rows = 12, 8
    u, v = np.meshgrid(np.linspace(24, width - 25, columns).round(), np.linspace(24, height - 25, rows).round())
    uv = np.stack([u.ravel(), v.ravel()], -1)
    depth = z.astype(np.float32)
    at = depth[uv[:, 1].astype(int), uv[:, 0].astype(int)].astype(np.float64)
    return Scene(pixels(reference), pixels(target), depth, K, T_10, uv, at)


@pytest.fixture(scope="session")
def scene() -> Scene:
    return make_scene()


@pytest.fixture(scope="session")
def small() -> Scene:
    return make_scene(160, 120)


@pytest.fixture(scope="session")
def colour() -> Scene:
    return make_scene(colour=True)


@pytest.fixture(params=DEVICES, ids=lambda d: d or "vulkan")
def device(request: pytest.FixtureRequest) -> str | None:
    return request.param
