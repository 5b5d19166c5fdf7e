"""A manifest from the first shard to the last."""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import re
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import ray

import iclk
from iclk import Error

from ._settings import Settings
from ._shards import Output, ShardWorker, read_manifest

_SAID = re.compile(r"\[iclk (\w+)\] ([^\n]*)")


class CheckedWorker(ShardWorker):
    """Says in a way that Ray's wrapping does not hide why it cannot begin."""

    def __init__(self, *arguments: Any) -> None:
        try:
            super().__init__(*arguments)
        except Error as e:
            raise RuntimeError(f"[iclk {e.code}] {e}") from None
        except TypeError as e:
            raise RuntimeError(f"[iclk invalid_argument] {e}") from None
        except OSError as e:
            raise RuntimeError(f"[iclk io] {e.filename}: {e.strerror}") from None


def settings_of(a: argparse.Namespace, options: dict[str, Any]) -> Settings:
    def absolute(path: str) -> str:
        return os.path.abspath(path) if path and os.path.exists(path) else path  # workers begin in another folder

    return Settings(
        absolute(a.camera), a.distortion, a.depth_scale, a.depth_sigma, absolute(a.mask), a.detector, a.count, a.with_features,
        absolute(a.model), options, a.device, a.batch, a.threads, a.max_pixels,
    )  # fmt: skip


def _content(path: str) -> str:
    """Of a file that results depend on; a name or numbers are themselves."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16] if os.path.isfile(path) else path


def _workers(a: argparse.Namespace) -> tuple[int, float]:
    have: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call,unused-ignore]
    gpus = a.gpus if a.gpus is not None else 1.0 if have.get("GPU", 0) >= 1 and a.device != "cpu" else 0.0
    room = have.get("CPU", 1) / a.cpus
    if gpus > 0:
        room = min(room, have.get("GPU", 0) / gpus)
    if room < 1:
        raise Error(
            "invalid_argument",
            f"no machine has room for a worker of --cpus {a.cpus:g} --gpus {gpus:g}: Ray has {have.get('CPU', 0):g} CPUs and "
            f"{have.get('GPU', 0):g} GPUs",
        )
    return a.workers or int(room), gpus


def run(a: argparse.Namespace, options: dict[str, Any], progress_of: Any) -> int:
    """The exit code. Raises Error, OSError, KeyboardInterrupt."""
    settings = settings_of(a, options)
    manifest = read_manifest(a.manifest, a.shard_pairs)
    output = Output(a.out, len(manifest.shards))
    effective = {**settings.effective(), **{key: _content(getattr(settings, key)) for key in ("camera", "mask", "model")}}
    head = {"manifest": manifest.digest, "shard_pairs": a.shard_pairs, "settings": effective, "version": iclk.__version__}
    output.open(json.loads(json.dumps(head)))
    output.forget_attempts()
    before = output.done(a.retry)
    left = [shard for shard in manifest.shards if shard.index not in before]
    skipped = manifest.pairs - sum(shard.pairs for shard in left)
    if skipped:
        print(f"iclk.ray: {skipped} of {manifest.pairs} pairs have a row in {a.out}: continuing", file=sys.stderr)
    progress = progress_of(manifest.pairs, skipped)
    why = ""
    if left:
        ray.init(address=a.address, log_to_driver=bool(a.address), logging_level=logging.ERROR)
        try:
            why = _align(a, settings, output, left, progress)
        finally:
            progress.clear()
            ray.shutdown()
    return _sum_up(a, output, manifest.pairs, progress, why)


def _align(a: argparse.Namespace, settings: Settings, output: Output, left: list[Any], progress: Any) -> str:
    """Why some shards remain; empty: nobody knows, or none does."""
    workers, gpus = _workers(a)
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.max_errored_blocks = -1  # the others go on
    logging.getLogger("ray.data").setLevel(logging.CRITICAL)
    shards = ray.data.from_items([asdict(shard) for shard in left], override_num_blocks=len(left))
    work = shards.map_batches(
        CheckedWorker,
        fn_constructor_args=(settings, a.cpus, str(output.folder), output.count),
        batch_size=1,
        batch_format="pyarrow",
        concurrency=min(workers, len(left)),
        num_cpus=a.cpus,
        num_gpus=gpus,
    )
    try:
        progress.began = time.monotonic()
        for row in work.iter_rows():
            progress.done += row["pairs"]
            progress.errors += row["errors"]
            progress.processor += row["processor"]
            progress.show()
    except ray.exceptions.RayError as e:
        if said := _SAID.search(str(e)):
            raise Error(said[1], said[2]) from None
        return str(e).strip().splitlines()[-1]
    return ""


def _sum_up(a: argparse.Namespace, output: Output, pairs: int, progress: Any, why: str) -> int:
    done = output.done(False)
    seconds = time.monotonic() - progress.began
    each = f"{progress.processor / max(progress.done, 1):.4f} s of processor each"
    rate = f" ({progress.rate():.2f} pairs/s, {each})" if progress.done else ""
    earlier = f", {progress.before} before" if progress.before else ""
    print(f"{progress.done} pairs in {seconds:.0f} s{rate}{earlier}; results in {a.out}")
    if len(done) < output.count:
        faults = output.folder / "_faults.jsonl"
        hint = f" ({why})" if why else f" (see {faults})" if faults.exists() else ""
        print(f"iclk.ray: {output.count - len(done)} of {output.count} shards remain{hint}: the same command continues",
              file=sys.stderr)
        return 6
    errors = sum(done.values())
    if errors:
        print(f"iclk.ray: {errors} of {pairs} pairs have the status \"error\": see \"reason\"; --retry runs their shards again",
              file=sys.stderr)
    return 20 if errors else 0
