"""Kinds of deceptive pairs, for scripts/deceive.

Each takes a pair, a random generator, whether to be hard, and another picture.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np


@dataclass
class Scene:
    """A pair as a method gets it, and what is true of it."""

    image_0: np.ndarray
    image_1: np.ndarray
    depth: np.ndarray  # metres, what the method is told; 0: unknown
    K: np.ndarray  # fx fy cx cy, what the method is told
    truth: np.ndarray  # T_10; None: no pose is right
    true_depth: np.ndarray = None
    true_K: np.ndarray = None
    judged: np.ndarray = None  # pixels of image 0 that belong to the scene
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        self.true_depth = self.depth if self.true_depth is None else self.true_depth
        self.true_K = self.K if self.true_K is None else self.true_K
        self.judged = np.ones(self.depth.shape, bool) if self.judged is None else self.judged

    @property
    def size(self):
        return self.image_0.shape[1], self.image_0.shape[0]


# ---- what is fixed to the camera


def words(rng, scene, count, size, where=None):
    """A mask of text, and the same for both images."""
    w, h = scene.size
    mask = np.zeros((h, w), np.uint8)
    for _ in range(count):
        text = ''.join(rng.choice(list('ABCDEFGHKLMNPRSTUVXYZ0123456789:.-'), int(rng.integers(4, 11))))
        at = (int(rng.uniform(0, 0.85) * w), int(rng.uniform(0.06, 0.98) * h)) if where is None else where
        cv2.putText(mask, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, 255, 2, cv2.LINE_AA)
    return mask


def lay(scene, mask, value, opacity=1.0):
    """The same picture over both images."""
    a = (mask.astype(np.float32) / 255 * opacity)[..., None]
    over = np.broadcast_to(np.asarray(value, np.float32), scene.image_0.shape)
    put = lambda image: np.clip(image * (1 - a) + over * a + 0.5, 0, 255).astype(np.uint8)
    return replace(scene, image_0=put(scene.image_0), image_1=put(scene.image_1), judged=scene.judged & (mask < 8))


def time_stamp(rng, scene, hard, other):
    h = scene.size[1]
    mask = np.zeros(scene.image_0.shape[:2], np.uint8)
    for k in range(int(rng.integers(2, 5)) if hard else int(rng.integers(1, 3))):
        cv2.putText(
            mask,
            f'2026-{rng.integers(1, 12):02}-{rng.integers(1, 28):02} 12:{rng.integers(60):02} CAM {rng.integers(9)}',
            (10, h - 12 - 26 * k),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.8,
            255,
            2,
            cv2.LINE_AA,
        )
    if hard:
        for _ in range(2):
            cv2.circle(mask, (int(rng.uniform(0.1, 0.9) * scene.size[0]), 40), 22, 255, int(rng.integers(3, 8)))
    return lay(scene, mask, 255)


def hud(rng, scene, hard, other):
    mask = words(rng, scene, int(rng.integers(8, 61)) if hard else 4, 0.5)
    w, h = scene.size
    cv2.drawMarker(mask, (w // 2, h // 2), 255, cv2.MARKER_CROSS, 60, 2)
    return lay(scene, mask, (80, 255, 80))


def vehicle(rng, scene, hard, other):
    """The lower part of the view stands still; half of them with the depth that such a thing has."""
    w, h = scene.size
    share = rng.uniform(0.35, 0.65) if hard else rng.uniform(0.1, 0.3)
    mask = np.zeros((h, w), np.uint8)
    cv2.ellipse(mask, (w // 2, h), (int(0.6 * w), int(share * h)), 0, 180, 360, 255, -1)
    out = lay(scene, mask, 0.6 * cv2.resize(other, (w, h)))
    depth = out.depth.copy()
    if rng.random() < 0.5:
        depth[mask > 0] = rng.uniform(0.5, 2)
    return replace(out, depth=depth, true_depth=scene.depth)


def letterbox(rng, scene, hard, other):
    w, h = scene.size
    bar = int(rng.uniform(0.08, 0.16) * h)
    mask = np.zeros((h, w), np.uint8)
    mask[:bar], mask[-bar:] = 255, 255
    out = lay(scene, mask, 0)
    if not hard:
        return out
    text = np.maximum(words(rng, scene, 1, 0.9, (10, bar - 8)), words(rng, scene, 1, 1.0, (w // 4, h - 10)))
    return lay(out, text, 255)


def watermark(rng, scene, hard, other):
    return lay(scene, words(rng, scene, 30 if hard else 6, 1.0), 255, rng.uniform(0.3, 0.6) if hard else rng.uniform(0.1, 0.3))


def dirt(rng, scene, hard, other):
    mask = np.zeros(scene.image_0.shape[:2], np.uint8)
    for _ in range(int(rng.integers(60, 401)) if hard else int(rng.integers(5, 25))):
        at = (int(rng.uniform(0, scene.size[0])), int(rng.uniform(0, scene.size[1])))
        cv2.circle(mask, at, int(rng.integers(2, 7)), int(rng.integers(120, 256)), -1)
    return lay(scene, cv2.GaussianBlur(mask, (0, 0), 1), rng.uniform(0, 80))


def fixed_pattern(rng, scene, hard, other):
    noise = cv2.GaussianBlur(rng.normal(0, 1, scene.image_0.shape[:2]).astype(np.float32), (0, 0), 0.8)
    noise *= (rng.uniform(10, 60) if hard else rng.uniform(1, 6)) / noise.std()
    put = lambda image: np.clip(image + noise[..., None] + 0.5, 0, 255).astype(np.uint8)
    return replace(scene, image_0=put(scene.image_0), image_1=put(scene.image_1))


def reflection(rng, scene, hard, other):
    out = lay(
        scene,
        np.full(scene.image_0.shape[:2], 255, np.uint8),
        cv2.resize(other, scene.size),
        rng.uniform(0.3, 0.7) if hard else rng.uniform(0.08, 0.2),
    )
    return replace(out, judged=scene.judged)


# ---- what moves by itself


def mover(rng, scene, hard, other):
    """A piece of another picture that goes its own way, as a thing at the scene's depth would."""
    w, h = scene.size
    share = rng.uniform(0.3, 0.48) if hard else rng.uniform(0.12, 0.3)
    width, height = int(w * np.sqrt(share) * 1.13), int(h * np.sqrt(share) * 1.13)
    u, v = int(rng.uniform(0, w - width)), int(rng.uniform(0, h - height))
    du, dv = rng.uniform(8, 40, 2) * rng.choice([-1, 1], 2)
    mask = np.zeros((h, w), np.uint8)
    cv2.ellipse(mask, (u + width // 2, v + height // 2), (width // 2, height // 2), 0, 0, 360, 255, -1)
    paint = cv2.resize(other, (w, h)).astype(np.float32)
    images = []
    for image, (x, y) in ((scene.image_0, (0, 0)), (scene.image_1, (du, dv))):
        M = np.float32([[1, 0, x], [0, 1, y]])
        a = cv2.warpAffine(mask, M, (w, h))[..., None].astype(np.float32) / 255
        images.append((image * (1 - a) + cv2.warpAffine(paint, M, (w, h)) * a + 0.5).astype(np.uint8))
    depth = scene.depth.copy()
    if rng.random() < 0.5:
        depth[mask > 0] = rng.uniform(0.4, 0.9) * np.median(scene.depth[scene.depth > 0])
    return replace(
        scene, image_0=images[0], image_1=images[1], depth=depth, true_depth=scene.depth, judged=scene.judged & (mask == 0)
    )


def large_mover(rng, scene, hard, other):
    w, h = scene.size
    share = rng.uniform(0.5, 0.85)
    mask = np.zeros((h, w), np.uint8)
    mask[int((1 - share) * h) :] = 255
    paint = cv2.resize(other, (w, h)).astype(np.float32)
    du, dv = rng.uniform(8, 30, 2) * rng.choice([-1, 1], 2)
    images = []
    for image, shift in ((scene.image_0, 0), (scene.image_1, 1)):
        a = mask[..., None].astype(np.float32) / 255
        moved = cv2.warpAffine(
            paint, np.float32([[1, 0, du * shift], [0, 1, dv * shift]]), (w, h), borderMode=cv2.BORDER_REFLECT
        )
        images.append((image * (1 - a) + moved * a + 0.5).astype(np.uint8))
    return replace(scene, image_0=images[0], image_1=images[1], judged=scene.judged & (mask == 0))


# ---- light


def both(scene, f):
    put = lambda image: np.clip(f(image.astype(np.float32)) + 0.5, 0, 255).astype(np.uint8)
    return replace(scene, image_0=put(scene.image_0), image_1=put(scene.image_1))


def vignette(rng, scene, hard, other):
    w, h = scene.size
    v, u = np.mgrid[:h, :w]
    r2 = ((u - w / 2) ** 2 + (v - h / 2) ** 2) / (w * w + h * h) * 4
    fall = np.clip(1 - (rng.uniform(1.0, 2.2) if hard else rng.uniform(0.3, 0.9)) * r2, 0.01, 1)[..., None]
    return both(scene, lambda x: x * fall)


def lamp(rng, scene, hard, other):
    """A light on the camera, in the dark."""
    w, h = scene.size
    v, u = np.mgrid[:h, :w]
    d2 = (u - rng.uniform(0.3, 0.7) * w) ** 2 + (v - rng.uniform(0.3, 0.7) * h) ** 2
    spot = np.exp(-d2 / (2 * (rng.uniform(0.08, 0.2) if hard else rng.uniform(0.25, 0.5)) ** 2 * w * w))[..., None]
    return both(scene, lambda x: x * (0.03 + spot) + rng.normal(0, 1.5, x.shape))


def dark(rng, scene, hard, other):
    gain = rng.uniform(0.01, 0.06) if hard else rng.uniform(0.08, 0.3)
    return both(scene, lambda x: x * gain + rng.normal(0, 1.5, x.shape))


def jpeg(rng, scene, hard, other):
    quality = int(rng.integers(1, 9)) if hard else int(rng.integers(10, 40))
    code = lambda image: cv2.imdecode(cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    return replace(scene, image_0=code(scene.image_0), image_1=code(scene.image_1))


# ---- another picture


def unrelated(rng, scene, hard, other):
    return replace(scene, image_1=cv2.resize(other, scene.size), truth=None)


def mirrored(rng, scene, hard, other):
    return replace(scene, image_1=cv2.flip(scene.image_1, int(rng.integers(0, 2))), truth=None)


def half_doubled(rng, scene, hard, other):
    """The right half shows what the left does."""
    half = scene.size[0] // 2
    images = []
    for image in (scene.image_0, scene.image_1):
        images.append(np.hstack([image[:, :half], image[:, :half], image[:, 2 * half :]]))
    judged = scene.judged.copy()
    judged[:, half:] = False
    return replace(scene, image_0=images[0], image_1=images[1], judged=judged)


# ---- repeated structure: a wall and a floor


def tile_texture(rng, kind, unit):
    """4 x 4 periods of `unit` px, grey."""
    n = 4 * unit
    v, u = np.mgrid[:n, :n]
    noise = np.tile(rng.normal(0, 1, (unit, unit)).astype(np.float32), (3, 3))
    pattern = cv2.GaussianBlur(noise, (0, 0), unit / 24)[unit : 2 * unit, unit : 2 * unit]
    pattern = 130 + 25 * np.tile(pattern / pattern.std(), (4, 4))
    joint = unit / 20
    if kind == 'bricks':
        row = v // (unit // 2)
        pattern = 120 + 15 * (pattern - 130) / 25
        pattern[((u + (row % 2) * unit // 2) % unit < joint) | (v % (unit // 2) < joint)] = 200
    elif kind == 'windows':
        pattern = 150 + 0.1 * (pattern - 130)
        x, y = u % unit, v % unit
        pattern[(x > 0.25 * unit) & (x < 0.75 * unit) & (y > 0.2 * unit) & (y < 0.8 * unit)] = 60
        pattern[(abs(x - 0.5 * unit) < joint) & (y > 0.2 * unit) & (y < 0.8 * unit)] = 230
        pattern[(abs(y - 0.5 * unit) < joint) & (x > 0.25 * unit) & (x < 0.75 * unit)] = 230
    elif kind == 'railings':
        pattern = 90 + 0.3 * (pattern - 130) + 0 * u
        pattern[(u % (unit // 2) < unit // 8)] = 220
        pattern[(v % (2 * unit) < unit // 6)] = 200
    elif kind == 'crops':
        rows = cv2.GaussianBlur(rng.normal(0, 1, (n, n)).astype(np.float32), (0, 0), unit / 30)
        pattern = 100 + 12 * rows / rows.std() + 60 * (np.sin(2 * np.pi * u / unit * 2) > 0.2)
    else:
        pattern[(u % unit < joint) | (v % unit < joint)] = 215
    return pattern.astype(np.float32)


def wall(kind):
    def make(rng, scene, hard, other):
        w, h, K = 640, 480, np.array([420.0, 420, 319.5, 239.5])
        period, unit, n = rng.uniform(0.3, 0.8), 64, 1024
        texture = np.tile(tile_texture(rng, kind, unit), (4, 4))
        own = cv2.GaussianBlur(rng.normal(0, 1, (n, n)).astype(np.float32), (0, 0), 2)  # no two tiles are quite alike
        texture = texture + (rng.uniform(0, 2) if hard else rng.uniform(2, 8)) * own / own.std()
        if not hard:  # a poster
            s = int(rng.integers(120, 220))
            x, y = (int(a) for a in rng.uniform(300, 724 - s, 2))
            texture[y : y + s, x : x + s] = cv2.resize(cv2.cvtColor(other, cv2.COLOR_BGR2GRAY), (s, s))
        z = rng.uniform(2, 4)
        lean = rng.uniform(-0.5, 0.5, 2)
        normal = np.array([lean[0], lean[1], -1]) / np.linalg.norm([lean[0], lean[1], 1])
        point = np.array([0, 0, z])
        axis_u = np.cross([0, 1, 0], normal)
        axis_u /= np.linalg.norm(axis_u)
        axis_v = np.cross(normal, axis_u)
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(rng.normal(0, 0.02, 3))[0]
        T[:3, 3] = (
            axis_u * period * rng.uniform(-1.2, 1.2)
            + axis_v * period * rng.uniform(-0.6, 0.6)
            + [0, 0, rng.uniform(-0.1, 0.1) * z]
        )

        def view(T, scale=2):
            W, H = w * scale, h * scale
            v, u = np.mgrid[:H, :W]
            ray = np.stack(
                [((u + 0.5) / scale - 0.5 - K[2]) / K[0], ((v + 0.5) / scale - 0.5 - K[3]) / K[1], np.ones((H, W))], -1
            )
            C = -T[:3, :3].T @ T[:3, 3]
            d = ray @ T[:3, :3]
            with np.errstate(divide='ignore', invalid='ignore'):
                s = ((point - C) @ normal) / (d @ normal)
            at = C + s[..., None] * d - point
            tu, tv = at @ axis_u / period * unit + n / 2, at @ axis_v / period * unit + n / 2
            image = cv2.remap(
                texture, tu.astype(np.float32) % n, tv.astype(np.float32) % n, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
            )
            image = cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA) + rng.normal(0, 1.0, (h, w))
            depth = np.where((s > 0) & (s < 50), s, 0)[scale // 2 :: scale, scale // 2 :: scale].astype(np.float32)
            return cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR), depth

        (image_0, depth), (image_1, _) = view(np.eye(4)), view(T)
        return Scene(image_0, image_1, depth, K, T, meta={'period_px': float(period / z * 420)})

    return make


# ---- depth and camera that lie


def lie(depth_of):
    def make(rng, scene, hard, other):
        depth = depth_of(rng, scene, hard).astype(np.float32)
        return replace(
            scene, depth=np.where((scene.depth > 0) & np.isfinite(depth) & (depth > 0), depth, 0), true_depth=scene.depth
        )

    return make


def some_wrong(rng, scene, hard):
    """Patches of depth off by a factor from 0.3 to 3."""
    share, cell = (rng.uniform(0.2, 0.4) if hard else rng.uniform(0.05, 0.2)), 12
    h, w = scene.depth.shape
    shape = (h // cell + 1, w // cell + 1)
    factor = np.where(rng.random(shape) < share, np.exp(rng.uniform(np.log(0.3), np.log(3), shape)), 1)
    return scene.depth * np.kron(factor, np.ones((cell, cell)))[:h, :w]


def inverse_off(rng, scene, hard):
    q = 1 / np.maximum(scene.depth, 1e-6)
    return 1 / (q + (rng.uniform(0.05, 0.5) if hard else rng.uniform(0.01, 0.03)) * np.median(q[scene.depth > 0]))


def noisy(rng, scene, hard):
    return scene.depth * (1 + rng.normal(0, 0.05 if hard else 0.02, scene.depth.shape))


constant = lie(
    lambda rng, s, hard: np.full_like(s.depth, np.median(s.depth[s.depth > 0]) * (rng.uniform(0.5, 2) if hard else 1))
)
flipped = lie(lambda rng, s, hard: s.depth[:, ::-1])
shifted = lie(lambda rng, s, hard: np.roll(s.depth, int(rng.integers(24, 96)) if hard else int(rng.integers(2, 8)), 1))
saturated = lie(
    lambda rng, s, hard: np.where(s.depth > np.percentile(s.depth[s.depth > 0], 40 if hard else 75), 65.535, s.depth)
)
unit = lie(lambda rng, s, hard: s.depth * rng.choice([0.001, 0.01, 0.3, 3, 100]))


def photo(rng, scene, hard, other):
    """A photograph of a photograph."""
    w, h = scene.size
    reach = (0.12 if hard else 0.04) * np.float32([w, h])
    corners = np.float32([[0, 0], [w, 0], [w, h], [0, h]])
    H = cv2.getPerspectiveTransform(corners, (corners + rng.uniform(-1, 1, (4, 2)) * reach).astype(np.float32))
    return replace(scene, image_1=cv2.warpPerspective(scene.image_1, H, (w, h)), truth=None)


def intrinsics(rng, scene, hard, other):
    return replace(scene, K=scene.K * [f := rng.choice([0.7, 1.4]), f, 1, 1], true_K=scene.K)


def control(rng, scene, hard, other):
    return scene


def still(rng, scene, hard, other):
    """A camera on a tripod: noise of its own in each image."""
    noise = lambda: np.clip(scene.image_0 + rng.normal(0, 6 if hard else 2, scene.image_0.shape) + 0.5, 0, 255).astype(np.uint8)
    return replace(scene, image_0=noise(), image_1=noise(), truth=np.eye(4))


def still_passer(rng, scene, hard, other):
    return mover(rng, still(rng, scene, hard, other), hard, other)


KINDS = {
    'control': control,
    'still': still,
    'still_passer': still_passer,
    'time_stamp': time_stamp,
    'hud': hud,
    'vehicle': vehicle,
    'letterbox': letterbox,
    'watermark': watermark,
    'dirt': dirt,
    'fixed_pattern': fixed_pattern,
    'reflection': reflection,
    'mover': mover,
    'vignette': vignette,
    'lamp': lamp,
    'dark': dark,
    'jpeg': jpeg,
    'unrelated': unrelated,
    'mirrored': mirrored,
    'half_doubled': half_doubled,
    **{k: wall(k) for k in ('tiles', 'bricks', 'windows', 'railings', 'crops')},
    'some_wrong': lie(some_wrong),
    'noisy': lie(noisy),
    'constant': constant,
    'flipped': flipped,
    'shifted': shifted,
    'saturated': saturated,
}
# Nothing in two images shows these, or the object is the scene.
APART = {'large_mover': large_mover, 'inverse_off': lie(inverse_off), 'unit': unit, 'intrinsics': intrinsics, 'photo': photo}
