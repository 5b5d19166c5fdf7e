"""Sets of pairs with truth, as `iclk render` writes them and `iclk batch` reads them, and the samples that training draws.

Every random number is a function of the recipe's seed and of where it is used (step, place in the batch), so that a run that
is stopped anywhere goes on with the same samples, whatever reads ahead.
"""
import hashlib
import json
import math
import os
import re

import cv2
import numpy as np
import torch

import appearance
from poses import pose
from recipe import InputError
from reference import PATCH

DEPTH_SPREAD = 0.05  # of a feature's patch, session/detect.cpp: one depth must hold for it
KEYS = {'id', 'reference', 'target', 'depth', 'features', 'depth_scale', 'camera', 'distortion', 'initial_pose', 'truth',
        'meta'}
SIDES = (appearance.REFERENCE, appearance.TARGET)
cv2.setNumThreads(1)  # reading ahead takes processes


# ----------------------------------------------------------------------------- manifests
def parse_line(where, line, folder):
    def refuse(why):
        raise InputError(f'{where}: {why}')
    try:
        entry = json.loads(line)
        assert isinstance(entry, dict)
    except (ValueError, AssertionError):
        refuse('not a JSON object; if `iclk render` was stopped, run the same command again')
    entry = {key: value for key, value in entry.items() if value is not None}
    for key in entry.keys() - KEYS:
        refuse(f'unknown key {key!r}')
    for key in ('reference', 'target', 'depth', 'camera', 'truth'):
        if key not in entry:
            refuse(f'{key!r} is missing; training needs it for every pair')
    if entry.get('distortion', 'none') != 'none':
        refuse('images with distortion cannot be used for training; undistort them first')
    pair = {'id': str(entry.get('id', where)), 'depth_scale': float(entry.get('depth_scale', 0))}
    for key in ('reference', 'target', 'depth'):
        pair[key] = os.path.join(folder, entry[key])
    try:
        camera = entry['camera'].split(',') if isinstance(entry['camera'], str) else entry['camera']
        pair['camera'] = np.array([float(x) for x in camera][:4])
        assert pair['camera'].shape == (4,) and np.isfinite(pair['camera']).all() and (pair['camera'][:2] != 0).all()
    except (ValueError, TypeError, AssertionError):
        refuse(f'camera is {entry["camera"]!r}, it must be fx,fy,cx,cy')
    try:
        pair['R'], pair['t'] = pose(entry['truth'])
    except (ValueError, TypeError) as e:
        refuse(f'truth is not a pose ({e}); give a 4x4 matrix or a line tx ty tz qx qy qz qw')
    pair['strip'] = rendered_strip(pair, entry.get('meta'))
    return pair


def rendered_strip(pair, meta):
    """From where to where, in metres eastwards, a rendered pair sees its map; None for pairs that were not rendered."""
    try:
        x = [float(np.array(meta[key], float)[0][3]) for key in ('T_W0', 'T_W1')]
        half = 1.2 * float(meta['altitude']) * pair['camera'][2] / pair['camera'][0]
        return min(x) - half, max(x) + half
    except (TypeError, KeyError, ValueError, IndexError):
        return None


class PairSet:
    """`path`: a folder with pairs.jsonl, or a manifest."""

    def __init__(self, path):
        self.path = path
        manifest = os.path.join(path, 'pairs.jsonl') if os.path.isdir(path) else path
        self.folder = os.path.dirname(manifest)
        try:
            with open(manifest, encoding='utf-8') as file:
                lines = file.read().splitlines()
        except (OSError, UnicodeDecodeError) as e:
            raise InputError(f'{manifest}: {getattr(e, "strerror", e)}; a set is a folder of `iclk render --pairs`, '
                             'or a manifest of `iclk batch` with depth and truth') from None
        self.pairs = [parse_line(f'{manifest}:{i + 1}', line, self.folder) for i, line in enumerate(lines) if line.strip()]
        if not self.pairs:
            raise InputError(f'{manifest}: no pairs; `iclk render --pairs` adds some')
        self.about = os.path.basename(os.path.normpath(path))
        try:
            with open(os.path.join(self.folder, 'set.json'), encoding='utf-8') as file:
                described = json.load(file)
            source = ', '.join('/'.join(x.split('/')[-2:]) for x in described['about']['source'].split(', '))
            self.about = f'{source} (seed {described["options"]["seed"]})'
        except (OSError, ValueError, KeyError):
            pass

    def measure_motion(self):
        """How far the cameras of the set move: largest component of rotation, rad, and of translation x mean inverse depth,
        that 95 % of the pairs keep to. Every pair has it afterwards."""
        rotations = [np.abs(cv2.Rodrigues(p['R'])[0]).max() for p in self.pairs]
        translations = []
        for p in self.pairs[::-(-len(self.pairs) // 64)]:
            depth = read_pair(p)[1]
            if not (depth > 0).any():
                raise InputError(f'depth {p["depth"]}: no pixel has depth; take its line out of the manifest')
            translations.append(np.abs(p['t']).max() * (1 / depth[depth > 0]).mean())
        for p in self.pairs:
            p['motion'] = float(np.quantile(rotations, 0.95)), float(np.quantile(translations, 0.95))


def refuse_shared_images(sets, tests):
    """A test on what was trained on proves nothing. Files are told apart by what is in them."""
    def images(of):
        return {pair[key]: s.path for s in of for pair in s.pairs for key in ('reference', 'target')}

    def digest(path):
        try:
            with open(path, 'rb') as file:
                return hashlib.sha256(file.read()).digest()
        except OSError:
            return path  # read_image says so when its turn comes
    known = {digest(path): path for path in images(sets)} if tests else {}
    for path, test in images(tests).items():
        if digest(path) in known:
            raise InputError(f'{test}: its image {path} is the same as {known[digest(path)]}, which is used for training; '
                             'sets of --validation and --test must not share images with --data')


def read_image(path, flags, what):
    image = cv2.imread(path, flags)
    if image is None:
        why = 'is no image that OpenCV reads' if os.path.exists(path) else 'does not exist'
        raise InputError(f'{what} {path}: {why}; render the set again, or take its line out of the manifest')
    return image


def read_pair(pair):
    """Images float32 RGB in [0, 1] and depth in metres, 0 = none."""
    images = [read_image(pair[key], cv2.IMREAD_COLOR, key)[..., ::-1].astype(np.float32) / np.float32(255)
              for key in ('reference', 'target')]
    depth = read_image(pair['depth'], cv2.IMREAD_UNCHANGED, 'depth')
    if depth.dtype == np.uint16 and pair['depth_scale'] > 0:
        depth = depth.astype(np.float32) / np.float32(pair['depth_scale'])
    if depth.dtype != np.float32 or depth.ndim != 2:
        raise InputError(f'depth {pair["depth"]}: must be one channel of 32-bit floats, or of 16 bit with depth_scale')
    if len({x.shape[:2] for x in (*images, depth)}) != 1:
        raise InputError(f'{pair["reference"]}, {pair["target"]} and {pair["depth"]} must have the same size')
    return images, np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


def strips(pairs):
    """Where each pair lies along a line: of the map it was rendered from, else of the frames, in the order of their names."""
    if all(pair['strip'] for pair in pairs):
        return [pair['strip'] for pair in pairs]
    def natural(path):
        return [int(x) if x.isdigit() else x for x in re.split(r'(\d+)', path)]
    frames = {path: i for i, path in enumerate(sorted({p[key] for p in pairs for key in ('reference', 'target')}, key=natural))}
    return [tuple(sorted((frames[p['reference']], frames[p['target']]))) for p in pairs]


def mixed(sets):
    """All pairs, in an order that does not depend on that of the sets or of their lines; the first ones are of all sets."""
    return in_random_order([pair for s in sets for pair in s.pairs])


def in_random_order(pairs):
    return sorted(pairs, key=lambda pair: appearance.counter_word(appearance.fnv1a(pair['id']), 0))


def split(sets, share):
    """Training and validation pairs. What validates lies at the end of each set, by place or by frames, and what reaches across
    the cut is left out: no image and no piece of ground is in both. Does not depend on the order of the sets or their lines."""
    training, validation = [], []
    for s in sets:
        where = dict(zip(map(id, s.pairs), strips(s.pairs)))
        starts = sorted((strip[0] for strip in where.values()), reverse=True)
        cut = starts[max(1, round(share * len(starts))) - 1]
        before = [pair for pair in s.pairs if where[id(pair)][1] < cut]
        if not before:
            raise InputError(f'{s.path}: all of its {len(s.pairs)} pairs share ground or frames with validation pairs; add '
                             'pairs of other ground or frames')
        training += before
        validation += [pair for pair in s.pairs if where[id(pair)][0] >= cut]
    return in_random_order(training), in_random_order(validation)  # the first ones are of all sets


# ----------------------------------------------------------------------------- samples
def draw_features(depth, count, border, rng, name):
    """Random pixels whose patch has depth within 5 %, else any with depth; uv (count, 2), q (count). Fewer are repeated: what
    owns a pixel is the first of them."""
    patch, anchor = np.ones((PATCH, PATCH), np.uint8), (PATCH // 2 - 1, PATCH // 2 - 1)
    low = cv2.erode(depth, patch, anchor=anchor, borderType=cv2.BORDER_REPLICATE)
    high = cv2.dilate(depth, patch, anchor=anchor, borderType=cv2.BORDER_REPLICATE)
    border = min(border, min(depth.shape) // 4)
    inside = np.zeros(depth.shape, bool)
    inside[border:depth.shape[0] - border, border:depth.shape[1] - border] = True
    smooth = inside & (low > 0) & (high - low <= DEPTH_SPREAD * depth)
    places = np.flatnonzero(smooth)
    if len(places) < count:
        places = np.concatenate([places, rng.permutation(np.flatnonzero(inside & (depth > 0) & ~smooth))[:count - len(places)]])
    if not len(places):
        raise InputError(f'depth {name}: no pixel has depth where features may lie; take its line out of the manifest')
    chosen = rng.permutation(places)[:count] if len(places) >= count else np.resize(places, count)
    uv = np.stack([chosen % depth.shape[1], chosen // depth.shape[1]], -1).astype(np.float32)
    return uv, 1 / depth.reshape(-1)[chosen]


def draw_appearance(data, pair, seed, variant, side):
    """One of the recipe's appearances and its changes."""
    if side == appearance.REFERENCE and data['sides'] == 'target':
        return []
    stream = appearance.appearance_seed(seed, pair['id'], variant, side)
    specs = data['appearance']
    spec = specs[appearance.Random(appearance.counter_word(stream, 1)).below(len(specs))] if len(specs) > 1 else specs[0]
    return [change for part in spec.split('+') for change in appearance.draw_changes(*appearance.parse(part), stream)]


def make_sample(pair, recipe, rng, variant, centred):
    data = recipe['data']
    images, depth = read_pair(pair)
    camera, (h, w) = pair['camera'].copy(), depth.shape
    if data['crop']:
        cw, ch = data['crop']
        if cw > w or ch > h:
            raise InputError(f'{pair["reference"]}: is {w}x{h}, smaller than the crop of {cw}x{ch}; '
                             f'give --set data.crop=[{w},{h}]')
        x, y = ((w - cw) // 2, (h - ch) // 2) if centred else (rng.integers(w - cw + 1), rng.integers(h - ch + 1))
        images = [np.ascontiguousarray(image[y:y + ch, x:x + cw]) for image in images]
        depth = np.ascontiguousarray(depth[y:y + ch, x:x + cw])
        camera[2:] -= (x, y)
    uv, q = draw_features(depth, data['features'], data['border'], rng, pair['depth'])
    images = [appearance.changed_image(image, draw_appearance(data, pair, recipe['seed'], variant, side))
              for side, image in zip(SIDES, images)]
    grid = recipe['loss']['grid']
    z = depth[grid // 2::grid, grid // 2::grid]
    v, u = np.mgrid[grid // 2:depth.shape[0]:grid, grid // 2:depth.shape[1]:grid]
    rays = np.stack([(u - camera[2]) / camera[0], (v - camera[3]) / camera[1], np.ones_like(z)], -1)
    levels = len(recipe['model']['encoder_channels'])
    sample = {'images': np.stack(images).transpose(0, 3, 1, 2), 'camera': camera, 'uv': uv, 'q': q,
              'R': pair['R'], 't': pair['t'], 'points': (rays * z[..., None]).reshape(-1, 3), 'valid': z.reshape(-1) > 0,
              'motion': pair['motion'], 'start': rng.uniform(-1, 1, (levels, 6)), 'identity': rng.uniform()}
    return {key: torch.from_numpy(np.array(value, dtype=np.float32)) for key, value in sample.items()}


def collate(samples, what):
    if len({s['images'].shape for s in samples}) != 1:
        raise InputError(f'images of different sizes in one batch of the {what} pairs; give data.crop')
    return {key: torch.stack([s[key] for s in samples]) for key in samples[0]}


def epoch_samples(pairs, recipe):
    """Samples of an epoch: every variant of every pair, as in the paper; every pair where each draw is a new one."""
    return len(pairs) * max(1, recipe['data']['variants'])


class TrainingBatches(torch.utils.data.Dataset):
    """Item k is the batch of step k."""

    def __init__(self, pairs, recipe):
        self.pairs, self.recipe = pairs, recipe

    def __getitem__(self, step):
        batch, variants, seed = self.recipe['data']['batch'], self.recipe['data']['variants'], self.recipe['seed']
        count = epoch_samples(self.pairs, self.recipe)
        samples = []
        for k in range(step * batch, (step + 1) * batch):
            epoch, place = divmod(k, count)
            sample = int(np.random.default_rng([seed, 0, epoch]).permutation(count)[place])
            pair, variant = divmod(sample, variants) if variants else (sample, epoch)
            rng = np.random.default_rng([seed, 1, k])
            samples.append(make_sample(self.pairs[pair], self.recipe, rng, variant, centred=False))
        return collate(samples, 'training')


class FixedBatches(torch.utils.data.Dataset):
    """The same samples each time, for validation and test."""

    def __init__(self, pairs, recipe, what):
        self.pairs, self.recipe, self.what = pairs[:recipe['validation']['pairs']], recipe, what

    def __len__(self):
        return math.ceil(len(self.pairs) / self.recipe['data']['batch'])

    def __getitem__(self, i):
        batch, seed = self.recipe['data']['batch'], self.recipe['seed']
        if i >= len(self):
            raise IndexError
        return collate([make_sample(pair, self.recipe, np.random.default_rng([seed, 2, i * batch + k]), 0, centred=True)
                        for k, pair in enumerate(self.pairs[i * batch:(i + 1) * batch])], self.what)
