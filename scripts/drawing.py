"""Drawing and geometry for scripts/guide-pictures."""
import os

import matplotlib
import numpy as np
from PIL import Image
from quaternions import rotation

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

INK, TRUTH, OURS, GOOD, RULE = "#282828", "#5aa0c8", "#d55e00", "#009e73", "#e8e8e8"


# ---- figures


def canvas(mosaic, width, height, **more):
    """A figure of so many pixels, and its axes by their letters in the mosaic."""
    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 13, "axes.titlesize": 14, "axes.titlelocation": "left",
                         "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": "#888888", "axes.titlepad": 5,
                         "axes.axisbelow": True, "grid.color": RULE})
    return plt.subplot_mosaic(mosaic, figsize=(width / 100, height / 100), dpi=100, layout="constrained", **more)


def show(axis, pixels, title="", **more):
    axis.imshow(pixels, **more)
    axis.set_title(title)
    axis.set_axis_off()


def plain_ticks(*axes):
    """1000 in place of 10^3."""
    for axis in axes:
        axis.set_major_formatter("{x:g}")


def save(figure, path, colours=48):
    """JPEG for photographs, PNG with a palette for plots."""
    figure.canvas.draw()
    picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
    plt.close(figure)
    if path.endswith(".png"):
        picture = picture.quantize(colours, dither=Image.Dither.NONE)
    picture.save(path, quality=80, optimize=True)
    print(f"{path}: {picture.width}x{picture.height}, {os.path.getsize(path) / 1000:.0f} kB")


def grey(pixels):
    return pixels[..., :3] @ [0.299, 0.587, 0.114] if pixels.ndim == 3 else pixels.astype(float)


def overlay(reference, target):
    """Red where only the reference is bright, cyan where only the target is; dark where the target shows nothing."""
    a, b = grey(reference), grey(target)
    shown = b > 0
    a, b = (np.clip((x - x[shown].mean()) / x[shown].std() * 45 + 120, 0, 255) for x in (a, b))
    return np.where(shown[..., None], np.stack([a, b, b], 2), a[..., None] * [0.4, 0.4, 0.5]).astype(np.uint8)


def draw_camera(axis, seen, T, depth, camera, colour, name):
    """A camera of a map on a view of the map, which `seen` projects into: its axes, and the ground that it sees."""
    height, width = depth.shape
    border = np.concatenate([grid(depth.shape)[side] for side in (np.s_[0], np.s_[:, -1], np.s_[-1, ::-1], np.s_[::-1, 0])])
    ground = moved(T, lift(border, depth[border[:, 1], border[:, 0]], camera))
    axis.plot(*seen(ground).T, color=colour, linewidth=3)
    for corner in ground[[0, width, width + height, 2 * width + height]]:
        axis.plot(*seen(np.array([T[:3, 3], corner])).T, color=colour, linewidth=1)
    for k, shade in enumerate(("#ff3030", "#30e030", "#4080ff")):
        axis.plot(*seen(np.array([T[:3, 3], T[:3, 3] + 24 * T[:3, k]])).T, color=shade, linewidth=5, solid_capstyle="round")
    axis.text(*seen(T[:3, 3] + [0, 0, 7]), name, color=INK, weight="bold", ha="center", va="bottom",
              bbox={"color": colour, "boxstyle": "round,pad=0.15"})


def stripes(shift):
    """An image of 376x240 with rows of random grey: edges of one direction."""
    rows = np.convolve(np.random.default_rng(1).normal(size=400), np.hanning(9) / 4, "same")
    return np.repeat(128 + 70 * rows[shift:shift + 240, None, None], 376, 1).repeat(3, 2)


# ---- geometry; a camera is fx, fy, cx, cy


def grid(shape):
    """The pixel u, v at each place of an image."""
    return np.stack(np.meshgrid(np.arange(shape[1]), np.arange(shape[0])), -1)


def lift(uv, depth, camera):
    """Points of a camera at pixels with depths."""
    fx, fy, cx, cy = camera
    return np.stack([(uv[..., 0] - cx) / fx * depth, (uv[..., 1] - cy) / fy * depth, depth], -1)


def moved(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


def project(points, camera):
    """Pixels of points of a camera."""
    return points[..., :2] / points[..., 2:] * camera[:2] + camera[2:]


def warp(target, depth, camera, T):
    """The target as the reference would see it, to the nearest pixel; black outside."""
    at = np.round(project(moved(T, lift(grid(depth.shape), depth, camera)), camera)).astype(int)
    inside = ((at >= 0) & (at < [target.shape[1], target.shape[0]])).all(-1)
    at[~inside] = 0
    return np.where(inside[..., None], target[at[..., 1], at[..., 0]], 0)


def splat(points, colours, camera, size):
    """Points of a camera as dots of three pixels, the nearest in front."""
    picture = np.full((size[1] + 3, size[0] + 3, 3), 255, np.uint8)
    uv = np.round(project(points, camera)).astype(int)
    seen = (points[:, 2] > 0) & ((uv >= 0) & (uv < size)).all(1)
    for i in np.flatnonzero(seen)[np.argsort(-points[seen, 2])]:
        picture[uv[i, 1]:uv[i, 1] + 3, uv[i, 0]:uv[i, 0] + 3] = colours[i]
    return picture


def pose(R, t):
    return np.block([[np.asarray(R), np.reshape(t, (3, 1))], [np.zeros((1, 3)), 1]])


def turn(x, y, z):
    """A rotation by degrees about three axes."""
    (a, b, c), (d, e, f) = (g(np.radians([x, y, z])) for g in (np.cos, np.sin))
    about = [[[1, 0, 0], [0, a, -d], [0, d, a]], [[b, 0, e], [0, 1, 0], [-e, 0, b]], [[c, -f, 0], [f, c, 0], [0, 0, 1]]]
    return np.linalg.multi_dot(np.array(about))


def look(position, at):
    """The pose of a level camera that looks at a point."""
    z = np.subtract(at, position) / np.linalg.norm(np.subtract(at, position))
    x = np.cross(z, (0, 0, 1)) / np.linalg.norm(np.cross(z, (0, 0, 1)))
    return pose(np.column_stack([x, np.cross(z, x), z]), position)


def rotations(q):
    """Matrices of quaternions x y z w."""
    return np.array(rotation(q.T)).transpose(2, 0, 1)


def closest(source, target):
    """The source where it is closest to the target: turned and shifted, as `evo_ape -a` does."""
    a, b = source - source.mean(0), target - target.mean(0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    return a @ (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T + target.mean(0)
