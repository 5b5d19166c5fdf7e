"""What the tests of the trainer share: its modules, a rendered set, a small recipe."""
import json
import os
import subprocess
import sys
import unittest

os.environ.setdefault('OMP_NUM_THREADS', '1')
SOURCE = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
TRAIN = os.path.join(SOURCE, 'apps', 'train')
ICLK = os.environ['ICLK_COMMAND']
sys.path.insert(0, TRAIN)

RECIPE = '''
name = "tiny"
[model]
encoder_channels = [[4, 8, 8], [8, 8, 8], [8, 12, 12]]
m_estimator_channels = [8, 8, 16, 1]
[data]
batch = 2
crop = []
[loss]
iterations = 3
[optimizer]
learning_rate = 4e-3
[schedule]
steps = 24
[validation]
every = 12
pairs = 4
'''


def render(folder, pairs=12, seed=0):
    command = [ICLK, 'render', '--terrain', 'procedural:3', '--size', '188x120', '--pairs', str(pairs), '--seed', str(seed),
               '--out', folder]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode == 5 and os.environ.get('ICLK_ALLOW_NO_DEVICE') == '1':
        raise unittest.SkipTest(done.stderr)
    assert done.returncode == 0, done.stderr
    return folder


def lines_of(folder):
    with open(os.path.join(folder, 'pairs.jsonl'), encoding='utf-8') as file:
        return [json.loads(line) for line in file]


def write_recipe(path):
    with open(path, 'w', encoding='utf-8') as file:
        file.write(RECIPE)
    return path


def train_command(*arguments):
    return [sys.executable, os.path.join(TRAIN, 'train.py'), *arguments]


def train(*arguments):
    return subprocess.run(train_command(*arguments), capture_output=True, text=True)
