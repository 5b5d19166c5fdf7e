#!/usr/bin/env python3
"""Times the learned model in PyTorch, to compare with `iclk bench --model`.

    bench.py --write random.safetensors               write a model of the paper's architecture, with random weights
    bench.py random.safetensors                       time of an image, in both memory layouts, and of a whole pair
    bench.py random.safetensors --iclk build/iclk     also run `iclk bench` on the same pair; prints ratios
    bench.py random.safetensors --device cuda --batch 16

Needs PyTorch 1.13 or later (Debian: python3-torch).
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

from modules import need

need('torch')
import torch

from reference import PATCH, Network, align, read_safetensors, write_safetensors

PAPER_CHANNELS = [[16, 32, 32], [32, 64, 64], [64, 96, 96], [96, 128, 128]]
DILATIONS = [1, 2, 2]
M_ESTIMATOR = [(16, 1), (32, 2), (64, 4), (1, 1)]


def measure(run, device, repetitions):
    """Median ms and CPU seconds of a call, after two to warm up."""
    wait = torch.cuda.synchronize if device == 'cuda' else lambda: None
    ms, cpu = [], []
    for i in range(repetitions + 2):
        wait()
        begin, begin_cpu = time.perf_counter(), time.process_time()
        run()
        wait()
        if i >= 2:
            ms.append(1e3 * (time.perf_counter() - begin))
            cpu.append(time.process_time() - begin_cpu)
    return {'ms': statistics.median(ms), 'cpu_s': statistics.median(cpu)}


def write_random(args):
    """A model of the paper's shape with random weights: its arithmetic is a trained one's."""
    channels = json.loads(args.channels) if args.channels else (PAPER_CHANNELS + 4 * [[128, 128, 128]])[:args.levels or 4]
    generator, tensors, cin = torch.Generator().manual_seed(1), {}, 3

    def add(name, cin, cout):
        tensors[name + '.weight'] = torch.randn(cout, cin, 3, 3, generator=generator) * (2 / (9 * cin)) ** 0.5
        tensors[name + '.bias'] = torch.zeros(cout)
        return cout
    for i, cout in enumerate(c for level in channels for c in level):
        cin = add(f'encoder.{i}', cin, cout)
    cin = 4
    for i, (cout, _) in enumerate(M_ESTIMATOR):
        cin = add(f'm_estimator.{i}', cin, cout)
    metadata = {'format': 'iclk-model-1', 'name': 'random', 'licence': 'CC0-1.0', 'provenance': 'random weights, not trained',
                'encoder_channels': channels, 'encoder_dilations': [DILATIONS] * len(channels),
                'm_estimator_channels': [c for c, _ in M_ESTIMATOR], 'm_estimator_dilations': [d for _, d in M_ESTIMATOR],
                'input_channels': 3, 'mean': [0.4914, 0.4822, 0.4465], 'std': [0.2023, 0.1994, 0.2010],
                'activation': 'elu', 'patch': PATCH, 'iterations': 10, 'damping': 1e-6}
    write_safetensors(args.write, {k: v if isinstance(v, str) else json.dumps(v) for k, v in metadata.items()}, tensors)


def random_pair(args, channels, levels):
    """Images, features and camera of args.batch pairs."""
    width, height = args.size
    generator = torch.Generator().manual_seed(1)

    def random(*shape):
        return torch.rand(*shape, generator=generator).to(args.device)
    images = random(2 * args.batch, channels, height, width)
    edge = PATCH * 2 ** (levels - 1)
    if min(width, height) <= 2 * edge:
        edge = 0
    uv = edge + random(args.batch, args.features, 2) * (torch.tensor([width, height], device=args.device) - 2 * edge)
    return images, uv, 0.1 + random(args.batch, args.features), (0.8 * width, 0.8 * width, (width - 1) / 2, (height - 1) / 2)


def run_iclk(args, pair_file):
    """`iclk bench` of the same model: its report."""
    command = [args.iclk, 'bench', '--model', args.model, '--size', '{}x{}'.format(*args.size), '--features',
               str(args.features), '--pairs', str(args.batch), '--repetitions', str(args.repetitions), '--only',
               'model, device', 'model, keyframe', '--json', '--save-pair', pair_file]
    done = subprocess.run(command, stdout=subprocess.PIPE)
    if done.returncode:
        sys.exit(f'{" ".join(command)} failed with exit code {done.returncode}')
    report = json.loads(done.stdout)
    rows = {row['method']: row for row in report['rows']}
    whole, keyframe = rows['model, device'], rows['model, keyframe']
    return {'machine': report['machine'], 'profile': report['profiles'][0],
            'pair': {'ms': whole['ms_per_pair'], 'cpu_s': 1e-3 * whole['cpu_ms_per_pair']},
            # A pair less a pair whose reference was there: an image through the encoder, its upload and its template.
            'encode': {'ms': whole['ms_per_pair'] - keyframe['ms_per_pair'],
                       'cpu_s': 1e-3 * (whole['cpu_ms_per_pair'] - keyframe['cpu_ms_per_pair'])}}


def print_ratios(report):
    ours = report['iclk']
    torchs = [report[layout] for layout in ('nchw', 'channels_last')]
    print(f'{"iclk":13s} {ours["encode"]["ms"]:9.1f} {ours["encode"]["cpu_s"]:7.2f} {ours["pair"]["ms"]:12.1f} '
          f'{ours["pair"]["cpu_s"]:7.2f}      {ours["machine"]["device"]}')
    off = report['difference']
    print(f'the same pair: T_10 differs by {off["R"]:.1e} in R and by {off["t"]:.1e} of its length in t')
    for what, unit in (('encode', 'cpu_s'), ('encode', 'ms'), ('pair', 'cpu_s'), ('pair', 'ms')):
        best = min(t[what][unit] for t in torchs)
        name = 'CPU seconds' if unit == 'cpu_s' else 'wall time'
        print(f'{what}, {name}: iclk takes {ours[what][unit] / best:.2f} of PyTorch in its better layout')


def bench(args):
    network, options = Network.load(args.model)
    width, height = args.size
    levels = min(args.levels or len(network.levels), len(network.levels))
    network = network.to(args.device)
    images, uv, q, camera = random_pair(args, network.mean.shape[1], levels)
    report, ours = {}, []
    with tempfile.TemporaryDirectory() as folder:
        pair_file = os.path.join(folder, 'pair.safetensors')
        if args.iclk:
            ours.append(run_iclk(args, pair_file))
            _, saved = read_safetensors(pair_file)
            saved = {name: x.to(args.device) for name, x in saved.items()}
            repeat = (args.batch, 1, 1, 1)
            images = torch.cat([saved['image0'].repeat(repeat), saved['image1'].repeat(repeat)])
            uv, q = saved['features'].repeat(args.batch, 1, 1), saved['inverse_depth'].repeat(args.batch, 1)
            camera = saved['camera'].tolist()
        report = measure_torch(args, network, images, uv, q, camera, levels, options)
        if args.iclk:  # before and after, so that a machine whose speed drifts favours nobody
            ours.append(run_iclk(args, pair_file))
            report['iclk'] = {what: {unit: statistics.mean(o[what][unit] for o in ours) for unit in ('ms', 'cpu_s')}
                              for what in ('encode', 'pair')}
            report['iclk'].update(machine=ours[0]['machine'], profile=ours[0]['profile'])
            maps = network(images, levels)
            R, t = align(network, [m[:1] for m in maps], [m[args.batch:args.batch + 1] for m in maps], camera, uv[:1], q[:1],
                         **options)
            report['difference'] = {'R': float((R - saved['R']).abs().max()),
                                    't': float((t - saved['t']).norm() / saved['t'].norm())}
    if args.json:
        print(json.dumps(report))
        return
    print(f'PyTorch {report["torch"]}, {report["device"]}, {report["threads"]} threads; {width}x{height}, '
          f'{levels} levels of {options["iterations"]} iterations, {uv.shape[1]} features, batches of {args.batch}, '
          f'pixels: {args.pixels}')
    print('                 encode an image         a whole pair\n                     ms   CPU s           ms   CPU s')
    for name in ('nchw', 'channels_last'):
        e, p = report[name]['encode'], report[name]['pair']
        print(f'{name:13s} {e["ms"]:9.1f} {e["cpu_s"]:7.2f} {p["ms"]:12.1f} {p["cpu_s"]:7.2f}')
    if args.iclk:
        print_ratios(report)


def measure_torch(args, network, images, uv, q, camera, levels, options):
    report = {'torch': torch.__version__, 'threads': torch.get_num_threads(),
              'device': torch.cuda.get_device_name() if args.device == 'cuda' else 'cpu',
              'width': images.shape[-1], 'height': images.shape[-2], 'levels': levels, 'batch': args.batch}
    for name, layout in (('nchw', torch.contiguous_format), ('channels_last', torch.channels_last)):
        network = network.to(memory_format=layout)
        x = images.contiguous(memory_format=layout)

        def pair():
            maps = network(x, levels)
            return align(network, [m[:args.batch] for m in maps], [m[args.batch:] for m in maps], camera, uv, q,
                         pixels=args.pixels, **options)
        single = measure(lambda: network(x[:args.batch], levels), args.device, args.repetitions)
        whole = measure(pair, args.device, args.repetitions)
        report[name] = {'encode': {k: v / args.batch for k, v in single.items()},
                        'pair': {k: v / args.batch for k, v in whole.items()}}
    return report


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('model', nargs='?', help='an iclk model file')
    parser.add_argument('--size', nargs=2, type=int, metavar=('W', 'H'), default=(752, 480), help='image size')
    parser.add_argument('--iclk', metavar='PATH', help='iclk command to compare with; prints ratios')
    parser.add_argument('--write', metavar='FILE', help="write a model of the paper's architecture with random weights")
    parser.add_argument('--channels', metavar='LISTS', help='for --write: channels of each layer, a list of three per level')
    parser.add_argument('--device', choices=('cpu', 'cuda'), default='cpu')
    parser.add_argument('--levels', type=int, help='use only this many of the finest levels; default: all')
    parser.add_argument('--batch', type=int, default=1, help='pairs that are computed together')
    parser.add_argument('--features', type=int, default=50)
    parser.add_argument('--pixels', choices=('mask', 'all'), default='mask', help='pixels that the iterations visit')
    parser.add_argument('--threads', type=int, default=len(os.sched_getaffinity(0)), help='CPU threads; default: all cores')
    parser.add_argument('--repetitions', type=int, default=7)
    parser.add_argument('--json', action='store_true')
    args = parser.parse_args()
    if not args.write and args.model is None:
        parser.error('give MODEL, or --write FILE')
    torch.set_num_threads(args.threads)
    if args.device == 'cuda':  # the yardstick computes in single precision as iclk does, not in TF32
        torch.backends.cudnn.allow_tf32 = torch.backends.cuda.matmul.allow_tf32 = False
        torch.backends.cudnn.benchmark = True
    with torch.inference_mode():
        if args.write:
            write_random(args)
        if args.model:
            bench(args)


if __name__ == '__main__':
    main()
