"""The training loop: steps, validation, checkpoints, curves, export."""
import hashlib
import math
import signal
import sys
import time

import numpy as np
import torch

import curves
import losses
from data import FixedBatches, PairSet, TrainingBatches, epoch_samples, mixed, refuse_shared_images, split
from files import write_text
from network import TrainedNetwork, export, take_model
from recipe import InputError, difference
from run_folder import RunFolder, load_checkpoint

MOST_SKIPPED = 20  # steps in a row without a finite gradient


def duration(seconds):
    minutes = int(seconds // 60)
    return f'{minutes // 60} h {minutes % 60:02d} min' if minutes >= 60 else f'{minutes} min {int(seconds % 60):02d} s'


def plain_signals(worker):
    """What reads ahead leaves Ctrl-C to the trainer, and ends when it is told to."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


class Trainer:
    def __init__(self, recipe, sets, tests, out, device='cpu', workers=0, init=None, validation_sets=()):
        self.recipe, self.device, self.workers = recipe, device, workers
        self.folder = RunFolder(out)
        sets, validation_sets, tests = ([PairSet(path) for path in paths] for paths in (sets, validation_sets, tests))
        refuse_shared_images(sets, [*validation_sets, *tests])
        for s in (*sets, *validation_sets, *tests):
            s.measure_motion()
        if validation_sets:
            self.training, validation = mixed(sets), in_turn(validation_sets)
        else:
            self.training, validation = split(sets, recipe['data']['validation_share'])
        fixed = {'validation': validation, 'test': in_turn(tests)}
        self.fixed = {part: FixedBatches(pairs, recipe, part) for part, pairs in fixed.items() if pairs}
        all_pairs = [[p['id'], p['R'].tolist(), p['t'].tolist()] for p in self.training + validation + fixed['test']]
        self.data = {'hash': hashlib.sha256(repr(all_pairs).encode()).hexdigest(), 'training': len(self.training),
                     'validation': len(validation), 'test': len(fixed['test']), 'about': ', '.join(s.about for s in sets),
                     'left_out': sum(len(s.pairs) for s in sets + validation_sets) - len(self.training) - len(validation)}
        batch, schedule = recipe['data']['batch'], recipe['schedule']
        self.epoch_steps = epoch_samples(self.training, recipe) / batch
        validation_epochs = recipe['validation']['epochs']
        self.every = math.ceil(validation_epochs * self.epoch_steps) if validation_epochs else recipe['validation']['every']
        self.steps = math.ceil(schedule['epochs'] * self.epoch_steps) if schedule['epochs'] else schedule['steps']

        torch.manual_seed(recipe['seed'])
        self.network = TrainedNetwork(recipe['model'], recipe['optimizer']['bfloat16']).to(device)
        optimizer = recipe['optimizer']
        if optimizer['kind'] == 'adam':
            self.optimizer = torch.optim.Adam(self.network.parameters(), optimizer['learning_rate'],
                                              weight_decay=optimizer['weight_decay'])
        else:
            self.optimizer = torch.optim.SGD(self.network.parameters(), optimizer['learning_rate'], optimizer['momentum'],
                                             weight_decay=optimizer['weight_decay'])
        self.step, self.rows, self.best, self.seconds, self.skipped = 0, [], math.inf, 0.0, 0
        self.sum, self.count = 0.0, 0  # of the training loss since the last row
        self.baselines, self.stopping = None, False
        self.before = ''  # what the runs did whose weights this one began with
        state = self.folder.load()
        if state:
            self.restore(state)
        elif init:
            self.take_weights(init)

    # ------------------------------------------------------------------------- state
    def state(self):
        return {'recipe': self.recipe, 'data': self.data, 'step': self.step, 'network': self.network.state_dict(),
                'optimizer': self.optimizer.state_dict()['state'], 'rows': self.rows, 'best': self.best,
                'seconds': self.seconds, 'sum': self.sum, 'count': self.count, 'skipped': self.skipped,
                'baselines': self.baselines, 'before': self.before}

    def restore(self, state):
        where = self.folder.path
        changed = difference(state['recipe'], self.recipe)
        if changed:
            raise InputError(f'{where}: was started with another recipe: {changed}; give the same recipe, or another --out')
        if state['data']['hash'] != self.data['hash']:
            counts = [', '.join(f'{d[part]} {part}' for part in ('training', 'validation', 'test'))
                      for d in (state['data'], self.data)]
            raise InputError(f'{where}: was started with other pairs ({counts[0]}; now {counts[1]}); give the same sets in the '
                             'same order, or another --out')
        self.network.load_state_dict(state['network'])
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), 'state': state['optimizer']})
        for key in ('step', 'rows', 'best', 'seconds', 'sum', 'count', 'skipped', 'baselines'):
            setattr(self, key, state[key])
        self.before = state.get('before', '')

    def take_weights(self, path):
        """Weights of another run's checkpoint, to go on from with another recipe or other sets. An M-estimator may be new, or
        left behind. Of a model file: see take_model()."""
        if path.endswith('.safetensors'):
            self.before = take_model(self.network, path)
            return
        state = load_checkpoint(path)
        models = [dict(r['model']) for r in (state['recipe'], self.recipe)]
        weights = state['network']
        if models[0]['m_estimator_channels'] != models[1]['m_estimator_channels'] and [] in (
                m['m_estimator_channels'] for m in models):
            weights = {k: x for k, x in weights.items() if not k.startswith('m_estimator.')}
            weights |= {k: x for k, x in self.network.state_dict().items() if k.startswith('m_estimator.')}
        try:
            self.network.load_state_dict(weights)
        except RuntimeError:
            raise InputError(f'{path}: its model is {state["recipe"]["model"]}, but the recipe has {self.recipe["model"]}; '
                             'give a recipe with the same model') from None
        self.before = provenance(state['recipe'], state['data'], state['step'], state.get('before', ''))

    def learning_rate(self):
        rate, schedule = self.recipe['optimizer']['learning_rate'], self.recipe['schedule']
        if schedule['kind'] == 'cosine':
            return rate * 0.5 * (1 + math.cos(math.pi * self.step / self.steps))
        return rate * schedule['decay'] ** sum(self.step >= e * self.epoch_steps for e in schedule['decay_epochs'])

    # ------------------------------------------------------------------------- validation
    def on_device(self, batch):
        return {key: x.to(self.device, non_blocking=True) for key, x in batch.items()}

    @torch.no_grad()
    def errors(self, network, part):
        network.eval()
        all_losses, pixels = [], []
        for batch in self.loader(self.fixed[part], range(len(self.fixed[part]))):
            batch = self.on_device(batch)
            all_losses.append(losses.recipe_loss(network, batch, self.recipe).cpu())
            pixels.append(losses.final_errors(network, batch, self.recipe).cpu())
        px = torch.cat(pixels).numpy()
        return {'loss': float(torch.cat(all_losses).mean()), 'median_px': float(np.median(px)), 'mean_px': float(px.mean()),
                'below_1px': float((px < 1).mean())}

    def validate(self):
        levels = len(self.recipe['model']['encoder_channels'])
        if self.baselines is None:
            self.baselines = {name: {part: self.errors(method(levels).to(self.device), part) for part in self.fixed}
                              for name, method in (('initial', losses.Still), ('classical', losses.Classical))}
        row = {'step': self.step, 'epoch': self.step / self.epoch_steps, 'seconds': self.seconds,
               'learning_rate': self.learning_rate(), 'training_loss': self.sum / self.count if self.count else math.nan}
        self.sum, self.count = 0.0, 0
        for part in self.fixed:
            row.update({f'{part}_{error}': value for error, value in self.errors(self.network, part).items()})
        self.rows.append(row)
        self.export('last.safetensors')
        if row['validation_loss'] < self.best:
            self.best = row['validation_loss']
            self.export('model.safetensors')
        self.save()
        trained = f'training loss {row["training_loss"]:.4f}; ' if self.step else ''
        parts = (f'{part} loss {row[part + "_loss"]:.4f}, median {row[part + "_median_px"]:.3g} px, '
                 f'{100 * row[part + "_below_1px"]:.0f} % under 1 px' for part in self.fixed)
        self.say(f'step {self.step}: {trained}{"; ".join(parts)}', keep=True)

    def export(self, name):
        export_model(self.network, self.folder.file(name), self.recipe,
                     provenance(self.recipe, self.data, self.step, self.before))

    def save(self):
        self.folder.save(self.state())
        if self.rows:
            write_text(self.folder.file('curves.csv'), curves.csv(self.rows, self.baselines))
            title = f'recipe {self.recipe["name"]}, {self.data["training"]} pairs'
            write_text(self.folder.file('curves.svg'), curves.svg(title, self.rows, self.baselines, self.step))

    # ------------------------------------------------------------------------- steps
    def loader(self, dataset, items):
        return torch.utils.data.DataLoader(dataset, batch_size=None, sampler=items, num_workers=self.workers,
                                           worker_init_fn=plain_signals, pin_memory=self.device == 'cuda')

    def train_step(self, batch):
        for group in self.optimizer.param_groups:
            group['lr'] = self.learning_rate()
        self.optimizer.zero_grad(set_to_none=True)
        self.network.train()
        loss = losses.recipe_loss(self.network, self.on_device(batch), self.recipe).mean()
        loss.backward()
        clip = self.recipe['optimizer']['clip']
        norm = float(torch.nn.utils.clip_grad_norm_(self.network.parameters(), clip if clip > 0 else math.inf))
        value = float(loss.detach())
        if math.isfinite(norm) and math.isfinite(value):
            self.optimizer.step()
            self.sum, self.count, self.skipped = self.sum + value, self.count + 1, 0
        else:
            self.skipped += 1
            if self.skipped >= MOST_SKIPPED:
                raise InputError(f'{MOST_SKIPPED} steps in a row had no finite gradient, the last at step {self.step}; start '
                                 'again from a checkpoint (--init) with a lower optimizer.learning_rate')
        self.step += 1
        return value

    def run(self, checkpoint_every=None, checkpoint_seconds=300, minutes=None):
        """Trains to the end of the schedule, or until a signal or the time asks to stop; True at the end."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self.stop)
        d = self.data
        parameters = sum(p.numel() for p in self.network.parameters())
        self.say(f'recipe {self.recipe["name"]}: {parameters} parameters, {d["training"]} training, '
                 f'{d["validation"]} validation, {d["test"]} test pairs, {d["left_out"]} left out between; '
                 f'{self.steps} steps on {self.device}'
                 + (f', continuing at step {self.step}' if self.step else ''), keep=True)
        begin = saved = shown = time.monotonic()
        first, mean = self.step, None
        if self.step == 0 and not self.rows:
            self.validate()
        batches = iter(self.loader(TrainingBatches(self.training, self.recipe), range(self.step, self.steps)))
        last = time.monotonic()
        while self.step < self.steps:
            try:
                value = self.train_step(next(batches))
            except RuntimeError:  # a signal to the whole group of processes has ended what reads ahead
                if not self.stopping:
                    raise
                return self.stopped()
            if self.step % self.every == 0 or self.step == self.steps:
                self.validate()
                saved = time.monotonic()
            now = time.monotonic()
            self.seconds += now - last
            last = now
            mean = value if mean is None else 0.95 * mean + 0.05 * value
            if self.step < self.steps and (self.stopping or (minutes is not None and now - begin > 60 * minutes)):
                return self.stopped()
            if now - saved > checkpoint_seconds or (checkpoint_every and self.step % checkpoint_every == 0):
                self.save()
                saved = now
            if now - shown > (0.5 if sys.stderr.isatty() else 30):
                pace = (now - begin) / (self.step - first)
                self.say(f'step {self.step}/{self.steps}  epoch {self.step / self.epoch_steps:.2f}  loss {mean:.4f}  rate '
                         f'{self.learning_rate():.2e}  {pace:.2f} s per step  {duration(pace * (self.steps - self.step))} left')
                shown = now
        self.say(f'done: {self.steps} steps in {duration(self.seconds)}; model {self.folder.file("model.safetensors")}, curves '
                 f'{self.folder.file("curves.svg")}', keep=True)
        return True

    def stopped(self):
        self.save()
        self.say(f'stopped at step {self.step} of {self.steps}; the same command continues', keep=True)
        return False

    def stop(self, number, frame):
        if self.stopping:
            sys.exit(128 + number)
        self.stopping = True
        # Of a signal to the whole group what reads ahead dies, too. PyTorch's handler would then raise an error wherever the
        # program is, in the middle of saving as well.
        signal.signal(signal.SIGCHLD, lambda *_: None)
        self.say('stopping after this step; a second signal stops at once', keep=True)

    @staticmethod
    def say(text, keep=False):
        """On a terminal a line of progress is written over by the next."""
        if sys.stderr.isatty():
            sys.stderr.write('\r\x1b[K' + text + ('\n' if keep else ''))
        else:
            sys.stderr.write(text + '\n')
        sys.stderr.flush()


def in_turn(sets):
    """Pairs of several sets in turn, so that the first ones are of all."""
    most = max((len(s.pairs) for s in sets), default=0)
    return [s.pairs[i] for i in range(most) for s in sets if i < len(s.pairs)]


def provenance(recipe, data, step, before):
    text = (f'recipe {recipe["name"]}, {step} steps of {recipe["data"]["batch"]} pairs, appearance '
            f'{", ".join(recipe["data"]["appearance"])}, on {data["training"]} pairs of {data["about"]}')
    return f'{before}; then {text}' if before else f'trained by iclk apps/train: {text}'


def export_model(network, path, recipe, about, name=None, licence=None):
    export(network, path, name or recipe['name'], licence or recipe['export']['licence'], about[:4000],
           recipe['export']['iterations'], recipe['export']['damping'], recipe['export']['carry'])
