"""A run on the disk. Files are whole or not there: each is written beside its name, flushed to the disk and renamed.

    checkpoint.pt            the state that a run continues from; checkpoint.previous.pt is the one before
    curves.csv, curves.svg   losses and errors
    model.safetensors        the weights with the least validation loss so far, for iclk
    last.safetensors         the weights of the last validation
"""
import fcntl
import json
import os
import zipfile

import torch

from files import write_whole
from recipe import InputError

FORMAT = 'iclk-training-1'
TENSORS = ('network', 'optimizer')


class RunFolder:
    def __init__(self, path, lock=True):
        self.path = path
        if lock:
            try:
                os.makedirs(path, exist_ok=True)
                self.lock = open(self.file('lock'), 'w')
                fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f'{path}: another process trains in this folder; stop it, or give another --out') from None
            except OSError as e:
                raise InputError(f'{path}: {e.strerror}; give a folder that can be written as --out') from None

    def file(self, name):
        return os.path.join(self.path, name)

    def save(self, state):
        tensors = {key: value for key, value in state.items() if key in TENSORS}
        # The rest as text: what PyTorch 1.13 reads without running code that is in the file has no floats.
        rest = json.dumps({key: value for key, value in state.items() if key not in TENSORS})
        write_whole(self.file('checkpoint.new.pt'),
                    lambda temporary: torch.save({'format': FORMAT, 'rest': rest, **tensors}, temporary))
        if os.path.exists(self.file('checkpoint.pt')):  # a run that is killed here finds the new one
            os.replace(self.file('checkpoint.pt'), self.file('checkpoint.previous.pt'))
        os.replace(self.file('checkpoint.new.pt'), self.file('checkpoint.pt'))

    def load(self):
        """The state, or None where there is none. A kill between the two renames of save() leaves the previous one."""
        for name in ('checkpoint.pt', 'checkpoint.new.pt', 'checkpoint.previous.pt'):
            if os.path.exists(self.file(name)):
                return load_checkpoint(self.file(name))
        return None


def load_checkpoint(path):
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError('it is truncated, or not a PyTorch file')
        state = torch.load(path, map_location='cpu', weights_only=True)
        if not isinstance(state, dict) or state.get('format') != FORMAT:
            raise ValueError(f'its format is not {FORMAT}')
        state = {**json.loads(state.pop('rest')), **state}
        for section, key, before in (('model', 'normalisation', 'fixed'), ('export', 'carry', 0.1)):
            state['recipe'][section].setdefault(key, before)  # of runs from before there was a choice
        return state
    except Exception as e:  # torch raises RuntimeError, UnpicklingError, EOFError, KeyError, ...
        why = str(e).splitlines()[0] if str(e) else type(e).__name__
        folder = os.path.dirname(path)
        previous = os.path.join(folder, 'checkpoint.previous.pt')
        remedy = (f'move {previous} there to continue from it' if os.path.exists(previous) and previous != path
                  else 'remove it to start again, or give another --out')
        raise InputError(f'checkpoint {path} cannot be read: {why}; {remedy}') from None
