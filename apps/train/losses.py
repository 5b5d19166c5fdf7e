"""What is minimised: the iterations of iclk with derivatives, and the error of the poses that they give."""
import torch
import torch.nn as nn
import torch.nn.functional as F

from reference import align, damped, level_weights, move, normal_equations, sparse_level

LUMA = (0.299, 0.587, 0.114)


class Classical(nn.Module):
    """The classical method as a network without weights to learn: grey pyramid, unit weights. Images have their mean taken out
    and a standard deviation of 1, which does for gain and bias."""
    m_estimator = None

    def __init__(self, levels):
        super().__init__()
        self.count = levels

    def forward(self, images, levels=None):
        g = (images * images.new_tensor(LUMA).view(1, 3, 1, 1)).sum(1, keepdim=True)
        g = (g - g.mean((2, 3), keepdim=True)) / g.std((2, 3), keepdim=True).clamp(min=1e-3)
        maps = [g]
        for _ in range(self.count - 1):
            maps.append(F.avg_pool2d(maps[-1], 2))
        return maps


class Still(Classical):
    """Stays where it starts: images without texture."""

    def forward(self, images, levels=None):
        return [torch.zeros_like(m) for m in super().forward(images)]


def camera_of(batch):
    return tuple(batch['camera'][:, i:i + 1] for i in range(4))


def maps_of(network, batch):
    """Maps of both images in one go: batch normalisation sees both."""
    images = batch['images']
    both = torch.cat([images[:, 0], images[:, 1]])
    maps = network(both.contiguous(memory_format=torch.channels_last))
    return [m[:len(images)] for m in maps], [m[len(images):] for m in maps]


# ----------------------------------------------------------------------------- iterations
def safe_step(H, g):
    """H^-1 g; zero where H has no inverse in sight (no texture, nothing visible), with derivatives that are finite."""
    diagonal = H.diagonal(dim1=1, dim2=2)
    good = (torch.isfinite(H).all(-1).all(-1) & torch.isfinite(g).all(-1) & (diagonal > 1e-12).all(-1))[:, None]
    scale = torch.where(good, diagonal, torch.ones_like(diagonal)).rsqrt()  # unit diagonal: metres beside radians
    scaled = torch.where(good[..., None], H * scale[:, :, None] * scale[:, None], torch.eye(6, dtype=H.dtype, device=H.device))
    return torch.linalg.solve_ex(scaled, torch.where(good, g, torch.zeros_like(g)) * scale)[0] * scale


def iterate(network, maps0, maps1, batch, level, R, t, coarser, recipe):
    """The iterations of one level: the pose after each, and the map of weights."""
    loss = recipe['loss']
    L = sparse_level(maps0, maps1, camera_of(batch), batch['uv'], batch['q'], level)
    r, warped, seen = L.residual(R, t)
    weights, weight_map = level_weights(network.m_estimator, L, r, warped, seen, coarser)
    inverse_depth, poses = batch['q'].mean(1), []
    for _ in range(loss['iterations']):
        H, g = normal_equations(L, r, weights * seen)
        xi = safe_step(damped(H, recipe['export']['damping']), g)
        if loss['step_bound'] > 0:
            size = xi[:, 3:].norm(dim=1) + xi[:, :3].norm(dim=1) * inverse_depth
            xi = xi * (loss['step_bound'] / size.detach().clamp(min=loss['step_bound']))[:, None]
        R, t = move(R, t, xi)
        poses.append((R, t))
        r, _, seen = L.residual(R, t)
    return poses, weight_map


# ----------------------------------------------------------------------------- errors of a pose
def mean_valid(values, batch):
    valid = batch['valid']
    return (values * valid).sum(1) / valid.sum(1).clamp(min=1)


def transform(batch, R, t):
    return batch['points'] @ R.transpose(1, 2) + t[:, None]


def pixel_errors(batch, R, t):
    """px of level 0 between where points fall and where they truly do, (B, points)."""
    fx, fy = batch['camera'][:, 0:1], batch['camera'][:, 1:2]

    def project(p):
        z = p[..., 2].clamp(min=1e-3)
        return torch.stack([fx * p[..., 0] / z, fy * p[..., 1] / z], -1)
    d = project(transform(batch, R, t)) - project(transform(batch, batch['R'], batch['t']))
    return ((d * d).sum(-1) + 1e-8).sqrt().clamp(max=1e4)


def saturating_loss(batch, R, t, level):
    """log(1 + e / (0.5 px x 2^level)): a failure counts little more than another one, and a level for what it can see."""
    return mean_valid(torch.log1p(pixel_errors(batch, R, t) / (0.5 * 2 ** level)), batch)


def end_point_error(batch, R, t):
    """Distance between transformed points in the unit of depth: the paper's."""
    d = transform(batch, R, t) - transform(batch, batch['R'], batch['t'])
    return mean_valid(((d * d).sum(-1) + 1e-12).sqrt(), batch)


# ----------------------------------------------------------------------------- losses
def identity(batch):
    B, x = len(batch['q']), batch['q']
    return torch.eye(3, dtype=x.dtype, device=x.device).repeat(B, 1, 1), torch.zeros(B, 3, dtype=x.dtype, device=x.device)


def start_pose(batch, level, levels, recipe):
    """The truth, moved by as much as a level must mend: 1/16 of 1.5 times the set's motion on the finest, twice that on the
    next. The coarsest one starts from no motion, as alignments do, or from the truth moved by a part of the set's motion."""
    loss, coarsest = recipe['loss'], level == levels - 1
    share = loss['coarse_motion'] if coarsest else 1.5 * 2.0 ** (level - 4)
    inverse_depth = batch['q'].mean(1, keepdim=True)
    noise = batch['start'][:, level] * share
    rotation, translation = batch['motion'].split(1, dim=1)
    xi = torch.cat([noise[:, :3] * translation / inverse_depth, noise[:, 3:] * rotation], 1)
    R, t = move(batch['R'], batch['t'], xi)
    if coarsest:
        still = batch['identity'] < loss['coarse_identity']
        I, o = identity(batch)
        R, t = torch.where(still[:, None, None], I, R), torch.where(still[:, None], o, t)
    return R, t


def recipe_loss(network, batch, recipe):
    """A number a sample."""
    maps0, maps1 = maps_of(network, batch)
    levels, weight_map, total = len(maps0), None, 0
    R, t = identity(batch)
    each_level = recipe['loss']['kind'] == 'each_level'
    for level in reversed(range(levels)):
        if each_level:
            R, t = start_pose(batch, level, levels, recipe)
            weight_map = None if weight_map is None else weight_map.detach()
        poses, weight_map = iterate(network, maps0, maps1, batch, level, R, t, weight_map, recipe)
        if each_level:
            importance = [0.5] * (len(poses) - 1) + [1]
            errors = [w * saturating_loss(batch, *p, level) for w, p in zip(importance, poses)]
            total = total + sum(errors) / sum(importance) / levels
        else:
            R, t = poses[-1]
            total = total + end_point_error(batch, R, t)
    return total


@torch.no_grad()
def final_errors(network, batch, recipe):
    """Mean px of each pair after a whole alignment from no motion, as iclk runs it."""
    maps0, maps1 = maps_of(network, batch)
    if isinstance(network, Still):
        R, t = identity(batch)
    else:
        R, t = align(network, maps0, maps1, camera_of(batch), batch['uv'], batch['q'], recipe['export']['iterations'],
                     recipe['export']['damping'], solve=safe_step, carry=recipe['export']['carry'])
    return mean_valid(torch.nan_to_num(pixel_errors(batch, R, t), nan=1e4), batch)
