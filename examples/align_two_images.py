#!/usr/bin/env python3
"""Aligns two images and shows what came of it: pip install iclk matplotlib [rerun-sdk]

    examples/align_two_images.py --out aligned.png                   # two views of terrain made in code, with truth
    examples/align_two_images.py a.png b.png --depth a_depth.png --depth-scale 5000 --camera 517.3,516.5,318.6,255.3
    examples/align_two_images.py --rrd aligned.rrd                   # for the Rerun viewer: rerun aligned.rrd

Cells (# %%) run one by one in an editor that knows notebooks.
"""

# %% What to align
from __future__ import annotations

import argparse

import iclk
import numpy as np

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("images", nargs="*", metavar="REF TARGET")
parser.add_argument("--depth", help="of REF: 16-bit PNG with --depth-scale")
parser.add_argument("--depth-scale", type=float, default=5000.0, help="raw units a metre")
parser.add_argument("--camera", help="fx,fy,cx,cy")
parser.add_argument("--device", help='index or name of a Vulkan device, or "cpu"')
parser.add_argument("--out", help="picture to write")
parser.add_argument("--rrd", help="recording for Rerun to write")
args = parser.parse_args()

truth = None
if args.images:
    from PIL import Image

    reference, target = (np.asarray(Image.open(path).convert("RGB")) for path in args.images)
    depth = np.asarray(Image.open(args.depth)) / args.depth_scale
    K = [float(x) for x in args.camera.split(",")]
else:
    K = [300.0, 300.0, 159.5, 119.5]
    pair = iclk.Terrain(seed=3, size=160).pair(0, K, 320, 240)
    reference, target, depth, truth = pair.reference, pair.target, pair.depth, pair.T_10

# %% Align: features where the depth is known, found again in the target
uv, z = iclk.detect(reference, depth)
r = iclk.align(reference, target, uv, z, K, device=args.device)
print(f"{r.status}: {r.reason}")
print("T_10 =", np.array2string(r.T_10, precision=5, suppress_small=True), sep="\n")
if r.converged:
    sigma = np.sqrt(r.covariance.diagonal())
    print(f"1 sigma {1e3 * np.linalg.norm(sigma[:3]):.2f} mm, {np.degrees(np.linalg.norm(sigma[3:])):.4f} deg; by {r.model}")
if truth is not None:
    print(f"off the truth by {1e3 * np.linalg.norm((r.T_10 - truth)[:3, 3]):.2f} mm")

# %% Draw: where the features were, and where they are
if args.out:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    axes[0].imshow(reference)
    axes[0].scatter(*uv.T, s=12, c=1 / z, cmap="turbo")
    axes[0].set_title("reference, features by inverse depth")
    axes[1].imshow(target)
    good = r.aligned
    axes[1].plot(*np.stack([uv[good], r.uv[good]]).transpose(2, 0, 1), color="yellow", linewidth=0.7)
    axes[1].scatter(*r.uv[good].T, s=12, color="lime", label=f"{good.sum()} aligned")
    axes[1].scatter(*r.uv[~good].T, s=12, color="red", label=f"{(~good).sum()} not")
    axes[1].set_title(f"target: {r.status}")
    axes[1].legend(loc="lower right")
    for axis in axes:
        axis.set_axis_off()
    figure.savefig(args.out, dpi=110)
    print("written", args.out)

# %% Export: both cameras and the points in space
if args.rrd:
    import rerun as rr

    rr.init("iclk")
    rr.save(args.rrd)
    fx, fy, cx, cy = K
    points = np.column_stack([(uv - (cx, cy)) / (fx, fy), np.ones(len(uv))]) * z[:, None]
    colours = reference[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    rr.log("world/points", rr.Points3D(points, colors=colours, radii=0.004 * float(np.median(z))))
    T_01 = np.linalg.inv(r.T_10)
    for name, image, T in (("reference", reference, np.eye(4)), ("target", target, T_01)):
        rr.log(f"world/{name}", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
        rr.log(f"world/{name}/image", rr.Pinhole(image_from_camera=matrix, resolution=[image.shape[1], image.shape[0]]))
        rr.log(f"world/{name}/image", rr.Image(image))
    print("written", args.rrd)
