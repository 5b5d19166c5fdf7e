"""Appearance in Python is that of iclk: jitter and the generator by the numbers of the C++ test, the other changes by numbers
that apps/eval/appearance.cpp gave."""
import os
import re
import unittest

import numpy as np

from common import SOURCE

import appearance

EXPECTED = os.path.join(SOURCE, 'tests', 'apps', 'appearance_expected.h')
# Means of R, G and B, then the pixels (0, 0), (11, 7) and (20, 15), of pattern() after apply_change().
SEVERE = {
    'exposure': [0.256612, 0.257886, 0.257706, 0.000000, 0.000000, 0.029828, 0.394779, 0.011880, 0.209312, 0.233243, 0.017862,
                 0.382813],
    'gamma': [0.367600, 0.371197, 0.370930, 0.000000, 0.006582, 0.021386, 0.598795, 0.011663, 0.225757, 0.265466, 0.014635,
              0.570404],
    'vignetting': [0.352879, 0.353660, 0.353315, 0.000000, 0.010417, 0.020833, 0.732350, 0.072204, 0.412592, 0.253036, 0.046007,
                   0.396806],
    'flare': [0.577888, 0.580734, 0.581836, 0.194345, 0.236306, 0.278267, 0.793898, 0.266277, 0.538332, 0.534720, 0.212602,
              0.758412],
    'motion_blur': [0.498276, 0.499470, 0.497334, 0.163971, 0.338218, 0.474752, 0.615259, 0.479905, 0.581902, 0.458333,
                    0.490322, 0.420412],
    'noise': [0.499413, 0.495550, 0.498324, 0.000000, 0.116239, 0.169479, 0.673420, 0.014898, 0.494622, 0.418767, 0.046224,
              0.644154],
    'jpeg': [0.496451, 0.497086, 0.501080, 0.000000, 0.109804, 0.231373, 0.396078, 0.305882, 0.235294, 0.356863, 0.219608,
             0.196078],
    'shadow': [0.419264, 0.417291, 0.421461, 0.000000, 0.052083, 0.104167, 0.739583, 0.072917, 0.416667, 0.458333, 0.083333,
               0.718750],
}
ADVERSE = {
    'haze': [0.654587, 0.657641, 0.656756, 0.633087, 0.646378, 0.659669, 0.815670, 0.608397, 0.715272, 0.691221, 0.539198,
             0.796792],
    'flicker': [0.470440, 0.466085, 0.469251, 0.000000, 0.071897, 0.143794, 0.739583, 0.072917, 0.416667, 0.283973, 0.051631,
                0.445321],
    'banding': [0.511644, 0.513641, 0.512990, 0.031478, 0.083561, 0.135645, 0.741228, 0.074562, 0.418312, 0.487247, 0.112247,
                0.747664],
    'tone_map': [0.467998, 0.471852, 0.471768, 0.000000, 0.052232, 0.104464, 0.691330, 0.068159, 0.389482, 0.434343, 0.078971,
                 0.681129],
}
PARAMETERS = {
    'exposure': dict(stops=-0.8, black=0.03), 'gamma': dict(exponent=1.7), 'vignetting': dict(fall_off=0.8),
    'flare': dict(x=0.2, y=0.3, amount=0.7, radius=0.15), 'motion_blur': dict(length=0.2, angle=0.6),
    'noise': dict(sigma=0.05, shot=0.003, seed=99), 'jpeg': dict(quality=40),
    'shadow': dict(x=0.4, y=0.6, angle=0.7, half_length=0.3, half_width=0.1, softness=0.05, darkness=0.7),
    'haze': dict(density=1.4, kx=0.9, ky=-0.6, phase=0.2), 'flicker': dict(amount=0.4, periods=1.7, phase=0.3),
    'banding': dict(sigma=0.03, seed=99), 'tone_map': dict(amount=0.6, radius=0.08),
}


def pattern():
    v, u, k = np.mgrid[0:18, 0:24, 0:3]
    return ((7 * u + 13 * v + 5 * k * (u + 2 * v + 1)) % 97).astype(np.float32) / np.float32(96)


class Jitter(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with open(EXPECTED, encoding='utf-8') as file:
            text = file.read()
        cls.values = {name: [float(x.strip().rstrip('fu')) if '.' in x or 'e' in x else int(x.strip().rstrip('u'))
                             for x in body.split(',')]
                      for name, body in re.findall(r'constexpr \w+ (k\w+)\[\] = \{([^}]*)\}', text)}
        cls.seed = int(re.search(r'kSeed = (\d+)u', text).group(1))
        cls.image = np.array(cls.values['kImage'], np.float32).reshape(2, 3, 3)

    def test_each_step_is_that_of_the_cpp_test(self):
        steps = {'kBrighter': (appearance.brightness, 1.4), 'kDarker': (appearance.brightness, 0.6),
                 'kContrast': (appearance.contrast, 1.5), 'kFlat': (appearance.contrast, 0.25),
                 'kSaturated': (appearance.saturation, 1.7), 'kPale': (appearance.saturation, 0.2),
                 'kHueUp': (appearance.hue, 0.3), 'kHueDown': (appearance.hue, -0.45)}
        for name, (function, factor) in steps.items():
            np.testing.assert_allclose(function(self.image, factor).reshape(-1), self.values[name], atol=2e-6, err_msg=name)
        everything = appearance.jitter(self.image, [2, 0, 3, 1], [0.75, 1.3, 1.6, 0.12])
        np.testing.assert_allclose(everything.reshape(-1), self.values['kAll'], atol=2e-6)

    def test_the_same_seed_draws_the_same(self):
        self.assertEqual([appearance.counter_word(42, n) for n in range(3)], self.values['kWords'])
        self.assertEqual(appearance.counter_words(42, np.arange(3)).tolist(), self.values['kWords'])
        seed = appearance.appearance_seed(7, '000012', 3, appearance.TARGET)
        self.assertEqual(seed, self.seed)
        (_, drawn), = appearance.draw_changes('jitter', 0.4, seed)
        self.assertEqual(drawn['order'], self.values['kOrder'])
        np.testing.assert_allclose(drawn['factors'], self.values['kFactors'], rtol=1e-15)

    def test_noise_is_that_of_the_cpp_test(self):
        noisy = appearance.noise(np.full((1, 2, 3), 0.5, np.float32), 0.1, 0, 99)
        np.testing.assert_allclose(noisy.reshape(-1), 0.5 + 0.1 * np.array(self.values['kNormals']), atol=1e-6)


class Families(unittest.TestCase):
    def test_numbers_of_the_cpp_code(self):
        image = pattern()
        for name, expected in (SEVERE | ADVERSE).items():
            out = getattr(appearance, name)(image.copy(), **PARAMETERS[name])
            numbers = np.concatenate([out.mean((0, 1)), out[0, 0], out[7, 11], out[15, 20]])
            # Versions of libjpeg may round otherwise.
            np.testing.assert_allclose(numbers, expected, atol=0.02 if name == 'jpeg' else 3e-6, err_msg=name)

    def test_each_takes_half_of_its_changes(self):
        for family, changes in appearance.FAMILIES.items():
            counts = [len(appearance.draw_changes(family, 1.0, seed)) for seed in range(200)]
            self.assertGreaterEqual(min(counts), 1)
            self.assertLess(abs(np.mean(counts) - len(changes) / 2), 0.5, family)

    def test_specs_are_refused_by_name(self):
        for bad in ('', 'jitter', 'jitter:x', 'jitter:2.5', 'noise:0', 'noise:nan', 'rain:1', 'clean:1'):
            with self.assertRaisesRegex(ValueError, 'appearance'):
                appearance.parse(bad)


if __name__ == '__main__':
    unittest.main()
