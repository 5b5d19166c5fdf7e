#!/usr/bin/env python3
"""The learned model in PyTorch, from an iclk model file: an independent check, and the model that bench.py times.

    reference.py tests/golden/learned_narrow_188x120.safetensors       compares with exact values of the specification

Needs PyTorch 1.13 or later (Debian: python3-torch) and nothing else. A pair is what an alignment of iclk is: two images through
the encoder, then on each level, coarse to fine, masks of 8x8 pixels around the features, the M-estimator once, and the
iterations. Those visit the pixels of the masks only, which is faster than whole maps, as the paper has them (pixels='all').
"""
import json
import os
import struct
import sys
import warnings

import torch
import torch.nn as nn
import torch.nn.functional as F

PATCH = 8
LEAST_VARIANCE = (1 / 510) ** 2  # of a residual
LEAST_DEVIATION = 1 / 255  # of an image that is normalised by itself: less is no texture but rounding
warnings.filterwarnings('ignore', message='scatter_reduce')  # "beta" in 1.13


# ----------------------------------------------------------------------------- files
def read_safetensors(path):
    """-> (metadata, {name: float32 tensor}). Ends the program with a message if the file is none."""
    tensors = {}
    try:
        with open(path, 'rb') as file:
            size, = struct.unpack('<Q', file.read(8))
            header = json.loads(file.read(size))
            data = bytearray(file.read())
        metadata = header.pop('__metadata__', {})
        for name, entry in header.items():
            if entry['dtype'] != 'F32':
                sys.exit(f'{path}: tensor {name} is {entry["dtype"]}, it must be F32')
            begin, end = entry['data_offsets']
            values = torch.frombuffer(data, dtype=torch.float32, count=(end - begin) // 4, offset=begin)
            tensors[name] = values.reshape(entry['shape'])
    except OSError as e:
        sys.exit(f'{path}: {e.strerror}')
    except (struct.error, ValueError, KeyError, TypeError, AttributeError, RuntimeError, OverflowError, MemoryError):
        sys.exit(f'{path}: not a safetensors file, or damaged; see `iclk model info {path}`')
    return metadata, tensors


def write_safetensors(path, metadata, tensors):
    header, offset = {'__metadata__': metadata}, 0
    for name, x in tensors.items():
        header[name] = {'dtype': 'F32', 'shape': list(x.shape), 'data_offsets': [offset, offset + 4 * x.numel()]}
        offset += 4 * x.numel()
    text = json.dumps(header).encode()
    text += b' ' * (-len(text) % 8)
    with open(path + '.tmp', 'wb') as file:
        file.write(struct.pack('<Q', len(text)) + text)
        for x in tensors.values():
            file.write(x.detach().contiguous().float().numpy().tobytes())
    os.replace(path + '.tmp', path)


# ----------------------------------------------------------------------------- networks
def convolution(tensors, name, dilation):
    weight = tensors[name + '.weight']
    conv = nn.Conv2d(weight.shape[1], weight.shape[0], 3, padding=dilation, dilation=dilation)
    conv.weight.data, conv.bias.data = weight.clone(), tensors[name + '.bias'].clone()
    return nn.Sequential(conv, nn.ELU(inplace=True))


def normalised(images):
    """Each image with zero mean and unit deviation over its pixels and channels: a change of light that is the same for all of
    them is gone, colours stay."""
    mean = images.mean((1, 2, 3), keepdim=True)
    centred = images - mean
    return centred / centred.square().mean((1, 2, 3), keepdim=True).sqrt().clamp(min=LEAST_DEVIATION)


class Network(nn.Module):
    """Encoder and M-estimator; dilations: a list a level, and one for the M-estimator (empty: none); normalisation: 'fixed', or
    'image' where mean and std are those of an image that has been brought to zero mean and unit deviation."""

    def __init__(self, tensors, dilations, m_estimator, mean, std, normalisation='fixed'):
        super().__init__()
        self.normalisation = normalisation
        self.register_buffer('mean', torch.tensor(mean).view(1, -1, 1, 1))
        self.register_buffer('std', torch.tensor(std).view(1, -1, 1, 1))
        self.levels, layer = nn.ModuleList(), 0
        for level in dilations:
            convolutions = [convolution(tensors, f'encoder.{layer + i}', d) for i, d in enumerate(level)]
            self.levels.append(nn.Sequential(*convolutions))
            layer += len(level)
        self.m_estimator = nn.Sequential(*(convolution(tensors, f'm_estimator.{i}', d) for i, d in enumerate(m_estimator)),
                                         nn.Sigmoid()) if m_estimator else None

    @staticmethod
    def load(path):
        """The network, and what align() is meant to be given with it."""
        metadata, tensors = read_safetensors(path)
        if metadata.get('format') != 'iclk-model-1':
            sys.exit(f'{path}: not an iclk model (format is {metadata.get("format")!r}, must be iclk-model-1)')
        network = Network(tensors, json.loads(metadata['encoder_dilations']),
                          json.loads(metadata.get('m_estimator_dilations', '[]')),
                          json.loads(metadata['mean']), json.loads(metadata['std']), metadata.get('normalisation', 'fixed'))
        return network.eval(), {'iterations': int(metadata['iterations']), 'damping': float(metadata['damping']),
                                'carry': float(metadata.get('carry', 0))}

    def forward(self, images, levels=None):
        """(B, channels, h, w) in [0, 1] -> maps (B, 1, h, w), finest first."""
        x, maps = (normalised(images) if self.normalisation == 'image' else images), []
        x = (x - self.mean) / self.std
        for level, layers in enumerate(self.levels[:levels]):
            x = layers(F.avg_pool2d(x, 2) if level else x)
            maps.append(x.mean(1, keepdim=True))
        return maps


# ----------------------------------------------------------------------------- alignment
def mask_pixels(uv, q, width, height, level):
    """Pixels of the patches: index in the level (B, N * 64) and inverse depth, 0 where a nearer feature has the pixel."""
    count = uv.shape[1]
    centre = (uv + 0.5) / 2 ** level - 0.5
    k = torch.arange(PATCH * PATCH, device=uv.device)
    offset = torch.stack([k % PATCH, k // PATCH], -1)
    pixel = (torch.floor(centre) - (PATCH // 2 - 1)).long()[:, :, None] + offset
    inside = ((pixel >= 0) & (pixel < torch.tensor([width, height], device=uv.device))).all(-1).flatten(1)
    distance = ((pixel.to(uv.dtype) - centre[:, :, None]) ** 2).sum(-1).flatten(1)
    index = torch.where(inside, (pixel[..., 1] * width + pixel[..., 0]).flatten(1), 0)

    def least(values, start):
        best = torch.full((uv.shape[0], width * height), start, dtype=values.dtype, device=uv.device)
        best.scatter_reduce_(1, index, torch.where(inside, values, torch.full_like(values, start)), 'amin')
        return best.gather(1, index)
    feature = torch.arange(count, device=uv.device).repeat_interleave(PATCH * PATCH).expand_as(index)
    nearest = inside & (distance == least(distance, float('inf')))
    owner = nearest & (feature == least(torch.where(nearest, feature, count), count))
    return index, torch.where(owner, q.repeat_interleave(PATCH * PATCH, 1), torch.zeros_like(distance))


def hat(v):
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).view(-1, 3, 3)


def se3_exp(xi):
    """(B, 6) twists [rho, phi] -> rotations and translations. Series where the angle is small, so that derivatives are finite
    at zero."""
    rho, phi = xi[:, :3], xi[:, 3:]
    s = (phi * phi).sum(-1)[:, None, None]
    small = s < 1e-2
    safe = torch.where(small, torch.ones_like(s), s)
    angle = safe.sqrt()
    a = torch.where(small, 1 - s / 6 * (1 - s / 20 * (1 - s / 42)), torch.sin(angle) / angle)
    b = torch.where(small, 0.5 - s / 24 * (1 - s / 30 * (1 - s / 56)), (1 - torch.cos(angle)) / safe)
    c = torch.where(small, 1 / 6 - s / 120 * (1 - s / 42 * (1 - s / 72)), (angle - torch.sin(angle)) / (safe * angle))
    W = hat(phi)
    WW, eye = W @ W, torch.eye(3, dtype=xi.dtype, device=xi.device)
    return eye + a * W + b * WW, ((eye + b * W + c * WW) @ rho[..., None])[..., 0]


def se3_log(R, t):
    """Twists of rotations and translations, angles well below pi."""
    v = torch.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], 1) / 2  # sin(angle) axis
    sine = v.norm(dim=1, keepdim=True)
    angle = torch.atan2(sine, (R.diagonal(dim1=1, dim2=2).sum(1, keepdim=True) - 1) / 2)
    phi = v * torch.where(sine < 1e-4, 1 + sine * sine / 6, angle / sine.clamp(min=1e-9))
    W, s = hat(phi), (angle * angle)[..., None]
    WW, eye = W @ W, torch.eye(3, dtype=R.dtype, device=R.device)
    V = eye + (0.5 - s / 24 * (1 - s / 30)) * W + (1 / 6 - s / 120 * (1 - s / 42)) * WW
    return torch.cat([torch.linalg.solve(V, t[..., None])[..., 0], phi], 1)


class Belief:
    """A Gaussian prior on the pose: what coarser levels have found out (AlignerOptions::carry in align/options.h)."""

    def __init__(self, R, t, information):
        self.R, self.t, self.information = R, t, information

    def at(self, R, t):
        """Hessian and gradient, in the sense of normal_equations, of e^T information e, e = Log(mean^-1 T)."""
        Rt = self.R.transpose(1, 2)
        e = se3_log(Rt @ R, (Rt @ (t - self.t)[..., None])[..., 0])
        P, W = hat(e[:, :3]), hat(e[:, 3:])
        ad = torch.cat([torch.cat([W, P], 2), torch.cat([torch.zeros_like(W), W], 2)], 1)
        J = torch.eye(6, dtype=e.dtype, device=e.device) + ad / 2 + ad @ ad / 12  # J_r^-1
        A = J.transpose(1, 2) @ self.information
        return A @ J, (A @ e[..., None])[..., 0]


class Level:
    """Template of one level over a list of pixels."""

    def __init__(self, f0, f1, index, q, camera, level):
        self.height, self.width = f0.shape[-2:]
        s = 2.0 ** level
        fx, fy, cx, cy = camera
        self.fx, self.fy, self.cx, self.cy = fx / s, fy / s, (cx + 0.5) / s - 0.5, (cy + 0.5) / s - 0.5
        self.index, self.q, self.f1 = index, q, f1.flatten(1)
        u, v = (index % self.width).to(q.dtype), torch.div(index, self.width, rounding_mode='floor').to(q.dtype)
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        self.ray = torch.stack([x, y, torch.ones_like(x)], -1)
        padded = F.pad(f0, (1, 1, 1, 1), mode='replicate')[:, 0]
        self.f0 = f0.flatten(1).gather(1, index)
        gu = ((padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]) / 2).flatten(1).gather(1, index) * self.fx
        gv = ((padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]) / 2).flatten(1).gather(1, index) * self.fy
        slope = gu * x + gv * y
        self.J = torch.stack([gu * q, gv * q, -q * slope, -(gv + y * slope), gu + x * slope, gv * x - gu * y], -1)

    def residual(self, R, t):
        """Residual, warped f1 and visibility of each pixel."""
        p = self.ray @ R.transpose(1, 2) + self.q[..., None] * t[:, None]
        front = p[..., 2] > 1e-6
        z = torch.where(front, p[..., 2], torch.ones_like(p[..., 2]))
        u, v = p[..., 0] / z * self.fx + self.cx, p[..., 1] / z * self.fy + self.cy
        w, h = self.width, self.height
        visible = front & (self.q > 0) & (u >= 0) & (v >= 0) & (u <= w - 1) & (v <= h - 1)
        u, v = u.clamp(0, w - 1), v.clamp(0, h - 1)
        u0, v0 = u.floor().clamp(max=w - 2), v.floor().clamp(max=h - 2)
        a, b = u - u0, v - v0
        first = (v0 * w + u0).long()
        corners = torch.cat([first, first + 1, first + w, first + w + 1], 1)
        f00, f01, f10, f11 = self.f1.gather(1, corners).chunk(4, 1)  # at once: the derivative of each is a whole map
        warped = torch.lerp(torch.lerp(f00, f01, a), torch.lerp(f10, f11, a), b)
        seen = visible.to(u.dtype)
        return (warped - self.f0) * seen, warped * seen, seen

    def whole(self, values):
        """Values of the pixels as a map (B, 1, h, w), 0 elsewhere."""
        out = torch.zeros_like(self.f1).scatter_add_(1, self.index, values)
        return out.view(-1, 1, self.height, self.width)


def sparse_level(maps0, maps1, camera, uv, q, level, pixels='mask'):
    """Template of one level over the pixels of the patches, or over whole maps."""
    h, w = maps0[level].shape[-2:]
    index, depth = mask_pixels(uv, q, w, h, level)
    if pixels == 'all':
        depth = torch.zeros(uv.shape[0], h * w, dtype=q.dtype, device=q.device).scatter_add_(1, index, depth)
        index = torch.arange(h * w, device=q.device).expand(uv.shape[0], -1)
    return Level(maps0[level], maps1[level], index, depth, camera, level)


def level_weights(m_estimator, L, r, warped, seen, coarser=None):
    """Weights of the pixels at the residual with which a level starts, and as a map for the next finer one (None without an
    M-estimator)."""
    if m_estimator is None:
        return seen, None
    mask = L.whole(seen)
    prior = torch.ones_like(mask) if coarser is None else F.interpolate(coarser, mask.shape[-2:], mode='bilinear',
                                                                        align_corners=False)
    weight = m_estimator(torch.cat([L.whole(r.abs()), L.whole(L.f0 * seen), L.whole(warped), prior * mask], 1)) * mask
    return weight.flatten(1).gather(1, L.index), weight


def normal_equations(L, r, weights):
    """H and g of sum w r^2."""
    WJ = L.J * weights[..., None]
    return L.J.transpose(1, 2) @ WJ, (WJ.transpose(1, 2) @ r[..., None])[..., 0]


def damped(H, damping):
    return H + damping * torch.diag_embed(H.diagonal(dim1=1, dim2=2))


def move(R, t, xi):
    """T_10 <- T_10 Exp(xi)^-1"""
    dR, dt = se3_exp(-xi)
    return R @ dR, (R @ dt[..., None])[..., 0] + t


def align(network, maps0, maps1, camera, uv, q, iterations=10, damping=1e-6, pixels='mask', solve=torch.linalg.solve,
          carry=0.0):
    """T_10 as (R, t) of B pairs: maps finest first, features (B, N, 2) and their inverse depths (B, N); camera: fx, fy, cx, cy,
    numbers or tensors (B, 1)."""
    B, dtype, device = uv.shape[0], maps0[0].dtype, uv.device
    R, t = torch.eye(3, dtype=dtype, device=device).repeat(B, 1, 1), torch.zeros(B, 3, dtype=dtype, device=device)
    weight_map = belief = None
    for level in reversed(range(len(maps0))):
        L = sparse_level(maps0, maps1, camera, uv, q, level, pixels)
        r, warped, seen = L.residual(R, t)
        weights, weight_map = level_weights(network.m_estimator, L, r, warped, seen, weight_map)
        for _ in range(iterations):
            w = weights * seen
            H, g = normal_equations(L, r, w)
            variance = ((w * r * r).sum(1) / w.sum(1).clamp(min=1e-30)).clamp(min=LEAST_VARIANCE)[:, None]
            information = carry * H / variance[..., None]
            if belief:
                prior_H, prior_g = belief.at(R, t)
                H, g = H + variance[..., None] * prior_H, g + variance * prior_g
            R, t = move(R, t, solve(damped(H, damping), g))
            r, _, seen = L.residual(R, t)
        if carry > 0:
            belief = Belief(R, t, information + belief.at(R, t)[0] if belief else information)
    return R, t


# ----------------------------------------------------------------------------- what can be run
def check_golden(path):
    """The specification's exact values, in double precision."""
    metadata, golden = read_safetensors(path)
    golden = {name: x.double() for name, x in golden.items()}
    levels = int(metadata['levels'])
    network = Network({name: x.float() for name, x in golden.items()}, [(1, 2, 2)] * levels, (1, 2, 4, 1),
                      (0.4914, 0.4822, 0.4465), (0.2023, 0.1994, 0.2010)).eval().double()
    maps = [network(golden[name]) for name in ('image0', 'image1')]
    worst = max(float(((m - golden[f'level{l}.{f}']).abs().max() / golden[f'level{l}.{f}'].abs().max()))
                for f, side in zip(('f0', 'f1'), maps) for l, m in enumerate(side))
    print(f'{path}: maps differ by {worst:.1e} of the largest value')
    ok = worst < 1e-5
    for pixels in ('mask', 'all'):
        R, t = align(network, *maps, golden['camera'].tolist(), golden['features'], golden['inverse_depth'],
                     int(metadata['iterations']), float(metadata['damping']), pixels)
        dR = float((R - golden['R']).abs().max())
        dt = float((t - golden['t']).norm() / golden['t'].norm())
        print(f'{path}: pixels {pixels}: R differs by {dR:.1e}, t by {dt:.1e} of its length')
        ok = ok and dR < 1e-4 and dt < 1e-4
    return ok


if __name__ == '__main__':
    if len(sys.argv) < 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    with torch.inference_mode():
        sys.exit(0 if all([check_golden(path) for path in sys.argv[1:]]) else 1)
