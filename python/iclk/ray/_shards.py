"""A manifest in shards of so many pairs each, and their results: a Parquet file a shard, whole or not there."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from iclk import Error

from ._settings import Settings
from ._worker import SCHEMA, Item, MachineFault, PairWorker, leave

_ATTEMPTS = 3
_BOM = b"\xef\xbb\xbf"


def refuse(message: str) -> Error:
    return Error("invalid_argument", message)


def _id(row: Any, number: int) -> str:
    """As `iclk batch` names a pair."""
    if not isinstance(row, dict):
        return f"line {number}"
    value = row.get("id")
    if value is None:
        return str(number)
    good = isinstance(value, int) and not isinstance(value, bool) or isinstance(value, str) and value
    return str(value) if good else f"line {number}"


def _item(raw: bytes, number: int, path: str) -> Item:
    row, bad = None, ""
    try:
        row = json.loads(raw)
        if not isinstance(row, dict):
            row, bad = None, "must be a JSON object {...}"
        elif "id" in row and _id(row, number) == f"line {number}":
            row, bad = None, "key 'id' must be a string or a whole number"
    except (ValueError, RecursionError) as e:
        bad = f"not valid JSON: {str(e)[:160]}"
    return Item(_id(row, number), number, row, f"{path}:{number}", os.path.dirname(path), bad)


@dataclass
class Shard:
    """Pairs that lie together: bytes of a JSONL file, or rows of a Parquet file."""

    index: int
    path: str
    begin: int
    end: int
    first: int  #: number of the first line
    pairs: int

    def items(self) -> list[Item]:
        if self.path.endswith(".parquet"):
            return list(self._rows())
        with open(self.path, "rb") as file:
            file.seek(self.begin)
            data = file.read(self.end - self.begin)
        lines = enumerate(data.removeprefix(_BOM).split(b"\n"), self.first)
        return [_item(raw.strip(), number, self.path) for number, raw in lines if raw.strip(b" \t\r\n")]

    def _rows(self) -> Iterator[Item]:
        """Of the row groups that they are in, and of no others: these may hold images."""
        begin = 0
        with pq.ParquetFile(self.path) as file:
            for group in range(file.num_row_groups):
                count = file.metadata.row_group(group).num_rows
                first, last = max(self.begin, begin), min(self.end, begin + count)
                if first < last:
                    table = file.read_row_group(group).slice(first - begin, last - first)
                    for i, row in enumerate(table.to_pylist()):
                        number = self.first + first - self.begin + i
                        yield Item(_id(row, number), number, row, f"{self.path}:{number}", os.path.dirname(self.path))
                begin += count


@dataclass
class Manifest:
    path: str
    shards: list[Shard]
    pairs: int
    digest: str


def read_manifest(path: str, size: int) -> Manifest:
    """JSON lines, a Parquet file, or a folder of them. Raises Error, OSError; a broken line is its own row's error."""
    digest, ids = hashlib.sha256(), dict[str, int]()
    shards: list[Shard] = []
    total = number = 0

    def own(identity: str) -> None:
        other = ids.setdefault(identity, number)
        if other != number:
            raise refuse(
                f"{path}: lines {other} and {number} have the same id '{identity[:40]}' (the default is the line "
                "number); every pair needs its own"
            )

    if os.path.isdir(path) or path.endswith(".parquet"):
        files = sorted(Path(path).glob("*.parquet")) if os.path.isdir(path) else [Path(path)]
        for name in files:
            try:
                with pq.ParquetFile(name) as file:
                    rows = file.metadata.num_rows
                    column = file.read(columns=["id"])["id"].to_pylist() if "id" in file.schema_arrow.names else [None] * rows
            except pa.ArrowInvalid as e:
                raise refuse(f"{name}: not a Parquet file, or damaged: {e}") from None
            digest.update(f"{name.name} {name.stat().st_size} {name.stat().st_mtime_ns}\n".encode())
            for begin in range(0, rows, size):
                end = min(begin + size, rows)
                shards.append(Shard(len(shards), os.path.abspath(name), begin, end, number + 1, end - begin))
                for value in column[begin:end]:
                    number += 1
                    own(_id({"id": value}, number))
            total += rows
    else:
        with open(path, "rb") as file:
            at, shard = 0, None
            for raw in file:
                number += 1
                digest.update(raw)
                begin, at = at, at + len(raw)
                line = (raw.removeprefix(_BOM) if number == 1 else raw).strip(b" \t\r\n")
                if not line:
                    continue
                if shard is None or shard.pairs == size:
                    shard = Shard(len(shards), os.path.abspath(path), begin, at, number, 0)
                    shards.append(shard)
                own(_item(line, number, path).id)
                shard.end, shard.pairs = at, shard.pairs + 1
                total += 1
    if not total:
        raise refuse(f'{path}: has no pairs; a line is {{"reference": ..., "target": ..., "depth": ...}}')
    return Manifest(path, shards, total, digest.hexdigest())


def write_whole(path: Path, write: Any) -> None:
    """A temporary name beside it, fsync, rename."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        with open(temporary, "xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


class Output:
    """A folder: `_run.json`, and a Parquet file a shard."""

    def __init__(self, folder: str, count: int) -> None:
        self.folder, self.count = Path(folder).absolute(), count

    def file(self, index: int) -> Path:
        return self.folder / f"pairs-{index:06d}-of-{self.count:06d}.parquet"

    def open(self, run: dict[str, Any]) -> None:
        """Raises Error for a folder with results of something else, OSError."""
        self.folder.mkdir(parents=True, exist_ok=True)
        head = self.folder / "_run.json"
        if not head.exists():
            if any(self.folder.glob("pairs-*.parquet")):
                raise refuse(f"{self.folder} has results but no _run.json: give another --out")
            write_whole(head, lambda file: file.write(json.dumps(run, indent=2).encode()))
            return
        before = json.loads(head.read_text())
        for key, value in run.items():
            if before.get(key) != value:
                raise refuse(
                    f"{self.folder} has results of another run: {key} was {str(before.get(key))[:200]}, now it is "
                    f"{str(value)[:200]}; give the same to continue, or another --out"
                )

    def done(self, again: bool) -> dict[int, int]:
        """Shards with a file, and how many errors each has. `again`: those with errors are not among them."""
        found = {}
        names = {name.name for name in self.folder.glob("pairs-*.parquet")}
        for index in range(self.count):
            if self.file(index).name not in names:
                continue
            status = pq.read_table(self.file(index), columns=["status"])["status"].to_pylist()
            errors = status.count("error")
            if not (again and errors):
                found[index] = errors
        return found

    def write(self, index: int, table: pa.Table) -> None:
        write_whole(self.file(index), lambda file: pq.write_table(table, file, compression="zstd"))

    def _attempt(self, index: int, number: int) -> Path:
        return self.folder / "_attempts" / f"{index:06d}.{number}"

    def forget_attempts(self) -> None:
        """Of an earlier run: what was at fault then may be mended."""
        (self.folder / "_attempts").mkdir(exist_ok=True)
        for name in (self.folder / "_attempts").iterdir():
            name.unlink(missing_ok=True)

    def begin(self, index: int) -> bool:
        """False where it was begun often enough: a pair that kills its worker would go on for ever."""
        for number in range(_ATTEMPTS):
            try:
                with open(self._attempt(index, number), "x") as file:
                    file.write(str(os.getpid()))
                return True
            except FileExistsError:
                continue
        return False

    def end(self, index: int) -> None:
        for number in range(_ATTEMPTS):
            self._attempt(index, number).unlink(missing_ok=True)


class ShardWorker:
    """For ``Dataset.map_batches``: descriptions of shards in, a line about each out. The results it writes itself."""

    def __init__(self, settings: Settings, cpus: float, folder: str, count: int) -> None:
        self._output = Output(folder, count)
        self._worker = PairWorker(settings, cpus)

    def __call__(self, table: pa.Table) -> pa.Table:
        return pa.Table.from_pylist([self._run(Shard(**row)) for row in table.to_pylist()])

    def _run(self, shard: Shard) -> dict[str, Any]:
        busy = time.process_time()
        rows: list[dict[str, Any]] = []
        try:
            items = shard.items()
            if len(items) != shard.pairs:
                raise MachineFault(f"{shard.path}: shard {shard.index} has {len(items)} pairs, but had {shard.pairs} before")
            if self._output.begin(shard.index):
                rows = self._worker.answers(items)
                self._output.write(shard.index, pa.Table.from_pylist(rows, SCHEMA))
                self._output.end(shard.index)
            else:
                self._complain(shard, f"started {_ATTEMPTS} times, and its worker ended every time")
        except (MachineFault, OSError) as e:
            self._complain(shard, str(e))
            leave(str(e))
        return {
            "index": shard.index,
            "pairs": len(rows),
            "errors": sum(row["status"] == "error" for row in rows),
            "processor": time.process_time() - busy,
        }

    def _complain(self, shard: Shard, why: str) -> None:
        line = {"time": time.strftime("%FT%TZ", time.gmtime()), "host": os.uname().nodename, "shard": shard.index, "why": why}
        try:
            with open(self._output.folder / "_faults.jsonl", "a") as file:
                file.write(json.dumps(line) + "\n")
        except OSError:
            pass  # the disk may be what is at fault
