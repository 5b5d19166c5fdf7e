#!/usr/bin/env python3
"""Follows a camera over terrain made in code and writes its way for other tools: pip install iclk [evo]

    examples/trajectory.py --out flight --frames 20
    evo_ape tum flight/truth.txt flight/trajectory.txt -a

trajectory.txt and truth.txt are TUM (stamp tx ty tz qx qy qz qw, camera to world; evo, and what reads evo's formats);
images.txt and cameras.txt are COLMAP's text model (world to camera), for pycolmap.Reconstruction and the COLMAP viewer.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import iclk
import numpy as np


def quaternion(R: np.ndarray) -> np.ndarray:
    """x, y, z, w of a rotation: the eigenvector of the largest eigenvalue of Bar-Itzhack's matrix."""
    (a, b, c), (d, e, f), (g, h, i) = R
    M = np.array([[a - e - i, d + b, g + c, h - f], [d + b, e - a - i, h + f, c - g], [g + c, h + f, i - a - e, d - b],
                  [h - f, c - g, d - b, a + e + i]])  # fmt: skip
    q: np.ndarray = np.linalg.eigh(M)[1][:, -1]
    return q if q[3] >= 0 else -q


def tum_line(stamp: float, T_WC: np.ndarray) -> str:
    return " ".join(f"{x:.9g}" for x in (stamp, *T_WC[:3, 3], *quaternion(T_WC[:3, :3])))


def colmap_lines(number: int, T_WC: np.ndarray) -> str:
    """An image without points: id, qw qx qy qz, t, camera, name; and an empty line."""
    T_CW = np.linalg.inv(T_WC)
    x, y, z, w = quaternion(T_CW[:3, :3])
    return f"{number} " + " ".join(f"{v:.12g}" for v in (w, x, y, z, *T_CW[:3, 3])) + f" 1 {number:06d}.png\n\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("flight"))
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--device", help="index or name of a Vulkan device")
    args = parser.parse_args()

    size, (width, height) = 160.0, (320, 240)
    K = (300.0, 300.0, 159.5, 119.5)
    terrain = iclk.Terrain(seed=4, size=size, device=args.device)
    tracker = iclk.Tracker(K, depth_sigma="rendered", device=args.device)
    ground = terrain.height_at(0.35 * size, size / 2)
    found, truth = [], []
    for i in range(args.frames):
        # East in bends, up and down, looking down and rolling like an aircraft.
        x, y, z = 0.35 * size + 1.2 * i, size / 2 + 3 * np.sin(0.3 * i), ground + 45 + 2 * np.cos(0.4 * i)
        roll = 0.02 * np.sin(0.5 * i)
        ahead = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], float)  # x right is south, y down the image is west
        tilt = np.array([[np.cos(roll), 0, np.sin(roll)], [0, 1, 0], [-np.sin(roll), 0, np.cos(roll)]])
        T_WC = np.eye(4)
        T_WC[:3, :3] = ahead @ tilt
        T_WC[:3, 3] = x, y, z
        image, depth = terrain.render(T_WC, K, width, height)
        frame = tracker.track(image, depth, stamp=0.1 * i)
        print(f"{frame.time:.1f} s  {frame.status:8}  {frame.reason}")
        truth.append((frame.time, T_WC))
        if not frame.lost:
            found.append((frame.time, frame.T_WC))

    args.out.mkdir(parents=True, exist_ok=True)
    for name, poses in (("trajectory.txt", found), ("truth.txt", truth)):
        (args.out / name).write_text("".join(tum_line(stamp, T) + "\n" for stamp, T in poses))
    camera = f"1 PINHOLE {width} {height} {K[0]} {K[1]} {K[2] + 0.5} {K[3] + 0.5}\n"  # COLMAP's centres are at halves
    (args.out / "cameras.txt").write_text(camera)
    (args.out / "images.txt").write_text("".join(colmap_lines(i + 1, T) for i, (_, T) in enumerate(found)))
    (args.out / "points3D.txt").write_text("")
    world = truth[0][1]
    off = [np.linalg.norm((world @ T)[:3, 3] - dict(truth)[stamp][:3, 3]) for stamp, T in found]
    places = np.array([T[:3, 3] for _, T in truth])
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    print(f"{len(found)} of {args.frames} frames tracked, at most {max(off, default=0):.3f} m off over {way:.1f} m")


if __name__ == "__main__":
    main()
