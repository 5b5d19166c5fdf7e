#!/usr/bin/env python3
"""The numbers that appearance_test.cpp expects: colour jitter as torchvision documents it (transforms.functional on float32
tensors), and the generator by which changes are drawn, the trainer's. Needs numpy and OpenCV; with --torchvision FILE it
compares its own jitter with torchvision's _functional_tensor.py (which needs torch).

    appearance_reference.py > appearance_expected.h

It shares no code with apps/eval/appearance.cpp.
"""
import importlib.util
import math
import os
import sys

import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), '..', '..', 'apps', 'train'))
from appearance import Random, appearance_seed, counter_word, fnv1a

F = np.float32

# 2 x 3 pixels, RGB of 255: a grey, a pure colour, black, white and two of no order.
PIXELS = np.array([[[128, 128, 128], [255, 0, 0], [12, 200, 77]], [[0, 0, 0], [255, 255, 255], [90, 30, 222]]])


# ----------------------------------------------------------------------------- torchvision's formulas
def grey(x):
    return F(0.2989) * x[..., 0] + F(0.587) * x[..., 1] + F(0.114) * x[..., 2]


def blend(x, other, ratio):
    return np.clip(F(ratio) * x + F(1.0 - ratio) * other, F(0), F(1)).astype(F)


def brightness(x, factor):
    return blend(x, np.zeros_like(x), factor)


def contrast(x, factor):
    return blend(x, grey(x).mean(dtype=np.float64).astype(F), factor)


def saturation(x, factor):
    return blend(x, grey(x)[..., None], factor)


def hue(x, shift):
    r, g, b = x[..., 0], x[..., 1], x[..., 2]
    most, least = x.max(-1), x.min(-1)
    same = most == least
    s = (most - least) / np.where(same, F(1), most)
    d = np.where(same, F(1), most - least)
    rc, gc, bc = (most - r) / d, (most - g) / d, (most - b) / d
    h = np.where(most == r, bc - gc, np.where(most == g, F(2) + rc - bc, F(4) + gc - rc))
    h = np.fmod(h / F(6) + F(1), F(1))
    h = np.mod(h + F(shift), F(1))
    i = np.floor(h * F(6))
    f = h * F(6) - i
    i = i.astype(int) % 6
    p, q, t = most * (F(1) - s), most * (F(1) - s * f), most * (F(1) - s * (F(1) - f))
    table = [(most, t, p), (q, most, p), (p, most, t), (p, q, most), (t, p, most), (most, p, q)]
    out = np.zeros_like(x)
    for k, rgb in enumerate(table):
        for c in range(3):
            out[..., c] = np.where(i == k, rgb[c], out[..., c])
    return np.clip(out, F(0), F(1))


STEPS = [brightness, contrast, saturation, hue]


def jitter(x, order, factors):
    for step in order:
        x = STEPS[step](x, factors[step])
    return x


# ----------------------------------------------------------------------------- what is drawn
def draw_jitter(strength, random):
    order = [0, 1, 2, 3]
    for i in (3, 2, 1):
        j = random.below(i + 1)
        order[i], order[j] = order[j], order[i]
    low, h = max(0.0, 1 - strength), min(strength, 0.5)
    return order, [random.uniform(low, 1 + strength) for _ in range(3)] + [random.uniform(-h, h)]


def draw_shadow(s, r):
    return dict(x=r.uniform(), y=r.uniform(), angle=r.uniform(0, math.pi), half_length=r.uniform(0.15, 0.6),
                half_width=r.uniform(0.05, 0.25), softness=r.uniform(0.002, 0.06), darkness=0.85 * s)


def draw_flare(s, r):
    return dict(x=r.uniform(-0.1, 1.1), y=r.uniform(-0.1, 1.1), amount=0.9 * s, radius=r.uniform(0.08, 0.2))


def draw_exposure(s, r):
    sign = r.sign()
    return dict(stops=sign * 2.5 * s, black=0 if sign > 0 else 0.04 * s)


def draw_gamma(s, r):
    return dict(exponent=(1 + 1.5 * s) if r.sign() > 0 else 1 / (1 + 1.5 * s))


SEVERE = [('shadow', draw_shadow), ('vignetting', lambda s, r: dict(fall_off=0.95 * s)), ('flare', draw_flare),
          ('motion_blur', lambda s, r: dict(length=0.04 * s, angle=r.uniform(0, math.pi))), ('exposure', draw_exposure),
          ('noise', lambda s, r: dict(sigma=0.06 * s, shot=0.004 * s, seed=r.word())), ('gamma', draw_gamma),
          ('jpeg', lambda s, r: dict(quality=math.floor(95 - 87 * s + 0.5)))]


def draw_severe(strength, random):
    """-> [(name, parameters)]"""
    drawn, taken = [], []
    for name, draw in SEVERE:
        take, s = random.uniform() < 0.5, strength * random.uniform(0.2, 0.7)
        drawn.append((name, draw(s, Random(random.word()))))
        if take:
            taken.append(drawn[-1])
    return taken or [drawn[random.below(8)]]


def normal(seed, i):
    words = counter_word(seed, 2 * i), counter_word(seed, 2 * i + 1)
    total = sum(word >> shift & 0xFFFF for word in words for shift in (0, 16, 32, 48))
    return (total - 4 * 65535) / (65536 * (8 / 12) ** 0.5)


# ----------------------------------------------------------------------------- output
def values(name, x):
    numbers = ', '.join('%.9gf' % v if '.' in '%.9g' % v or 'e' in '%.9g' % v else '%.9g.0f' % v for v in x.reshape(-1))
    print('constexpr float %s[] = {%s};' % (name, numbers))


def main():
    image = (PIXELS.astype(F) / F(255)).astype(F)
    cases = [('kBrighter', [0], [1.4, 1, 1, 0]), ('kDarker', [0], [0.6, 1, 1, 0]), ('kContrast', [1], [1, 1.5, 1, 0]),
             ('kFlat', [1], [1, 0.25, 1, 0]), ('kSaturated', [2], [1, 1, 1.7, 0]), ('kPale', [2], [1, 1, 0.2, 0]),
             ('kHueUp', [3], [1, 1, 1, 0.3]), ('kHueDown', [3], [1, 1, 1, -0.45]),
             ('kAll', [2, 0, 3, 1], [0.75, 1.3, 1.6, 0.12])]
    if len(sys.argv) == 3 and sys.argv[1] == '--torchvision':
        import torch
        spec = importlib.util.spec_from_file_location('functional', sys.argv[2])
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        theirs = [module.adjust_brightness, module.adjust_contrast, module.adjust_saturation, module.adjust_hue]
        large = np.random.default_rng(0).random((97, 103, 3)).astype(F)
        for x in (image, large):
            for name, order, factors in cases:
                tensor = torch.from_numpy(x.transpose(2, 0, 1).copy())
                for step in order:
                    tensor = theirs[step](tensor, factors[step])
                print('%-12s %.1e' % (name, np.abs(tensor.numpy().transpose(1, 2, 0) - jitter(x, order, factors)).max()))
        return
    print('// Written by appearance_reference.py.')
    print('#pragma once')
    print('#include <cstdint>\n')
    print('namespace iclk::expected {\n')
    print('// RGB, row by row.')
    values('kImage', image)
    for name, order, factors in cases:
        values(name, jitter(image, order, factors))
    print()
    print('constexpr uint64_t kWords[] = {%s};' % ', '.join('%du' % counter_word(42, n) for n in range(3)))
    print('constexpr uint64_t kSeed = %du;  // appearance_seed(7, "000012", 3, target)' % appearance_seed(7, '000012', 3, 1))
    order, factors = draw_jitter(0.4, Random(appearance_seed(7, '000012', 3, 1)))
    print('constexpr int kOrder[] = {%s};' % ', '.join(map(str, order)))
    print('constexpr double kFactors[] = {%s};' % ', '.join('%.17g' % f for f in factors))
    severe = [c for variant in range(6) for c in draw_severe(0.9, Random(appearance_seed(7, '000012', variant, 0)))]
    print('// Of severe:0.9, seed 7, pair 000012, reference, variants 0 to 5: names, and all parameters in their order.')
    print('constexpr const char* kSevere[] = {%s};' % ', '.join('"%s"' % name for name, _ in severe))
    print('constexpr double kSevereNumbers[] = {%s};' % ', '.join('%.17g' % v for _, p in severe for v in p.values()))
    print('constexpr double kNormals[] = {%s};' % ', '.join('%.17g' % normal(99, i) for i in range(6)))
    print('\n}  // namespace iclk::expected')


main()
