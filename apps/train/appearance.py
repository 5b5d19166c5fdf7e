"""What light, lenses and sensors do to an image: apps/eval/appearance.h and appearance_draw.h in numpy, number by number.

An image is a float32 array (h, w, 3), RGB in [0, 1]; so is the result. The same seed draws the same changes here and in
`iclk eval`, which the tests hold together.
"""
import math

import cv2
import numpy as np

F = np.float32
MASK = (1 << 64) - 1
REFERENCE, TARGET = 0, 1


# ----------------------------------------------------------------------------- the generator
def counter_word(seed, n):
    """Word n of the stream `seed` of SplitMix64."""
    z = (seed + (n + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ z >> 27) * 0x94D049BB133111EB) & MASK
    return z ^ z >> 31


def counter_words(seed, n):
    """The same for an array of n."""
    n = n.astype(np.uint64)
    with np.errstate(over='ignore'):
        z = np.uint64(seed) + (n + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ z >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ z >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return z ^ z >> np.uint64(31)


class Random:
    def __init__(self, seed):
        self.seed, self.n = seed, 0

    def word(self):
        self.n += 1
        return counter_word(self.seed, self.n - 1)

    def uniform(self, a=0.0, b=1.0):
        return a + (b - a) * ((self.word() >> 11) * 2.0 ** -53)

    def below(self, n):
        return int(n * self.uniform())

    def sign(self):
        return 1 if self.below(2) == 1 else -1


def fnv1a(text):
    h = 0xcbf29ce484222325
    for byte in text.encode():
        h = ((h ^ byte) * 0x100000001b3) & MASK
    return h


def appearance_seed(seed, pair, variant, side):
    s = counter_word(seed, 0)
    for word in (fnv1a(pair), variant, side):
        s = counter_word(s ^ word, 0)
    return s


# ----------------------------------------------------------------------------- drawing
def draw_jitter(s, random):
    order = [0, 1, 2, 3]
    for i in (3, 2, 1):
        j = random.below(i + 1)
        order[i], order[j] = order[j], order[i]
    least, hue = max(0.0, 1 - s), min(s, 0.5)
    factors = [random.uniform(least, 1 + s) for _ in range(3)] + [random.uniform(-hue, hue)]
    return jitter, dict(order=order, factors=factors)


def draw_exposure(s, random):
    sign = random.sign()
    return exposure, dict(stops=sign * 2.5 * s, black=0.0 if sign > 0 else 0.04 * s)


def draw_gamma(s, random):
    exponent = 1 + 1.5 * s
    return gamma, dict(exponent=exponent if random.sign() > 0 else 1 / exponent)


def draw_flare(s, random):
    x, y = random.uniform(-0.1, 1.1), random.uniform(-0.1, 1.1)
    return flare, dict(x=x, y=y, amount=0.9 * s, radius=random.uniform(0.08, 0.2))


def draw_shadow(s, random):
    values = [random.uniform(), random.uniform(), random.uniform(0, math.pi), random.uniform(0.15, 0.6),
              random.uniform(0.05, 0.25), random.uniform(0.002, 0.06)]
    names = ('x', 'y', 'angle', 'half_length', 'half_width', 'softness')
    return shadow, dict(zip(names, values), darkness=0.85 * s)


SEVERE = {  # in the order in which light meets them: the scene, the lens, the shutter, the sensor, the file
    'shadow': draw_shadow,
    'vignetting': lambda s, random: (vignetting, dict(fall_off=0.95 * s)),
    'flare': draw_flare,
    'motion_blur': lambda s, random: (motion_blur, dict(length=0.04 * s, angle=random.uniform(0, math.pi))),
    'exposure': draw_exposure,
    'noise': lambda s, random: (noise, dict(sigma=0.06 * s, shot=0.004 * s, seed=random.word())),
    'gamma': draw_gamma,
    'jpeg': lambda s, random: (jpeg, dict(quality=math.floor(95 - 87 * s + 0.5))),
}


def draw_haze(s, random):
    return haze, dict(density=2.5 * s, kx=random.uniform(-1.5, 1.5), ky=random.uniform(-1.5, 1.5), phase=random.uniform())


ADVERSE = {
    'haze': draw_haze,
    'flicker': lambda s, random: (flicker, dict(amount=0.5 * s, periods=random.uniform(0.5, 4), phase=random.uniform())),
    'banding': lambda s, random: (banding, dict(sigma=0.04 * s, seed=random.word())),
    'tone_map': lambda s, random: (tone_map, dict(amount=0.8 * s, radius=random.uniform(0.04, 0.12))),
}
FAMILIES = {'severe': SEVERE, 'adverse': ADVERSE}
KINDS = ['jitter', *SEVERE, 'severe', *ADVERSE, 'adverse']


def parse(text):
    """'jitter:0.4' -> ('jitter', 0.4); ValueError says what is wrong."""
    kind, colon, number = text.partition(':')
    if kind == 'clean' and not colon:
        return kind, 0.0
    if kind not in KINDS:
        raise ValueError(f'appearance {text!r}: kind must be clean, {", ".join(KINDS)}, then a colon and the strength')
    most = 2 if kind == 'jitter' else 1
    try:
        strength = 1.0 if kind in FAMILIES and not colon else float(number)
    except ValueError:
        strength = math.nan
    if not 0 < strength <= most:
        raise ValueError(f'appearance {text!r}: the strength must lie in (0, {most}], such as {kind}:0.4')
    return kind, strength


def draw_changes(kind, strength, seed):
    """[(function, parameters)] in the order in which they are applied."""
    random = Random(seed)
    if kind == 'clean':
        return []
    if kind not in FAMILIES:
        return [{'jitter': draw_jitter, **SEVERE, **ADVERSE}[kind](strength, random)]
    drawn, taken = [], []
    for draw in FAMILIES[kind].values():
        take = random.uniform() < 0.5
        own_strength = strength * random.uniform(0.2, 0.7)
        drawn.append(draw(own_strength, Random(random.word())))
        if take:
            taken.append(drawn[-1])
    return taken or [drawn[random.below(len(drawn))]]


def changed_image(image, changes):
    """An image after the changes, rounded to 8 bit as a camera's file is."""
    if not changes:
        return image
    for function, parameters in changes:
        image = function(image, **parameters)
    return np.rint(image * F(255)) / F(255)


# ----------------------------------------------------------------------------- colour jitter, as torchvision on float tensors
def clamped(x):
    return np.clip(x, F(0), F(1), out=x)


def grey(x):
    return F(0.2989) * x[..., 0] + F(0.587) * x[..., 1] + F(0.114) * x[..., 2]


def blend(x, other, ratio):
    return clamped(F(ratio) * x + F(1.0 - ratio) * other)


def brightness(x, factor):
    return blend(x, F(0), factor)


def contrast(x, factor):
    return blend(x, F(grey(x).mean(dtype=np.float64)), factor)


def saturation(x, factor):
    return blend(x, grey(x)[..., None], factor)


def hue(x, shift):
    r, g, b = x[..., 0], x[..., 1], x[..., 2]
    most = x.max(-1)
    span = most - x.min(-1)
    d = np.where(span > 0, span, F(1))
    rc, gc, bc = (most - r) / d, (most - g) / d, (most - b) / d
    h = np.where(most == r, bc - gc, np.where(most == g, F(2) + rc - bc, F(4) + gc - rc))
    h = np.fmod(h / F(6) + F(1), F(1)) + F(shift)
    h -= np.floor(h)
    s = span / np.where(most > 0, most, F(1))
    sector = np.floor(F(6) * h)
    f = F(6) * h - sector
    # most - what is taken from it: 0 for the largest channel, s for the least, s f and s (1 - f) for the one between.
    p, q, t = most * (1 - s), most * (1 - s * f), most * (1 - s * (1 - f))
    sector = sector.astype(np.int8) % 6
    out = np.empty_like(x)
    for channel, values in enumerate(([most, q, p, p, t, most], [t, most, most, q, p, p], [p, p, t, most, most, q])):
        out[..., channel] = np.choose(sector, values)
    return clamped(np.where(span[..., None] > 0, out, x))


def jitter(x, order, factors):
    for step in order:
        x = (brightness, contrast, saturation, hue)[step](x, factors[step])
    return x


# ----------------------------------------------------------------------------- severe changes
def frame(x, at_x, at_y):
    """Vectors from (at_x, at_y) of the image to its pixels, in diagonals."""
    h, w = x.shape[:2]
    w, h = max(w - 1, 1), max(h - 1, 1)
    diagonal = math.hypot(w, h)
    return (np.arange(x.shape[1]) - at_x * w)[None] / diagonal, (np.arange(x.shape[0]) - at_y * h)[:, None] / diagonal


def smooth_step(x):
    t = np.clip(x, 0, 1)
    return t * t * (3 - 2 * t)


def exposure(x, stops, black):
    return clamped(F(2.0 ** stops) * x - F(black))


def gamma(x, exponent):
    return clamped(np.power(np.maximum(x, F(0)), F(exponent)))


def vignetting(x, fall_off):
    du, dv = frame(x, 0.5, 0.5)
    return clamped(x * (1 - 4 * fall_off * (du * du + dv * dv)).astype(F)[..., None])


def flare(image, x, y, amount, radius):
    du, dv = frame(image, x, y)
    g = np.exp(-(du * du + dv * dv) / (2 * radius * radius))
    for along, size, strength in ((1.4, 0.35, 0.30), (1.8, 0.22, 0.40), (2.3, 0.55, 0.22)):
        du, dv = frame(image, x + along * (0.5 - x), y + along * (0.5 - y))
        ghost = size * radius
        g = g + strength * smooth_step((1.15 * ghost - np.hypot(du, dv)) / (0.3 * ghost))
    g = np.minimum(amount * g, 1).astype(F)[..., None]
    return clamped(1 - (1 - image) * (1 - g))


def motion_blur(x, length, angle):
    length *= x.shape[1]
    if length <= 0:
        return x
    half = math.ceil(length / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for i in range(4 * half):
        at = (i + 0.5) / (4 * half) / 2
        for side in (-1, 1):
            u, v = half + side * at * length * math.cos(angle), half + side * at * length * math.sin(angle)
            iu, iv = math.floor(u), math.floor(v)
            a, b = u - iu, v - iv
            kernel[iv:iv + 2, iu:iu + 2] += [[(1 - a) * (1 - b), a * (1 - b)], [(1 - a) * b, a * b]]
    kernel = (kernel / kernel.sum()).astype(F)
    return clamped(cv2.filter2D(x, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT_101))


def near_normal(seed, count):
    """`count` numbers of standard deviation 1, from 128 bits each."""
    words = counter_words(seed, np.arange(2 * count, dtype=np.uint64))
    total = sum((words >> np.uint64(shift) & np.uint64(0xFFFF)).astype(np.int64) for shift in (0, 16, 32, 48))
    return (total.reshape(-1, 2).sum(1) - 4 * 65535) / (65536 * math.sqrt(8 / 12))


def noise(x, sigma, shot, seed):
    wide = x.astype(np.float64)
    return clamped((wide + np.sqrt(sigma * sigma + shot * wide) * near_normal(seed, x.size).reshape(x.shape)).astype(F))


def jpeg(x, quality):
    _, file = cv2.imencode('.jpg', np.rint(x[..., ::-1] * F(255)).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(file, cv2.IMREAD_COLOR)[..., ::-1].astype(F) / F(255)


def shadow(image, x, y, angle, half_length, half_width, softness, darkness):
    du, dv = frame(image, x, y)
    c, s = math.cos(angle), math.sin(angle)
    along, across = np.abs(c * du + s * dv) - half_length, np.abs(c * dv - s * du) - half_width
    outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0)) + np.minimum(np.maximum(along, across), 0)
    light = 1 - darkness * smooth_step(0.5 - outside / max(softness, 1e-9))
    return clamped(image * light.astype(F)[..., None])


# ----------------------------------------------------------------------------- adverse changes
def shares(x):
    """Of the image's width and height, at its pixels."""
    h, w = x.shape[:2]
    return np.arange(w)[None] / max(w - 1, 1), np.arange(h)[:, None] / max(h - 1, 1)


def haze(x, density, kx, ky, phase, light=0.85):
    u, v = shares(x)
    clear = np.exp(-density * 0.5 * (1 + np.sin(2 * math.pi * (kx * u + ky * v + phase)))).astype(F)[..., None]
    return clamped(x * clear + F(light) * (1 - clear))


def flicker(x, amount, periods, phase):
    gain = 1 + amount * np.sin(2 * math.pi * (periods * shares(x)[1] + phase))
    return clamped(x * gain.astype(F)[..., None])


def banding(x, sigma, seed):
    h, w = x.shape[:2]
    n = sigma * near_normal(seed, w + h)
    return clamped(x + (n[None, :w] + n[w:, None]).astype(F)[..., None])


def tone_map(x, amount, radius):
    h, w = x.shape[:2]
    base = cv2.GaussianBlur(grey(x), (0, 0), max(radius * math.hypot(max(w - 1, 1), max(h - 1, 1)), 0.5),
                            borderType=cv2.BORDER_REFLECT_101)
    return clamped(x * np.power(0.5 / (0.05 + base.astype(np.float64)), amount).astype(F)[..., None])
