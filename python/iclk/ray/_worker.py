"""One process with one warmed aligner: it decodes in its own threads, aligns in batches, and answers in rows."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

import iclk
from iclk import _core
from iclk._errors import InvalidArgument
from iclk._models import folders

from ._manifest import Request, request_of
from ._settings import Settings

_OURS = ("device_lost", "out_of_memory", "vulkan", "no_driver", "no_device")  # codes of a machine's failures
# What the pair's path is to blame for. Any other errno is the machine's: a stale NFS handle, too many open files.
_PATH = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL)
_PAUSES = (0.5, 2.0)  # s, before a file is tried again

_numbers = pa.list_(pa.float64())
_FEATURE = pa.struct(
    [*((name, pa.float64()) for name in ("u0", "v0", "inverse_depth", "u1", "v1")), ("status", pa.string())]
)
#: Of the rows. Lists: 16 numbers of a pose and 36 of a covariance, row by row; fx, fy, cx, cy, width, height of a camera.
SCHEMA = pa.schema(
    [
        ("id", pa.string()),
        ("line", pa.int64()),
        ("status", pa.string()),
        ("reason", pa.string()),
        ("refined", pa.bool_()),
        ("T_10", _numbers),
        ("covariance", _numbers),
        ("turn", _numbers),
        ("gain", pa.float64()),
        ("bias", pa.float64()),
        ("visible_fraction", pa.float64()),
        ("correlation", pa.float64()),
        ("agreement", pa.float64()),
        ("inliers", pa.int32()),
        ("sigma", pa.float64()),
        ("model", pa.string()),
        ("attempts", pa.list_(pa.struct([("model", pa.string()), ("status", pa.string()), ("reason", pa.string())]))),
        ("stages", pa.list_(pa.struct([("name", pa.string()), ("T_10", _numbers), ("cost", pa.float64())]))),
        ("camera", _numbers),
        ("truth", _numbers),
        ("meta", pa.string()),
        ("device", pa.string()),
        ("version", pa.string()),
        ("features", pa.list_(_FEATURE)),
    ]
)


class MachineFault(Exception):
    """The machine failed, not a pair: the work is to be done again, by another process or on another machine."""


@dataclass
class Item:
    id: str
    line: int | None
    row: dict[str, Any] | None  #: with the keys of a manifest
    where: str  #: opens the messages: "pairs.jsonl:7"
    folder: str
    bad: str = ""  #: why there is no row


def _number(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _list(x: Any) -> list[float] | None:
    """None where there is none: NaN."""
    if x is None:
        return None
    flat: list[float] = np.asarray(x, dtype=np.float64).ravel().tolist()
    return flat if all(map(math.isfinite, flat)) else None


def gpu_device() -> str | None:
    """The Vulkan device that is the GPU which Ray gave to this process; None where it gave none.

    Ray hides the other GPUs from CUDA, but not from Vulkan; a UUID is what both have.
    """
    import ray

    given = ray.get_runtime_context().get_accelerator_ids().get("GPU", []) if ray.is_initialized() else []
    if not given:
        return None
    name = str(given[0])

    def plain(uuid: str) -> str:
        return re.sub("[^0-9a-f]", "", uuid.lower().removeprefix("gpu-"))

    uuid = name
    if name.isdigit():
        ask = ["nvidia-smi", "-i", name, "--query-gpu=uuid", "--format=csv,noheader"]
        try:
            uuid = subprocess.run(ask, capture_output=True, text=True, timeout=30, check=True).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            uuid = ""
    devices = iclk.devices()
    for device in devices:
        if uuid and plain(device["uuid"]) == plain(uuid):
            return device["uuid"]
    gpus = [d for d in devices if d["type"] == "discrete"]
    if not uuid and name.isdigit() and int(name) < len(gpus):
        return gpus[int(name)]["uuid"]  # not NVIDIA's
    names = ", ".join(d["name"] for d in devices) or "none"
    raise iclk.Error("no_device", f"Ray gave GPU {name} to a worker, but Vulkan lists only: {names}; give --device")


class PairWorker:
    """For ``Dataset.map_batches``: tables of pairs in, tables of results out."""

    def __init__(self, settings: Settings, cpus: float = 1) -> None:
        threads = max(1, math.ceil(cpus))
        os.environ.setdefault("LP_NUM_THREADS", str(threads))  # a software device takes no more than what Ray gave
        os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(settings.max_pixels))  # refuses before it decodes
        from . import _pairs

        _pairs.use_one_thread()
        self._settings = settings
        self._cpu = settings.device == "cpu" or settings.options.get("solver") == "cpu"
        device = settings.device or (None if self._cpu else gpu_device())
        self._options = {**settings.options, "model": settings.model}
        if device:
            self._options["device"] = device
        self._device = _core.Aligner(64, 64, 1, 1, 1, self._options, folders()).device  # says now what is wrong
        self._batch = settings.batch or (1 if self._cpu else 16)
        self._loader = _pairs.Loader(settings)
        self._pool = ThreadPoolExecutor(settings.threads or threads, "decode")
        self._aligner: tuple[Any, Any] = (None, None)  # kind, and what is warm for it

    def __call__(self, table: pa.Table) -> pa.Table:
        items = []
        for row in table.to_pylist():
            name = str(row.get("id"))
            items.append(Item(name, None, row, f"pair {name}", ""))
        try:
            return pa.Table.from_pylist(self.answers(items), SCHEMA)
        except MachineFault as e:
            leave(str(e))

    def answers(self, items: list[Item]) -> list[dict[str, Any]]:
        """A row an item, in order. Raises MachineFault."""
        rows: list[dict[str, Any]] = [{} for _ in items]
        waiting: dict[Any, list[tuple[int, Request, Any]]] = {}
        for index, request, pair in self._decoded(items):
            if isinstance(pair, str):
                rows[index] = self._row(items[index], {"status": "error", "reason": f"{items[index].where}: {pair}"}, request)
                continue
            assert request is not None
            group = waiting.setdefault(pair.kind, [])
            group.append((index, request, pair))
            # Of a rare kind no more wait than the device takes at a time.
            if len(group) == self._batch or sum(map(len, waiting.values())) >= 2 * self._batch:
                full = max(waiting, key=lambda kind: len(waiting[kind]))
                self._finish(waiting.pop(full), items, rows)
        for group in waiting.values():
            self._finish(group, items, rows)
        return rows

    def _decoded(self, items: list[Item]) -> Iterator[tuple[int, Request | None, Any]]:
        """Pairs in order, or why there is none; a batch ahead of who takes them."""
        ahead: deque[Future[tuple[Request | None, Any]]] = deque()
        begun = 0
        for index in range(len(items)):
            while begun < len(items) and len(ahead) <= self._batch:
                ahead.append(self._pool.submit(self._decode, items[begun]))
                begun += 1
            try:
                yield index, *ahead.popleft().result()
            except MachineFault:
                for future in ahead:
                    future.cancel()
                raise

    def _decode(self, item: Item) -> tuple[Request | None, Any]:
        if item.row is None:
            return None, item.bad
        request = None
        for pause in (*_PAUSES, None):
            try:
                request = request_of(item.row, item.folder)
                return request, self._loader.load(request)
            except InvalidArgument as e:
                return request, str(e)
            except OSError as e:
                why = f"cannot read {e.filename}: {e.strerror}"
                if e.errno in _PATH:
                    return request, why
                if pause is None:
                    raise MachineFault(f"{item.where}: {why}") from e
                time.sleep(pause)
            except MemoryError:
                return request, "not enough memory to read this pair; give fewer --threads"
            except Exception as e:  # a defect of ours, of this pair alone; the others go on
                return request, f"internal error: {type(e).__name__}: {e}"
        raise AssertionError

    def _finish(self, group: list[tuple[int, Request, Any]], items: list[Item], rows: list[dict[str, Any]]) -> None:
        for (index, request, pair), body in zip(group, self._align([pair for _, _, pair in group])):
            if body["status"] == "error":
                body["reason"] = f"{items[index].where}: {body['reason']}"
            rows[index] = self._row(items[index], body, request, pair)

    def _align(self, pairs: list[Any]) -> list[dict[str, Any]]:
        try:
            warm = self._warm(pairs)
            work = []
            for slot, p in enumerate(pairs):
                c, f = p.camera, p.features
                warm.set_reference(slot, p.reference, f.uv, f.inverse_depth, f.sigma, (c.fx, c.fy, c.cx, c.cy))
                work.append((slot, p.target, p.T_10, p.mask))
            return list(warm.align(work))
        except iclk.Error as e:
            if e.code == "out_of_memory" and self._batch > 1:
                self._aligner = (None, None)
                self._batch = max(1, min(self._batch, len(pairs)) // 2)
                return [body for i in range(0, len(pairs), self._batch) for body in self._align(pairs[i : i + self._batch])]
            if e.code in _OURS:
                raise MachineFault(f"{self._device}: {e}") from e
            if len(pairs) == 1:
                return [{"status": "error", "reason": str(e)}]
        return [body for pair in pairs for body in self._align([pair])]  # the error is one pair's own

    def _warm(self, pairs: list[Any]) -> Any:
        kind = pairs[0].kind
        if self._aligner[0] != kind:
            self._aligner = (None, None)  # the device may not hold two
            height, width = pairs[0].reference.shape[:2]
            features = max(self._settings.count, *(len(p.features.uv) for p in pairs), 1)
            made = _core.Aligner(width, height, self._batch, self._batch, features, self._options, folders())
            self._aligner = (kind, made)
        return self._aligner[1]

    def _row(self, item: Item, body: dict[str, Any], request: Request | None, pair: Any = None) -> dict[str, Any]:
        row = {"id": item.id, "line": item.line, "status": body["status"], "reason": body["reason"]}
        row["version"] = iclk.__version__
        meta = (item.row or {}).get("meta")
        row["meta"] = None if meta is None else json.dumps(meta, ensure_ascii=False)
        if request is not None:
            row["truth"] = _list(request.truth)
        if body["status"] == "error":
            return row
        row["device"] = self._device
        for name in ("refined", "inliers", "model"):
            row[name] = body[name]
        for name in ("T_10", "covariance", "turn"):
            row[name] = _list(body[name])
        for name in ("gain", "bias", "visible_fraction", "correlation", "agreement", "sigma"):
            row[name] = _number(body[name])
        row["attempts"] = [dict(zip(("model", "status", "reason"), attempt)) for attempt in body["attempts"]]
        row["stages"] = [{"name": s[0], "T_10": _list(s[1]), "cost": _number(s[2])} for s in body["stages"]]
        c = pair.camera
        row["camera"] = [c.fx, c.fy, c.cx, c.cy, float(c.width), float(c.height)]
        if self._settings.with_features:
            numbers = np.column_stack([pair.features.uv, body["inverse_depth"], body["uv"]]).tolist()
            names = ("u0", "v0", "inverse_depth", "u1", "v1")
            row["features"] = [
                {**dict(zip(names, map(_number, line))), "status": status}
                for line, status in zip(numbers, body["feature_status"])
            ]
        return row


def leave(why: str) -> Any:
    """Ends this process: a device that was lost stays lost in it. Ray starts another one, which does the work again."""
    print(f"iclk.ray: {why}; a new worker tries again", file=sys.stderr, flush=True)
    os._exit(1)
