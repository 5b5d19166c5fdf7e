#!/usr/bin/env python3
"""Trains the model of SD-6DoF-ICLK and writes it for `iclk --model`. See docs/guide/training.md.

    train.py run --data SET ... --out RUN          trains, or continues a run that was stopped
    train.py export RUN --out model.safetensors    writes the model of a checkpoint
    train.py pairs RECORDING --out pairs.jsonl     lists training pairs of an RGB-D recording in the TUM layout

Examples:
  iclk render --terrain procedural:7 --pairs 1000 --size 376x240 --out set
  apps/train/train.py run --data set --out run                              the recipe `ours`
  apps/train/train.py run --data set --out run                              continues after a kill
  apps/train/train.py run --data a b --test c --recipe paper --out run_paper --device cuda --workers 8
  apps/train/train.py run --data set --out run2 --set schedule.steps=2000 --set 'data.appearance=["jitter:0.8"]'
  apps/train/train.py run --data set2 --out tuned --init run/checkpoint.pt  starts from the weights of another run
  apps/train/train.py run --data set --out own --init models/sd6dof-small.safetensors \\
    --set 'model.encoder_channels=[[8], [8, 16], [16, 16], [32, 32, 32], [32, 32, 32]]' \\
    --set 'model.m_estimator_channels=[]' --set 'model.m_estimator_dilations=[]'    starts from a model
  iclk align a.png b.png --depth a.tiff --camera 227.5,227.5,187.5,119.5 --model run/model.safetensors

Exit codes: 0 done; 2 wrong usage; 3 bad input; 6 stopped before the end, by a signal or --minutes.
"""
import argparse
import ctypes
import os
import sys

from modules import need


def parser():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = p.add_subparsers(dest='command', required=True, metavar='run|export|pairs')
    form = dict(formatter_class=argparse.RawDescriptionHelpFormatter, description=__doc__)
    run = commands.add_parser('run', help='train', **form)
    run.add_argument('--data', nargs='+', required=True, metavar='SET',
                     help='folders of `iclk render --pairs`, or manifests of `iclk batch` with depth and truth')
    run.add_argument('--validation', nargs='+', default=[], metavar='SET',
                     help='sets to validate on; default: a part of each set of --data, data.validation_share')
    run.add_argument('--test', nargs='+', default=[], metavar='SET', help='sets for a test curve; never trained on')
    run.add_argument('--out', required=True, metavar='RUN', help='folder of the run; a run that was stopped continues')
    run.add_argument('--recipe', default='ours', metavar='NAME|FILE', help='ours (default), paper, or a TOML file')
    run.add_argument('--set', action='append', default=[], metavar='KEY=VALUE',
                     help='change a value of the recipe; may be repeated')
    run.add_argument('--init', metavar='CHECKPOINT|MODEL',
                     help='initial weights of a new run; from a .safetensors file only the layers that have the same '
                          'shape in the recipe')
    run.add_argument('--device', choices=('cpu', 'cuda'), help='default: cuda if there is one')
    run.add_argument('--threads', type=int, default=len(os.sched_getaffinity(0)), metavar='N',
                     help='CPU threads; default: all cores')
    run.add_argument('--workers', type=int, metavar='N', help='processes that read ahead; default: 4 with cuda, else 0')
    run.add_argument('--minutes', type=float, metavar='M', help='stop after M minutes; the same command continues')
    run.add_argument('--checkpoint-every', type=int, metavar='STEPS',
                     help='also save a checkpoint every STEPS steps; default: after each validation and every 5 minutes')
    out = commands.add_parser('export', help='write the model of a checkpoint', **form)
    out.add_argument('run', metavar='RUN', help='folder of a run, or a checkpoint')
    out.add_argument('--out', required=True, metavar='FILE', help='model file to write, .safetensors')
    out.add_argument('--name', help='name of the model; default: that of the recipe')
    out.add_argument('--licence', help='licence of the weights')
    out.add_argument('--provenance', help='origin of the weights; default: recipe, steps, appearance and sets of the run, '
                     'and of the run that it started from')
    pairs = commands.add_parser('pairs', help='list pairs of an RGB-D recording', **form)
    pairs.add_argument('recording', metavar='RECORDING', help='folder with rgb.txt, depth.txt, groundtruth.txt and camera.txt')
    pairs.add_argument('--out', required=True, metavar='FILE', help='manifest to write')
    pairs.add_argument('--stride', default='1,2,3', metavar='N[,N...]',
                       help='frames from one image of a pair to the other; default: 1,2,3')
    return p


def keep_memory():
    """glibc gives large blocks back to the system when they are freed, and every step would fault them in again: up to half of
    a step on a CPU. Elsewhere nothing happens."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD = -1, -2, -3
    for option, value in ((M_MMAP_THRESHOLD, 2 ** 31 - 1), (M_TRIM_THRESHOLD, 2 ** 31 - 1), (M_TOP_PAD, 2 ** 28)):
        mallopt(option, value)


def run_command(args):
    keep_memory()
    import torch

    import recipe
    from trainer import Trainer
    device = args.device or ('cuda' if torch.cuda.is_available() else 'cpu')
    if device == 'cuda' and not torch.cuda.is_available():
        raise recipe.InputError('--device cuda: this PyTorch finds no CUDA device; give --device cpu')
    if args.threads < 1:
        raise recipe.InputError(f'--threads {args.threads} must be 1 or more')
    torch.set_num_threads(args.threads)
    workers = args.workers if args.workers is not None else (4 if device == 'cuda' else 0)
    trainer = Trainer(recipe.load(args.recipe, args.set), args.data, args.test, args.out, device, workers, args.init,
                      args.validation)
    return 0 if trainer.run(args.checkpoint_every, minutes=args.minutes) else 6


def export_command(args):
    from network import TrainedNetwork, export
    from run_folder import RunFolder, load_checkpoint
    path = args.run if os.path.isfile(args.run) else None
    state = load_checkpoint(path) if path else RunFolder(args.run, lock=False).load()
    if state is None:
        from recipe import InputError
        raise InputError(f'{args.run}: no checkpoint in this folder; give the folder of a run')
    network = TrainedNetwork(state['recipe']['model'])
    network.load_state_dict(state['network'])
    from trainer import export_model, provenance
    about = args.provenance or provenance(state['recipe'], state['data'], state['step'], state.get('before', ''))
    export_model(network, args.out, state['recipe'], about, args.name, args.licence)
    return 0


def main():
    args = parser().parse_args()
    need('numpy', *(() if args.command == 'pairs' else ('torch', 'cv2')))
    from recipe import InputError
    try:
        if args.command == 'pairs':
            from recording import write_pairs
            return write_pairs(args.recording, args.out, args.stride)
        return run_command(args) if args.command == 'run' else export_command(args)
    except InputError as e:
        # From a process that reads ahead, the message comes behind its traceback.
        print(f'train.py: {str(e).splitlines()[-1].replace("recipe.InputError: ", "")}', file=sys.stderr)
        return 3


if __name__ == '__main__':
    sys.exit(main())
