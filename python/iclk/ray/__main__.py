"""python -m iclk.ray"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from typing import Any

from iclk import Error
from iclk._models import default_model

MISSING = "iclk.ray: {} is not installed: pip install 'iclk[ray]'"

DESCRIPTION = """\
Aligns the pairs of a manifest on Ray. The results are those of `iclk batch`, bit for bit.

MANIFEST: JSON lines as for `iclk batch` (its --help lists the keys), a Parquet file, or a folder of Parquet files. Parquet
columns have the names of these keys; image and feature files are paths or bytes. Relative paths start at the manifest's folder.
All machines must see that folder and DIR under the same names.
"""

EPILOG = """\
DIR gets one Parquet file for every --shard-pairs lines, `pairs-000000-of-000040.parquet`, once all of them are done: one row
per pair, in the order of the manifest. T_10 has 16 numbers, covariance 36, row by row. A pair that cannot be read or is
described wrongly has status "error" and a reason; only --retry runs it again. If a machine fails (device lost, disk or network
error, killed), a new worker starts its shard again, up to three times in all; _faults.jsonl lists the causes.

To continue after Ctrl-C, a kill or a lost machine, run the same command again: it skips shards that have a file, and no pair
appears twice. Another manifest, other options or another version of iclk need another DIR. Not supported, unlike in
`iclk batch`: the settings dense, detector=random and camera-sigma, "errors" (the row has the truth instead), and the check for
files that have changed.

Examples:
  python -m iclk.ray pairs.jsonl --camera camera.txt --out results                         # this machine, one worker per core
  python -m iclk.ray pairs.jsonl --camera camera.txt --out results --workers 2 --cpus 1    # 2 workers
  python -m iclk.ray pairs.jsonl --camera camera.txt --out results --address auto --gpus 0.5   # the cluster; 2 workers per GPU
  python -m iclk.ray pairs.jsonl --camera camera.txt --out results --retry                 # after repairing files
  python -c "import pyarrow.parquet as pq; print(pq.read_table('results').group_by('status').aggregate([('id', 'count')]))"

Exit codes: 0 every pair has a row and none is an error; 20 every pair has a row, some with status "error"; 130 stopped by
Ctrl-C, 143 by SIGTERM; 2 wrong usage, 3 bad manifest, options or results of another run, 4 a file cannot be read or written,
5 no Vulkan driver or no such device, 6 machines failed and pairs remain (the same command continues); 1 a defect of iclk.
"""

EXITS = {"invalid_argument": 3, "unsupported": 3, "io": 4, "no_driver": 5, "no_device": 5}


def yes_or_no(text: str) -> bool:
    return {"yes": True, "no": False}[text]


def detector(text: str) -> str:
    return {"shi-tomasi": text, "grid": text}[text]


SETTINGS = {
    "levels": int, "iterations": int, "carry": float, "robust": str, "damping": str, "search": str, "photometric": yes_or_no,
    "refine": yes_or_no, "refine-rounds": int, "recolour": yes_or_no, "rolling-shutter": yes_or_no, "structure": yes_or_no,
    "detector": detector, "max-pixels": int,
}  # fmt: skip


def setting(text: str) -> tuple[str, Any]:
    name, _, value = text.partition("=")
    if name not in SETTINGS:
        raise argparse.ArgumentTypeError(f"{text}: must be NAME=VALUE with one of the names {', '.join(SETTINGS)}")
    try:
        return name.replace("-", "_"), SETTINGS[name](value)
    except (KeyError, ValueError):
        raise argparse.ArgumentTypeError(f"{text}: invalid value; `iclk batch --help` lists the values") from None


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        "python -m iclk.ray", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("manifest", metavar="MANIFEST")
    p.add_argument("--out", required=True, metavar="DIR", help="folder for the results; existing results are continued")
    where = p.add_argument_group("where to run")
    where.add_argument("--address", help="Ray cluster; auto: the one of this machine; default: start Ray on this machine")
    where.add_argument("--workers", type=int, default=0, help="processes; default: as many as the GPUs, else the CPUs, allow")
    where.add_argument("--cpus", type=float, default=1, help="per worker, for decoding and for a software device (default: 1)")
    where.add_argument("--gpus", type=float, help="per worker; 0.5: two share one; default: 1 if Ray has GPUs, else 0")
    where.add_argument("--shard-pairs", type=int, default=256, help="pairs per file; a kill costs a file per worker (256)")
    where.add_argument("--retry", action="store_true", help="run shards again that have a pair with status error")
    where.add_argument("--device", default="", help="Vulkan device, or cpu; default: the GPU that Ray assigns, else the best")
    where.add_argument("--batch", type=int, default=0, help="pairs aligned together; default: 16, halved if memory lacks")
    where.add_argument("--threads", type=int, default=0, help="for decoding images; default: one per CPU of the worker")
    what = p.add_argument_group("what to do; `iclk batch --help` explains these options")
    what.add_argument("--camera", default="")
    what.add_argument("--distortion", default="")
    what.add_argument("--depth-scale", type=float, default=0)
    what.add_argument("--depth-sigma", default="auto")
    what.add_argument("--mask", default="", metavar="FILE")
    what.add_argument("--count", type=int, default=200)
    what.add_argument("--with-features", action="store_true")
    what.add_argument("--model", default=default_model(), metavar="FILE|classical|auto")
    what.add_argument("--solver", choices=("host", "device", "cpu"))
    what.add_argument("--set", type=setting, action="append", default=[], metavar="NAME=VALUE", help="; ".join(SETTINGS))
    return p


def check(a: argparse.Namespace) -> None:
    for name, low in (("workers", 0), ("shard_pairs", 1), ("batch", 0), ("threads", 0), ("count", 1), ("max_pixels", 1)):
        if getattr(a, name) < low:
            raise Error("invalid_argument", f"--{name.replace('_', '-')} {getattr(a, name)} must be at least {low}")
    if not a.cpus > 0 or (a.gpus is not None and not a.gpus >= 0) or not a.depth_scale >= 0:
        raise Error("invalid_argument", "--cpus must be positive, --gpus and --depth-scale not negative")


class Progress:
    def __init__(self, total: int, before: int) -> None:
        self.total, self.before, self.done, self.errors = total, before, 0, 0
        self.processor = 0.0  # s, of the workers
        self.began = self.shown = time.monotonic()

    def rate(self) -> float:
        return self.done / max(time.monotonic() - self.began, 1e-9)

    def show(self) -> None:
        now = time.monotonic()
        terminal = sys.stderr.isatty()
        if now - self.shown < (0.1 if terminal else 10):
            return
        self.shown = now
        at = self.before + self.done
        text = f"{at}/{self.total}  {100 * at / self.total:.1f} %  {self.rate():.3g} pairs/s"
        text += f"  {span((self.total - at) / max(self.rate(), 1e-9))} left"
        text += f"  {self.errors} failed" if self.errors else ""
        print(f"\r{text}\x1b[K" if terminal else text, end="" if terminal else "\n", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def span(seconds: float) -> str:
    s = round(min(seconds, 1e9))
    return f"{s} s" if s < 60 else f"{s // 60} min {s % 60} s" if s < 3600 else f"{s // 3600} h {s % 3600 // 60} min"


def code_of(error: BaseException) -> str:
    """Of an iclk.Error that a worker raised, under whatever Ray wraps it in; empty: of none."""
    text = str(error)
    for name in ("no_driver", "no_device", "invalid_argument", "unsupported", "io"):
        if f"[iclk {name}]" in text:
            return name
    return ""


def main(arguments: list[str] | None = None) -> int:
    a = parser().parse_args(arguments)
    try:
        import cv2  # noqa: F401
        import pyarrow  # noqa: F401
        import ray  # noqa: F401
    except ImportError as e:
        print(MISSING.format(e.name), file=sys.stderr)
        return 2
    from ._run import run

    def stop(number: int, frame: Any) -> None:
        raise KeyboardInterrupt(number)

    before = signal.signal(signal.SIGTERM, stop)
    try:
        options = dict(a.set)
        if a.solver:
            options["solver"] = a.solver
        a.detector = options.pop("detector", "shi-tomasi")
        a.max_pixels = options.pop("max_pixels", 8192 * 8192)
        check(a)
        return run(a, options, Progress)
    except KeyboardInterrupt as e:
        print("\niclk.ray: stopped; the same command continues", file=sys.stderr)
        return 128 + (e.args[0] if e.args else signal.SIGINT)
    except Error as e:
        print(f"iclk.ray: {e}", file=sys.stderr)
        return EXITS.get(e.code, 6)
    except OSError as e:
        print(f"iclk.ray: {e.filename or a.manifest}: {e.strerror or e}", file=sys.stderr)
        return 4
    finally:
        signal.signal(signal.SIGTERM, before)


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code) if code >= 128 else sys.exit(code)
