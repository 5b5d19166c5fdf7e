"""Pairs of an RGB-D recording in the TUM layout, as a manifest to train on: frame i against frame i + stride."""
import json
import os

import numpy as np

from files import write_text
from poses import pose
from recipe import InputError

APART = 0.04  # s between an image, its depth and its pose, at most; as `iclk batch --tum`


def stamped(folder, name):
    """[(time, rest of the line)] in order of time."""
    path = os.path.join(folder, name)
    try:
        with open(path, encoding='utf-8') as file:
            lines = [line.split(maxsplit=1) for line in file if line.strip() and not line.startswith('#')]
        return sorted((float(time), rest.strip()) for time, rest in lines)
    except OSError as e:
        raise InputError(f'{path}: {e.strerror}; a recording has rgb.txt, depth.txt, groundtruth.txt and camera.txt') from None
    except ValueError:
        raise InputError(f'{path}: a line is not a time followed by a file or pose') from None


def nearest(entries, time):
    other, rest = min(entries, key=lambda entry: abs(entry[0] - time))
    return rest if abs(other - time) <= APART else None


def write_pairs(folder, out, strides):
    try:
        strides = [int(x) for x in strides.split(',')]
        assert min(strides) >= 1
    except (ValueError, AssertionError):
        raise InputError(f'--stride {strides}: must be whole numbers from 1, such as 1,2,3') from None
    images, depths, poses = (stamped(folder, name) for name in ('rgb.txt', 'depth.txt', 'groundtruth.txt'))
    path = os.path.join(folder, 'camera.txt')
    try:
        with open(path, encoding='utf-8') as file:
            numbers = [float(x) for line in file if not line.startswith('#') for x in line.split()]
        camera, scale = numbers[:4], numbers[6]
    except (OSError, ValueError, IndexError):
        raise InputError(f'{path}: must have fx fy cx cy width height depth_scale') from None
    frames = []
    for time, image in images:
        depth, at = nearest(depths, time), nearest(poses, time)
        if depth and at:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = pose(at)  # camera to world
            frames.append((image, depth, T))
    here = os.path.dirname(os.path.abspath(out))
    lines = []

    def path_of(name):
        return os.path.relpath(os.path.join(os.path.abspath(folder), name), here)
    for stride in strides:
        for i, (a, b) in enumerate(zip(frames, frames[stride:])):
            lines.append(json.dumps({
                'id': f'{os.path.basename(os.path.abspath(folder))}/{stride}/{i}', 'reference': path_of(a[0]),
                'target': path_of(b[0]), 'depth': path_of(a[1]), 'depth_scale': scale, 'camera': camera,
                'truth': (np.linalg.inv(b[2]) @ a[2]).tolist()}))
    if not lines:
        raise InputError(f'{folder}: no pairs: only {len(frames)} frames have image, depth and pose within {APART} s')
    write_text(out, '\n'.join(lines) + '\n')
    print(f'{out}: {len(lines)} pairs of {len(frames)} frames')
    return 0
