"""What is trained on and what is not: sets are cut by frames and by place, and an epoch is what the paper means by it."""
import json
import os
import tempfile
import unittest
import unittest.mock

import numpy as np

import common  # noqa: F401, the trainer is found through it
import recipe
from data import PairSet, TrainingBatches, epoch_samples, split


class Split(unittest.TestCase):
    def test_nothing_that_validates_is_trained_on(self):
        def line(a, b, **more):
            return json.dumps({'id': f'{a}-{b}', 'reference': f'{a}.png', 'target': f'{b}.png', 'depth': f'{a}.tiff',
                               'camera': [100, 100, 50, 40], 'truth': np.eye(4).tolist(), **more})
        frames = [line(a, a + stride) for stride in (1, 2, 3) for a in range(40 - stride)]
        eye, rng = np.eye(4), np.random.default_rng(0)

        def at(x):
            T = eye.copy()
            T[0, 3] = x
            return T.tolist()
        places = [line(f'{i}a', f'{i}b', meta={'T_W0': at(x), 'T_W1': at(x + 5), 'altitude': 100})
                  for i, x in enumerate(rng.uniform(0, 1000, 60))]
        for name, lines in (('frames', frames), ('places', places)):
            with tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, 'pairs.jsonl')
                with open(path, 'w', encoding='utf-8') as file:
                    file.write('\n'.join(lines))
                training, validation = split([PairSet(path)], 0.2)
            images = [{p[key] for p in part for key in ('reference', 'target')} for part in (training, validation)]
            self.assertFalse(images[0] & images[1], name)
            self.assertAlmostEqual(len(validation), 0.2 * len(lines), delta=2)
            self.assertGreater(len(training), 0.5 * len(lines))
            if name == 'places':  # nor is their ground
                self.assertLess(max(p['strip'][1] for p in training), min(p['strip'][0] for p in validation))

    def test_an_epoch_has_every_variant_of_every_pair(self):
        paper = recipe.load("paper")
        self.assertEqual(epoch_samples([0] * 7, paper), 70)
        self.assertEqual((paper['schedule']['epochs'], paper['validation']['epochs']), (26, 5))
        drawn = []
        with unittest.mock.patch('data.make_sample', lambda pair, *rest, **more: drawn.append((pair, rest[2])) or {
                'images': np.zeros(1)}), unittest.mock.patch('data.collate', lambda samples, what: samples):
            batches = TrainingBatches(list('abc'), {'data': {'batch': 5, 'variants': 10}, 'seed': 0})
            for step in range(6):
                batches[step]
        self.assertEqual(sorted(drawn), [(pair, variant) for pair in 'abc' for variant in range(10)])


if __name__ == '__main__':
    unittest.main()
