"""Trains on a tiny rendered set: the loss falls, a killed run ends with the same weights, iclk gives PyTorch's poses."""
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import xml.etree.ElementTree

import cv2
import numpy as np
import torch

from common import ICLK, SOURCE, TRAIN, lines_of, render, train, train_command, write_recipe

import losses
import recipe
from data import PairSet, make_sample, read_pair
from network import TrainedNetwork, export, take_model
from reference import Network, align, read_safetensors
from run_folder import RunFolder, load_checkpoint

torch.set_num_threads(1)


def equal(a, b):
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(equal(x, y) for x, y in zip(a, b))
    return a == b or a != a and b != b


class Training(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp()
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        cls.set, cls.test = render(cls.file('set')), render(cls.file('test'), 4, seed=1)
        cls.recipe = write_recipe(cls.file('tiny.toml'))
        cls.arguments = ['run', '--recipe', cls.recipe, '--data', cls.set, '--test', cls.test, '--threads', '1']
        done = train(*cls.arguments, '--out', cls.file('whole'))
        assert done.returncode == 0, done.stderr
        cls.log, cls.state = done.stderr, load_checkpoint(cls.file('whole/checkpoint.pt'))

    @classmethod
    def file(cls, name):
        return os.path.join(cls.folder, name)

    def refused(self, *arguments):
        done = train(*arguments)
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertNotIn('Traceback', done.stderr)
        return done.stderr

    def network(self):
        network = TrainedNetwork(self.state['recipe']['model'])
        network.load_state_dict(self.state['network'])
        return network.eval()

    def test_the_loss_falls(self):
        with open(self.file('whole/curves.csv'), encoding='utf-8') as file:
            rows = {row['step']: {key: float(value) for key, value in row.items() if key != 'step' and value}
                    for row in csv.DictReader(file)}
        self.assertEqual(list(rows), ['initial', 'classical', '0', '12', '24'])
        self.assertLess(rows['24']['validation_loss'], 0.9 * rows['0']['validation_loss'])
        self.assertLess(rows['24']['training_loss'], 0.9 * rows['12']['training_loss'])
        self.assertLess(rows['24']['test_loss'], 0.9 * rows['0']['test_loss'])
        self.assertLess(rows['classical']['validation_median_px'], 0.3 * rows['initial']['validation_median_px'])
        self.assertLess(rows['24']['validation_loss'], rows['initial']['validation_loss'])
        starts = [line['meta']['start']['e_pixel'] for line in lines_of(self.test)]
        self.assertTrue(min(starts) < rows['initial']['test_mean_px'] < max(starts), 'what no motion means is iclk\'s figure')
        picture = xml.etree.ElementTree.parse(self.file('whole/curves.svg'))
        text = ''.join(picture.getroot().itertext())
        for word in ('training', 'validation', 'test', 'initial', 'classical'):
            self.assertIn(word, text)
        self.assertEqual(len([x for x in picture.getroot() if x.tag.endswith('polyline')]), 5)

    def test_another_set_validates(self):
        other = render(self.file('other'), 3, seed=2)
        run = ('run', '--recipe', self.recipe, '--data', self.set, '--out', self.file('validated'), '--set', 'schedule.steps=1')
        self.assertIn('must not share images', self.refused(*run, '--validation', self.set))
        done = train(*run, '--validation', other)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('12 training, 3 validation, 0 test pairs, 0 left out', done.stderr)

    def test_a_test_on_trained_images_is_refused(self):
        copy = shutil.copytree(self.set, self.file('copy'))
        why = self.refused('run', '--recipe', self.recipe, '--data', self.set, '--test', copy, '--out', self.file('refused'))
        self.assertIn('which is used for training', why)

    def test_a_killed_run_ends_with_the_same_weights(self):
        arguments = [*self.arguments, '--out', self.file('killed'), '--checkpoint-every', '1']
        process = subprocess.Popen(train_command(*arguments), stderr=subprocess.DEVNULL)
        path, limit = self.file('killed/checkpoint.pt'), time.monotonic() + 60
        step = 0
        while step < 4 and time.monotonic() < limit:
            time.sleep(0.02)
            try:
                step = load_checkpoint(path)['step'] if os.path.exists(path) else step
            except recipe.InputError:  # between two renames it is not there
                pass
        process.send_signal(signal.SIGKILL)
        process.wait()
        self.assertEqual(process.returncode, -signal.SIGKILL)
        self.assertLess(RunFolder(self.file('killed'), lock=False).load()['step'], 24)
        with open(path + '.tmp', 'wb') as file:  # what a kill while writing leaves
            file.write(b'PK half a file')
        done = train(*arguments)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('continuing at step', done.stderr)
        state = load_checkpoint(path)
        for key in ('step', 'network', 'optimizer', 'best', 'baselines'):
            self.assertTrue(equal(self.state[key], state[key]), key)
        for a, b in zip(self.state['rows'], state['rows']):
            self.assertTrue(equal({**a, 'seconds': 0}, {**b, 'seconds': 0}))
        for name in ('model.safetensors', 'last.safetensors'):
            with open(self.file('whole/' + name), 'rb') as a, open(self.file('killed/' + name), 'rb') as b:
                self.assertEqual(a.read(), b.read(), name)

    def test_a_signal_saves_and_says_so(self):
        # The second one goes to what reads ahead, too, as a cluster sends it.
        for name, more in (('stopped', []), ('group', ['--workers', '1'])):
            arguments = [*self.arguments, '--out', self.file(name), *more]
            process = subprocess.Popen(train_command(*arguments), stderr=subprocess.PIPE, text=True, start_new_session=True)
            said = ''
            for line in process.stderr:
                said += line
                if line.startswith('step 0:'):
                    time.sleep(1)  # the first process that reads ahead is there
                    os.killpg(process.pid, signal.SIGTERM)
            self.assertEqual(process.wait(), 6, said)
            process.stderr.close()
            self.assertIn('the same command continues', said)
            self.assertNotIn('Traceback', said)
            self.assertIn(load_checkpoint(self.file(name + '/checkpoint.pt'))['step'], range(24))

    def test_iclk_gives_the_same_poses(self):
        model = self.file('exported.safetensors')
        self.assertEqual(train('export', self.file('whole'), '--out', model, '--licence', 'CC0-1.0').returncode, 0)
        info = subprocess.run([ICLK, 'model', 'info', model], capture_output=True, text=True)
        for text in ('tiny', 'CC0-1.0', '24 steps', 'procedural:3 (seed 0)', 'jitter:0.4'):
            self.assertIn(text, info.stdout)
        network, settings = self.network(), recipe.load(self.recipe, ['data.appearance=["clean"]'])
        ways = ([], ['--set', 'carry=0'], ['--set', 'carry=1', '--solver', 'device'])
        pairs = PairSet(self.set)
        pairs.measure_motion()
        for pair, way in zip(pairs.pairs[:3], ways):
            batch = {k: x[None] for k, x in make_sample(pair, settings, np.random.default_rng(0), 0, True).items()}
            features = self.file('features.csv')
            with open(features, 'w', encoding='utf-8') as file:
                file.write('u,v,inverse_depth\n' + ''.join(f'{u},{v},{q:.9g}\n' for (u, v), q in
                                                           zip(batch['uv'][0].tolist(), batch['q'][0].tolist())))
            with torch.no_grad():
                R, t = align(network, *losses.maps_of(network, batch), losses.camera_of(batch), batch['uv'], batch['q'],
                             carry=float(way[1].removeprefix('carry=')) if way else settings['export']['carry'])
            camera = ','.join(str(x) for x in pair['camera'])
            command = [ICLK, 'align', pair['reference'], pair['target'], '--features', features, '--camera', camera,
                       '--model', model, '--json', '--set', 'refine=no', '--set', 'search=off', *way]
            found = subprocess.run(command, capture_output=True, text=True)
            T = np.array(json.loads(found.stdout)['stages'][0]['T_10'])
            scene = 1 / float(batch['q'].mean())
            np.testing.assert_allclose(T[:3, :3], R[0], atol=1e-4)
            np.testing.assert_allclose(T[:3, 3] / scene, t[0] / scene, atol=1e-4)
            moved = np.abs(T[:3, :3] - np.eye(3)).max() + np.abs(T[:3, 3]).max() / scene
            self.assertGreater(moved, 1e-2, 'a pose that no motion would give, too')

    def test_folding_changes_nothing(self):
        torch.manual_seed(3)
        network = TrainedNetwork(self.state['recipe']['model'])
        for m in network.modules():
            if isinstance(m, torch.nn.BatchNorm2d):
                m.running_mean.normal_(0, 0.5)
                m.running_var.uniform_(0.3, 3)
                m.weight.data.uniform_(0.5, 2)
                m.bias.data.normal_(0, 0.5)
        path = self.file('folded.safetensors')
        export(network.eval(), path, 'folded', 'CC0-1.0', 'random', 10, 1e-6, 0.1)
        plain, images, x = Network.load(path)[0], torch.rand(2, 3, 40, 56), torch.rand(2, 4, 40, 56)
        with torch.no_grad():
            for a, b in zip(network(images), plain(images)):
                self.assertLess(float((a - b).abs().max()), 1e-5 * float(a.abs().max()) + 1e-6)
            self.assertLess(float((network.m_estimator(x) - plain.m_estimator(x)).abs().max()), 1e-5)

    def test_bfloat16_is_for_training_alone(self):
        torch.manual_seed(4)
        exact = TrainedNetwork(self.state['recipe']['model'])
        mixed = TrainedNetwork(self.state['recipe']['model'], bfloat16=True)
        mixed.load_state_dict(exact.state_dict())
        images = torch.rand(2, 3, 40, 56)
        for network in (exact, mixed):
            network.train()
        for a, b in zip(exact(images), mixed(images)):
            self.assertEqual(b.dtype, torch.float32)
            self.assertFalse(torch.equal(a, b))
            self.assertLess(float((a - b).abs().max()), 0.05 * float(a.abs().max()))
        mixed.load_state_dict(exact.state_dict())
        for network in (exact, mixed):
            network.eval()
        for a, b in zip(exact(images), mixed(images)):
            self.assertTrue(torch.equal(a, b))

    def test_weights_begin_another_run(self):
        def run(out, init, *settings):
            arguments = [*self.arguments, '--init', self.file(init), '--out', self.file(out), '--set', 'schedule.steps=1']
            return train(*arguments, *(x for setting in settings for x in ('--set', setting)))
        without = ('model.m_estimator_channels=[]', 'model.m_estimator_dilations=[]')
        still = ('optimizer.learning_rate=1e-12', 'optimizer.bfloat16=true')
        done = run('encoder', 'whole/checkpoint.pt', *without, *still)
        self.assertEqual(done.returncode, 0, done.stderr)
        encoder = load_checkpoint(self.file('encoder/checkpoint.pt'))['network']
        self.assertFalse([key for key in encoder if key.startswith('m_estimator')])
        done = run('again', 'encoder/checkpoint.pt', *still)
        self.assertEqual(done.returncode, 0, done.stderr)
        again = load_checkpoint(self.file('again/checkpoint.pt'))['network']
        self.assertEqual(again.keys(), self.state['network'].keys())
        info = subprocess.run([ICLK, 'model', 'info', self.file('again/model.safetensors')], capture_output=True, text=True)
        self.assertRegex(info.stdout, r'tiny, 24 steps of 2 pairs.*; then.* 1 steps.*; then.* 1 steps')
        for key, x in again.items():
            if key.endswith('weight') and not key.startswith('m_estimator'):
                torch.testing.assert_close(x, self.state['network'][key], atol=1e-6, rtol=0)
        done = run('wider', 'whole/checkpoint.pt', 'model.encoder_channels=[[4, 8, 8], [8, 8, 8], [8, 12, 16]]')
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn('give a recipe with the same model', done.stderr)

    def test_a_model_begins_a_run(self):
        path, images = self.file('whole/last.safetensors'), torch.rand(3, 3, 40, 48, generator=torch.Generator().manual_seed(1))
        model = self.state['recipe']['model']
        given = Network.load(path)[0]
        network = TrainedNetwork(model)
        self.assertRegex(take_model(network, path), '13 of 13 layers began as those of tiny: trained by iclk')
        weights = torch.rand(2, 4, 40, 48, generator=torch.Generator().manual_seed(2))
        for same in (network.eval(), network.train()):
            with torch.no_grad():
                for a, b in zip((*same(images), same.m_estimator(weights)), (*given(images), given.m_estimator(weights))):
                    torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)
        wider = TrainedNetwork({**model, 'encoder_channels': [[4, 8, 8], [8, 16, 8], [8, 12, 12]]})
        self.assertIn('11 of 13 layers', take_model(wider, path))
        self.assertTrue(torch.equal(wider.levels[2][1][0].weight, given.levels[2][1][0].weight))
        for changed, why in (({'encoder_channels': [[6, 6, 6]], 'encoder_dilations': [[1, 2, 2]],
                               'm_estimator_channels': [], 'm_estimator_dilations': []}, 'none of its layers'),
                             ({'normalisation': 'fixed'}, '--set model.normalisation=image')):
            with self.assertRaisesRegex(recipe.InputError, why):
                take_model(TrainedNetwork({**model, **changed}), path)
        done = train(*self.arguments, '--init', path, '--out', self.file('from_model'), '--set', 'schedule.steps=1')
        self.assertEqual(done.returncode, 0, done.stderr)
        info = subprocess.run([ICLK, 'model', 'info', self.file('from_model/last.safetensors')], capture_output=True, text=True)
        self.assertRegex(info.stdout, r'13 of 13 layers .* tiny, 24 steps of 2 pairs.*; then.* 1 steps')

    def test_derivatives_are_those_of_differences(self):
        settings = recipe.load(self.recipe, ['loss.step_bound=0'])
        pair = {**PairSet(self.set).pairs[0], 'motion': (0.08, 0.04)}
        batch = make_sample(pair, settings, np.random.default_rng(0), 0, True)
        batch = {key: x[None].double() for key, x in batch.items()}
        network = self.network().double()
        for kind in ('each_level', 'unrolled'):
            settings['loss']['kind'] = kind
            weight = network.levels[1][0][0].weight

            def loss():
                return losses.recipe_loss(network, batch, settings).sum()
            network.zero_grad()
            loss().backward()
            direction, size = weight.grad / weight.grad.norm(), float(weight.grad.norm())
            ends = []
            with torch.no_grad():
                for sign in (1, -2, 1):
                    weight += sign * 1e-6 * direction
                    ends.append(float(loss()))
            self.assertAlmostEqual((ends[0] - ends[1]) / 2e-6, size, delta=0.01 * size, msg=kind)

    def test_a_set_that_moves_far_leaves_the_starts_of_another(self):
        near, far = (PairSet(self.set) for _ in range(2))
        for pair in far.pairs:
            pair['t'] = 20 * pair['t']
        starts = []
        for s in (near, far):
            s.measure_motion()
            s.pairs[0]['R'], s.pairs[0]['t'] = np.eye(3), np.zeros(3)
            settings = recipe.load(self.recipe)
            batch = make_sample(s.pairs[0], settings, np.random.default_rng(0), 0, True)
            starts.append(losses.start_pose({k: x[None] for k, x in batch.items()}, 0, 3, settings))
        torch.testing.assert_close(starts[1][1], 20 * starts[0][1], rtol=0.1, atol=0)
        torch.testing.assert_close(starts[1][0], starts[0][0], rtol=0.1, atol=1e-3)

    def test_another_recipe_or_other_pairs_are_refused(self):
        out = ['--out', self.file('whole')]
        said = self.refused(*self.arguments, *out, '--set', 'data.batch=3')
        self.assertIn('data.batch was 2, now 3', said)
        self.assertIn('other pairs', self.refused('run', '--recipe', self.recipe, '--data', self.set, *out))
        self.assertIn('data.no', self.refused(*self.arguments, *out, '--set', 'data.no=1'))
        self.assertIn('paper', self.refused('run', '--recipe', 'none', '--data', self.set, *out))

    def test_a_broken_set_is_named(self):
        broken = shutil.copytree(self.set, self.file('broken'))
        run = ['run', '--recipe', self.recipe, '--data', broken, '--out', self.file('no_run')]
        manifest = os.path.join(broken, 'pairs.jsonl')
        with open(manifest, encoding='utf-8') as file:
            lines = file.read().splitlines(keepends=True)

        def with_lines(*changed):
            with open(manifest, 'w', encoding='utf-8') as file:
                file.writelines(changed)
            return self.refused(*run)
        self.assertIn('pairs.jsonl:3: not a JSON object', with_lines(*lines[:2], lines[2][:100]))
        self.assertIn("'truth' is missing", with_lines(lines[0].replace('"truth"', '"meta"'), *lines[1:]))
        self.assertIn('no pairs', with_lines())
        with_lines_of_all = ''.join(lines)
        with open(manifest, 'w', encoding='utf-8') as file:
            file.write(with_lines_of_all)
        for name in ('images', 'depth'):
            for file in os.listdir(os.path.join(broken, name)):
                with open(os.path.join(broken, name, file), 'wb') as image:
                    image.write(b'no image')
            said = self.refused(*run)
            self.assertIn(f'broken/{name}/0000', said)
            self.assertIn('render the set again', said)
            shutil.rmtree(os.path.join(broken, name))
            shutil.copytree(os.path.join(self.set, name), os.path.join(broken, name))
        self.assertIn('nothing: No such file', self.refused(*run[:3], '--data', self.file('nothing'), *run[5:]))
        said = self.refused(*run, '--set', 'data.crop=[400,300]')
        self.assertIn('is 188x120, smaller than the crop of 400x300', said)

    def test_a_recording_becomes_pairs(self):
        folder, line = self.file('recording'), lines_of(self.set)[0]
        os.mkdir(folder)
        depth = cv2.imread(os.path.join(self.set, line['depth']), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(os.path.join(folder, 'depth.png'), np.rint(depth * 100).astype(np.uint16))
        lists = {'rgb.txt': '# time file\n', 'depth.txt': '', 'groundtruth.txt': '',
                 'camera.txt': '# fx fy cx cy width height scale\n'}
        for time_, name, T in ((1.0, 'reference', line['meta']['T_W0']), (2.0, 'target', line['meta']['T_W1'])):
            T = np.array(T)
            axis = cv2.Rodrigues(T[:3, :3])[0][:, 0]
            angle = np.linalg.norm(axis)
            q = [*np.sin(angle / 2) * axis / angle, np.cos(angle / 2)]
            lists['rgb.txt'] += f'{time_} {os.path.join(self.set, line[name])}\n'
            lists['depth.txt'] += f'{time_ + 0.01} depth.png\n'
            lists['groundtruth.txt'] += f'{time_ - 0.02} ' + ' '.join(f'{x:.12g}' for x in [*T[:3, 3], *q]) + '\n'
        lists['camera.txt'] += ' '.join(map(str, line['camera'])) + ' 188 120 100\n'
        for name, text in lists.items():
            with open(os.path.join(folder, name), 'w', encoding='utf-8') as file:
                file.write(text)
        manifest = self.file('recorded.jsonl')
        done = train('pairs', folder, '--stride', '1', '--out', manifest)
        self.assertEqual(done.returncode, 0, done.stderr)
        (pair,), rendered = PairSet(manifest).pairs, PairSet(self.set).pairs[0]
        np.testing.assert_allclose(pair['R'], rendered['R'], atol=1e-9)
        np.testing.assert_allclose(pair['t'], rendered['t'], atol=1e-6)
        np.testing.assert_allclose(read_pair(pair)[1], depth, atol=0.006)
        os.remove(os.path.join(folder, 'groundtruth.txt'))
        self.assertIn('groundtruth.txt: No such file', self.refused('pairs', folder, '--out', manifest))

    def test_a_broken_checkpoint_is_named(self):
        folder = shutil.copytree(self.file('whole'), self.file('cut'))
        path = os.path.join(folder, 'checkpoint.pt')
        with open(path, 'r+b') as file:
            file.truncate(os.path.getsize(path) // 2)
        said = self.refused(*self.arguments, '--out', folder)
        self.assertIn('cut/checkpoint.pt cannot be read', said)
        self.assertIn('checkpoint.previous.pt', said)
        os.remove(os.path.join(folder, 'checkpoint.previous.pt'))
        self.assertIn('start again', self.refused(*self.arguments, '--out', folder))
        self.assertIn('no checkpoint', self.refused('export', self.folder, '--out', self.file('x.safetensors')))

    def test_a_missing_module_is_named(self):
        code = f'import sys; sys.path.insert(0, {TRAIN!r}); from modules import need; need("torch", "no_such_module")'
        done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
        self.assertEqual(done.returncode, 2)
        self.assertIn('has no module no_such_module. On Debian: apt install', done.stderr)

    def test_a_broken_model_is_named(self):
        path = self.file('cut.safetensors')
        shutil.copyfile(os.path.join(SOURCE, 'models', 'sd6dof-small.safetensors'), path)
        with open(path, 'r+b') as file:
            file.truncate(os.path.getsize(path) // 2)
        for broken, why in ((path, 'damaged'), (os.path.join(TRAIN, 'bench.py'), 'not a safetensors file'),
                            (self.file('none'), 'No such file')):
            with self.assertRaises(SystemExit) as refusal:
                read_safetensors(broken)
            self.assertIn(broken, str(refusal.exception))
            self.assertIn(why, str(refusal.exception))


if __name__ == '__main__':
    unittest.main()
