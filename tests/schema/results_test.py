"""What iclk writes is what docs/schema says: results of real runs, converged and failed, against the schema."""
import json
import os
import pathlib
import subprocess
import tempfile
import unittest

import jsonschema

from scene import png, texture

ICLK = os.environ['ICLK_COMMAND']
SCHEMA = json.loads((pathlib.Path(__file__).parents[2] / 'docs/schema/result-1.json').read_text())
WIDTH, HEIGHT, SHIFT = 160, 120, 3


class Schema(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.root = pathlib.Path(cls.folder.name)
        wide = texture(WIDTH + SHIFT, HEIGHT)
        png(cls.root / 'a.png', [row[:WIDTH] for row in wide], 8)
        png(cls.root / 'b.png', [row[SHIFT:] for row in wide], 8)
        png(cls.root / 'flat.png', [[90] * WIDTH] * HEIGHT, 8)
        png(cls.root / 'd.png', [[2000 + 4 * u for u in range(WIDTH)] for _ in range(HEIGHT)], 16)
        (cls.root / 'truth.txt').write_text('-0.05 0 0 0 0 0 1\n')
        jsonschema.Draft202012Validator.check_schema(SCHEMA)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def iclk(self, *arguments):
        environment = {**os.environ, 'ICLK_MODEL': 'classical'}
        done = subprocess.run([ICLK, *arguments], cwd=self.root, env=environment, capture_output=True, text=True, timeout=300)
        self.assertIn(done.returncode, (0, 10, 11, 12, 13, 14, 20), done.stderr)
        return done.stdout

    def align(self, target, *more):
        return json.loads(self.iclk('align', 'a.png', target, '--depth', 'd.png', '--depth-scale', '1000', '--camera',
                                    '150,150,79.5,59.5', '--solver', 'cpu', '--json', *more))

    def check(self, value, kind):
        validator = jsonschema.Draft202012Validator({'$ref': '#/$defs/' + kind, '$defs': SCHEMA['$defs']})
        problems = ['/'.join(map(str, e.absolute_path)) + ': ' + e.message[:300] for e in validator.iter_errors(value)]
        self.assertEqual(problems, [])
        # One of the four kinds, and no other.
        self.assertEqual([e.message for e in jsonschema.Draft202012Validator(SCHEMA).iter_errors(value)], [])

    def test_align_that_converged(self):
        for more in ([], ['--truth', 'truth.txt'], ['--set', 'refine=no'], ['--set', 'structure=yes']):
            result = self.align('b.png', *more)
            self.check(result, 'aligned')
            self.assertEqual(result['status'], 'converged', result['reason'])
            self.assertEqual(result['camera'], {'fx': 150, 'fy': 150, 'cx': 79.5, 'cy': 59.5, 'width': WIDTH, 'height': HEIGHT})
            aligned = [f for f in result['features'] if f['status'] == 'aligned']
            self.assertEqual(len(aligned) == 0, 'refine=no' in more)
            for f in aligned:
                (a, b), (c, d) = f['covariance']
                self.assertTrue(a > 0 and d > 0 and b == c and a * d > b * b, f)
                self.assertEqual('structure=yes' in more, f.get('inverse_depth_sigma', 0) > 0)

    def test_align_that_failed(self):
        alone = ['--set', 'refine=no', '--set', 'search=off']
        for target, more in (('flat.png', []), ('b.png', ['--count', '6']), ('flat.png', alone)):
            result = self.align(target, *more)
            self.check(result, 'aligned')
            self.assertNotEqual(result['status'], 'converged')
            self.assertEqual(result['covariance'], [[None] * 6] * 6)

    def test_the_result_file(self):
        self.iclk('align', 'a.png', 'b.png', '--depth', 'd.png', '--depth-scale', '1000', '--camera', '150,150,79.5,59.5',
                  '--solver', 'cpu', '--out', 'out')
        self.check(json.loads((self.root / 'out/result.json').read_text()), 'aligned')

    def test_batch(self):
        pair = {'reference': 'a.png', 'target': 'b.png', 'depth': 'd.png', 'depth_scale': 1000,
                'camera': [150, 150, 79.5, 59.5]}
        lines = [{**pair, 'id': 'good', 'truth': 'truth.txt', 'meta': {'frame': 3}},
                 {**pair, 'id': 'flat', 'target': 'flat.png'},
                 {**pair, 'id': 'missing', 'target': 'none.png'}, {**pair, 'id': 'typo', 'depht': 'd.png'}]
        (self.root / 'm.jsonl').write_text('\n'.join(map(json.dumps, lines)) + '\n{"id": \n')
        for out, more in (('plain.jsonl', []), ('features.jsonl', ['--with-features'])):
            self.iclk('batch', 'm.jsonl', '--out', out, '--solver', 'cpu', *more)
            header, *results = map(json.loads, (self.root / out).read_text().splitlines())
            self.check(header, 'batch_header')
            self.assertEqual(len(results), 5)
            for result in results:
                self.check(result, 'batch_error' if result['status'] == 'error' else 'batch_line')
                self.assertEqual('features' in result, bool(more) and result['status'] != 'error')
            status = {result['id']: result['status'] for result in results}
            self.assertEqual([status[i] for i in ('good', 'missing', 'typo', 'line 5')],
                             ['converged', 'error', 'error', 'error'])
            self.assertNotIn(status['flat'], ('converged', 'error'))

    def test_the_schema_is_not_satisfied_by_anything(self):
        good = self.align('b.png')
        for change in (lambda r: r.pop('gain'), lambda r: r.update(new=1), lambda r: r.update(status='fine'),
                       lambda r: r['covariance'][2].pop(), lambda r: r['features'][0].pop('u0'),
                       lambda r: r.update(schema='iclk-result-2'), lambda r: r['covariance'][0].__setitem__(0, None)):
            broken = json.loads(json.dumps(good))
            change(broken)
            self.assertFalse(jsonschema.Draft202012Validator(SCHEMA).is_valid(broken))


if __name__ == '__main__':
    unittest.main()
