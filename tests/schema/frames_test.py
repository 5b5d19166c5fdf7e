"""What iclk track writes for its frames is what docs/schema says: tracked, keyframes, lost and unreadable."""
import json
import os
import pathlib
import subprocess
import tempfile
import unittest

import jsonschema

from lines import problems
from scene import png, texture

ICLK = os.environ['ICLK_COMMAND']
SCHEMA = json.loads((pathlib.Path(__file__).parents[2] / 'docs/schema/frame-1.json').read_text())
WIDTH, HEIGHT, SHIFT = 160, 120, 6
# Frames at 1 s, 2 s ...: how often the camera was shifted, or what it sees in the place of the wall.
FRAMES = ['no depth', 0, 1, 2, 'flat', 3, 'none', 4, 5, 6, 7]


class Frames(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        jsonschema.Draft202012Validator.check_schema(SCHEMA)
        cls.folder = tempfile.TemporaryDirectory()
        root = pathlib.Path(cls.folder.name)
        wide = texture(WIDTH + 7 * SHIFT, HEIGHT)
        images, depths = [], []
        for i, frame in enumerate(FRAMES, 1):
            shift = 0 if frame == 'no depth' else frame
            if frame == 'flat':
                png(root / 'flat.png', [[90] * WIDTH] * HEIGHT, 8)
            elif frame != 'none':
                png(root / f'{shift}.png', [row[SHIFT * shift:SHIFT * shift + WIDTH] for row in wide], 8)
            # A byte that is no UTF-8, as a file's name may have it.
            name = b'none\xff.png' if frame == 'none' else f'{shift}.png'.encode()
            images.append(b'%d %s' % (i, name))
            if frame != 'no depth':
                depths.append(b'%d d.png' % i)
        png(root / 'd.png', [[2000] * WIDTH] * HEIGHT, 16)
        (root / 'rgb.txt').write_bytes(b'\n'.join(images) + b'\n')
        (root / 'depth.txt').write_bytes(b'\n'.join(depths) + b'\n')
        done = subprocess.run([ICLK, 'track', '.', '--camera', '150,150,79.5,59.5', '--depth-scale', '1000', '--depth-sigma',
                               'rendered', '--solver', 'cpu', '--count', '60', '--seeds', '0', '--out', 'out'], cwd=root,
                              capture_output=True, timeout=300)
        assert done.returncode == 0, done.stderr
        cls.lines = (root / 'out/frames.jsonl').read_text().splitlines()
        cls.frames = [json.loads(line) for line in cls.lines]

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_every_line(self):
        self.assertEqual(problems(SCHEMA, self.lines), [])
        self.assertEqual([f['time'] for f in self.frames], list(range(1, len(FRAMES) + 1)))

    def test_every_kind_was_there(self):
        status = {frame: f['status'] for frame, f in zip(FRAMES, self.frames)}
        self.assertEqual([status[i] for i in ('no depth', 'flat', 'none')], ['lost'] * 3)
        self.assertEqual(status[0], 'keyframe')
        self.assertEqual({status[i] for i in range(1, 8)}, {'tracked', 'keyframe'})
        self.assertIn('none', self.frames[FRAMES.index('none')]['reason'])
        found = self.frames[-1]
        self.assertAlmostEqual(float(found['T_WC'].split()[0]), 7 * SHIFT * 2 / 150, delta=0.01)
        self.assertTrue(all(found['covariance'][i][i] > 0 for i in range(6)))

    def test_the_schema_is_not_satisfied_by_anything(self):
        found, lost = self.frames[-1], self.frames[0]
        for good, change in ((found, lambda f: f.pop('T_WC')), (found, lambda f: f.update(T_WC='0 0 0 0 0 1')),
                             (found, lambda f: f.update(status='lost')), (found, lambda f: f.update(new=1)),
                             (found, lambda f: f.update(schema='iclk-frame-2')), (found, lambda f: f.pop('schema')),
                             (found, lambda f: f['covariance'][3].pop()), (found, lambda f: f.update(inliers=2.5)),
                             (found, lambda f: f['ms'].pop('bundle')), (found, lambda f: f.update(sigma_px=None)),
                             (lost, lambda f: f.update(status='tracked')), (lost, lambda f: f.update(confirmed=True)),
                             (lost, lambda f: f.update(T_WC=found['T_WC']))):
            broken = json.loads(json.dumps(good))
            change(broken)
            self.assertNotEqual(problems(SCHEMA, [json.dumps(broken)]), [])


if __name__ == '__main__':
    unittest.main()
