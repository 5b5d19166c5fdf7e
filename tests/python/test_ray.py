"""iclk.ray gives what `iclk batch` gives, bit for bit; a worker that is killed costs nothing. Left out without `iclk[ray]`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import iclk
import numpy as np
import pytest
from iclk.ray.__main__ import parser
from conftest import make_scene, needs_vulkan
from test_parity import save

MISSING = [name for name in ("ray", "cv2", "pyarrow") if find_spec(name) is None]
if not MISSING:
    import cv2
    import pyarrow as pa
    import pyarrow.parquet as pq

    from iclk.ray import _shards, _worker
    from iclk.ray._manifest import BadPair, request_of
    from iclk.ray._pairs import Loader
    from iclk.ray._settings import Settings

needs_ray = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (pip install 'iclk[ray]')")
COMMAND = os.environ.get("ICLK_COMMAND")
needs_command = pytest.mark.skipif(not COMMAND, reason="ICLK_COMMAND is not set")
CAMERA = "152,152,79.5,59.5"
HOW = ["--solver", "cpu", "--model", "classical", "--camera", CAMERA]


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All that a line can say: colours, depth of 16 bits and float, features, masks, distortion, guesses, and what is wrong."""
    folder = tmp_path_factory.mktemp("pairs")
    colour, grey = make_scene(160, 120, colour=True), make_scene(160, 120, seed=5)
    deep = grey.like(lambda a: a.astype(np.uint16) * 251)
    for name, s in (("colour", colour), ("grey", grey), ("deep", deep)):
        save(folder / f"{name}0.ppm", s.reference)
        save(folder / f"{name}1.ppm", s.target)
        cv2.imwrite(str(folder / f"{name}_depth.png"), np.round(s.depth * 5000).astype(np.uint16))
    cv2.imwrite(str(folder / "metres.tiff"), grey.depth)
    mask = np.full((120, 160), 255, np.uint8)
    mask[:40, :70] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    rows = "\n".join(f"{u},{v},{z:.9g},0.01" for (u, v), z in zip(grey.uv, grey.z))
    (folder / "points.csv").write_text(f"u,v,depth,sigma\n{rows}\n")
    (folder / "half.png").write_bytes((folder / "grey_depth.png").read_bytes()[:500])

    def pair(name: str, **more: object) -> dict:
        line = {"reference": f"{name}0.ppm", "target": f"{name}1.ppm", "depth": f"{name}_depth.png", "depth_scale": 5000}
        return {key: value for key, value in {**line, **more}.items() if value is not None}

    lines: list[object] = [
        pair("colour", id="colour", meta={"of": "mine"}),
        pair("grey", truth=grey.T_10.tolist()),
        pair("deep", id="deep"),
        pair("grey", id="metres", depth="metres.tiff"),
        pair("grey", id="features", depth=None, features="points.csv"),
        pair("grey", id="masked", target_mask="mask.png", reference_mask="mask.png"),
        pair("colour", id="lens", distortion="radtan:-0.1,0.02,0.001,-0.001"),
        pair("grey", id="fisheye", distortion="equidistant:0.01,0.002,0,0", features="points.csv"),
        pair("grey", id="guess", initial_pose=np.eye(4).tolist()),
        pair("grey", id="camera", camera=[304, 304, 159.5, 119.5, 320, 240]),
        pair("grey", id="misspelt", depht="x.png"),
        pair("grey", id="gone", target="none.png"),
        pair("grey", id="half", depth="half.png"),
        pair("grey", id="size", depth_scale=-1),
    ]
    path = folder / "pairs.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)) + "\n\n{broken\n")
    return path


@pytest.fixture(scope="module")
def wanted(manifest: Path) -> dict[str, dict]:
    """What the command answers."""
    if not COMMAND:
        pytest.skip("ICLK_COMMAND is not set")
    out = manifest.with_name("results.jsonl")
    words = [COMMAND, "batch", str(manifest), "--out", str(out), "--with-features", *HOW]
    assert subprocess.run(words, capture_output=True).returncode == 20
    return {r["id"]: r for r in map(json.loads, out.read_text().splitlines()) if "status" in r}


def same(got: dict, want: dict) -> None:
    assert (got["id"], got["line"], got["status"]) == (want["id"], want["line"], want["status"])
    if want["status"] == "error":
        assert got.get("T_10") is None and f":{got['line']}: " in got["reason"]
        return
    assert (got["reason"], got["refined"], got["model"]) == (want["reason"], want["refined"], want["model"])
    assert got["T_10"] == np.ravel(want["T_10"]).tolist()
    assert got["covariance"] == (None if want["covariance"][0][0] is None else np.ravel(want["covariance"]).tolist())
    for name in ("gain", "bias", "visible_fraction", "correlation", "agreement"):
        assert got[name] == want[name], name
    assert [(s["name"], s["T_10"], s["cost"]) for s in got["stages"]] == [
        (s["name"], np.ravel(s["T_10"]).tolist(), s["cost"]) for s in want["stages"]
    ]
    if got["features"] is not None:
        keys = ("u0", "v0", "inverse_depth", "u1", "v1", "status")
        assert got["features"] == [{key: f[key] for key in keys} for f in want["features"]]
    assert got["meta"] == (json.dumps(want["meta"]) if "meta" in want else None)


@needs_ray
def test_a_worker_answers_as_the_command(manifest: Path, wanted: dict[str, dict]) -> None:
    options = {"solver": "cpu"}
    worker = _worker.PairWorker(Settings(CAMERA, model="classical", options=options, with_features=True, batch=3))
    shards = _shards.read_manifest(str(manifest), 6).shards
    rows = [row for shard in shards for row in worker.answers(shard.items())]
    assert len(rows) == len(wanted) == 15
    assert sum(row["status"] == "converged" for row in rows) >= 8
    for row in rows:
        same(row, wanted[row["id"]])


@needs_ray
def test_bytes_of_a_parquet_file_are_as_good_as_paths(manifest: Path, tmp_path: Path) -> None:
    folder = manifest.parent
    row = {key: (folder / f"grey{name}").read_bytes() for key, name in (("reference", "0.ppm"), ("target", "1.ppm"))}
    row["depth"] = (folder / "grey_depth.png").read_bytes()
    table = pa.Table.from_pylist([{"id": i, "camera": CAMERA, "depth_scale": 5000.0, **row} for i in range(5)])
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=2)
    pq.write_table(table.set_column(0, "id", pa.array(range(5, 10))), tmp_path / "b.parquet")
    read = _shards.read_manifest(str(tmp_path), 3)
    items = [item for shard in read.shards for item in shard.items()]
    assert [item.id for item in items] == [str(i) for i in range(10)] and [i.line for i in items] == list(range(1, 11))
    loader = Loader(Settings())
    pair = loader.load(request_of(items[7].row, ""))
    paths = {"reference": "grey0.ppm", "target": "grey1.ppm", "depth": "grey_depth.png", "camera": CAMERA, "depth_scale": 5000}
    other = loader.load(request_of(paths, str(folder)))
    assert (pair.reference == other.reference).all() and (pair.features.uv == other.features.uv).all()
    with pytest.raises(BadPair, match="the bytes of 'target'"):
        loader.load(request_of({**items[0].row, "target": b"no image"}, ""))


def run(*words: object) -> subprocess.Popen:
    environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    return subprocess.Popen(
        [sys.executable, "-m", "iclk.ray", *map(str, words)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip


@needs_ray
@needs_command
def test_a_killed_worker_loses_and_repeats_nothing(manifest: Path, wanted: dict[str, dict], tmp_path: Path) -> None:
    lines = [json.loads(line) for line in manifest.read_text().splitlines()[:10]]
    many = [{**line, "id": f"{i}-{line.get('id', 2)}", "meta": None} for i in range(8) for line in lines]
    path = manifest.with_name("many.jsonl")
    path.write_text("\n".join(map(json.dumps, many)))
    out = tmp_path / "out"
    process = run(path, "--out", out, *HOW, "--workers", 2, "--cpus", 0.5, "--shard-pairs", 4)
    until, killed = time.monotonic() + 120, 0
    while process.poll() is None and not killed and time.monotonic() < until:
        time.sleep(0.2)
        if len(list(out.glob("pairs-*"))) >= 4:
            begun = [name for name in (out / "_attempts").glob("*")]
            if begun:
                killed = int(begun[0].read_text() or 0)
                if killed:
                    os.kill(killed, signal.SIGKILL)
    said = process.communicate(timeout=240)
    assert process.returncode == 0 and killed, said
    rows = pq.read_table(out).to_pylist()
    assert sorted(row["id"] for row in rows) == sorted(pair["id"] for pair in many)
    for row in rows:
        want = wanted[row["id"].split("-")[1]]
        assert (row["status"], row["T_10"]) == (want["status"], np.ravel(want["T_10"]).tolist())
    assert not list((out / "_attempts").glob("*"))
    # What is there is not done again; what is missing is.
    before = {name: name.stat().st_mtime_ns for name in out.glob("pairs-*")}
    lost = sorted(before)[3]
    lost.unlink()
    again = run(path, "--out", out, *HOW, "--workers", 1, "--shard-pairs", 4)
    said = again.communicate(timeout=240)
    assert again.returncode == 0 and "4 pairs in" in said[0] and "76 before" in said[0], said
    assert all(name.stat().st_mtime_ns == before[name] for name in before if name != lost)


STEP = """
import sys, ray, iclk.ray
ray.init(num_cpus=2)
path = sys.argv[1]
row = {key: f"{path}/grey{name}" for key, name in (("reference", "0.ppm"), ("target", "1.ppm"), ("depth", "_depth.png"))}
pairs = ray.data.from_items([{"id": str(i), **row, "depth": row["depth"] if i else "none.png"} for i in range(3)])
options = {"camera": sys.argv[2], "depth_scale": 5000, "model": "classical", "solver": "cpu"}
for r in sorted(iclk.ray.align(pairs, workers=1, **options).take_all(), key=lambda r: r["id"]):
    print(r["id"], r["status"], *(r["T_10"] if r["T_10"] is not None else []))
"""


@needs_ray
@needs_command
def test_a_step_of_a_dataset(manifest: Path, wanted: dict[str, dict]) -> None:
    environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
    words = [sys.executable, "-c", STEP, str(manifest.parent), CAMERA]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
    rows = [line.split() for line in done.stdout.splitlines() if line[:2] in ("0 ", "1 ", "2 ")]
    assert [row[1] for row in rows] == ["error", "converged", "converged"], done.stderr
    assert [float(x) for x in rows[2][2:]] == np.ravel(wanted["2"]["T_10"]).tolist()


@needs_ray
def test_what_is_wrong_has_an_exit_code(manifest: Path, tmp_path: Path) -> None:
    twice = tmp_path / "twice.jsonl"
    twice.write_text('{"id": "a"}\n{"id": "a"}\n')
    for words, code, text in (
        ([tmp_path / "none.jsonl", "--out", tmp_path / "o"], 4, "none.jsonl"),
        ([twice, "--out", tmp_path / "o"], 3, "lines 1 and 2"),
        ([manifest, "--out", tmp_path / "o", "--workers", "-1"], 3, "--workers"),
        ([manifest, "--out", tmp_path / "o", "--solver", "gpu"], 2, "--solver"),
    ):
        process = run(*words)
        said = process.communicate(timeout=120)[1]
        assert process.returncode == code and text in said, said


@needs_ray
def test_a_machines_failure_is_not_the_pairs(manifest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    worker = _worker.PairWorker(Settings(CAMERA, model="classical", options={"solver": "cpu"}))
    items = _shards.read_manifest(str(manifest), 2).shards[0].items()
    tries = []

    def stale(request: object) -> None:
        tries.append(1)
        raise OSError(116, "Stale file handle", "a.png")

    monkeypatch.setattr(_worker, "_PAUSES", (0.0, 0.0))
    monkeypatch.setattr(worker._loader, "load", stale)
    with pytest.raises(_worker.MachineFault, match="Stale file handle"):
        worker.answers(items[:1])
    assert len(tries) == 3
    output = _shards.Output(str(tmp_path), 1)
    output.forget_attempts()
    assert [output.begin(0) for _ in range(4)] == [True, True, True, False]
    output.end(0)
    assert output.begin(0)


def test_help_needs_no_ray_and_the_rest_says_what_is_missing(tmp_path: Path) -> None:
    help_text = run("--help").communicate(timeout=120)[0]
    assert "Exit codes:" in help_text
    examples = [line.split("#")[0].split()[3:] for line in help_text.splitlines() if line.startswith("  python -m iclk.ray")]
    assert len(examples) == 4
    for words in examples:
        parser().parse_args(words)
    if MISSING:
        process = run(tmp_path / "pairs.jsonl", "--out", tmp_path / "o")
        assert "pip install 'iclk[ray]'" in process.communicate(timeout=120)[1] and process.returncode == 2


@needs_ray
@needs_vulkan
def test_pictures_are_located(tmp_path: Path) -> None:
    import rasterio
    from iclk.ray._locate import SCHEMA, LocateSettings, LocateWorker
    from test_rooms import above, make_map

    ortho, heights, place, heights_place = make_map()
    maps = {"ortho.tif": (np.moveaxis(ortho, -1, 0), place), "dsm.tif": (heights[None].astype(np.float32), heights_place)}
    for name, (bands, where) in maps.items():
        size = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
        transform = rasterio.Affine.from_gdal(*where)
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs="EPSG:32633", transform=transform, **size) as file:
            file.write(bands)
    K, truth = (300, 300, 159.5, 119.5), above(80, 75, 70)
    image, _ = iclk.Map(ortho, heights, place, heights_place, model="classical").view(truth, K, 320, 240)
    cv2.imwrite(str(tmp_path / "a.png"), image[..., ::-1])
    prior = truth.copy()
    prior[:3, 3] += 3, -4, 2
    rows = [{"id": "a", "image": str(tmp_path / "a.png"), "T_WC": prior.ravel()},
            {"id": "b", "image": str(tmp_path / "none.png"), "T_WC": prior.ravel()},
            {"id": "c", "image": str(tmp_path / "a.png"), "T_WC": [1.0, 2.0]}]
    settings = LocateSettings(str(tmp_path / "ortho.tif"), str(tmp_path / "dsm.tif"), "300,300,159.5,119.5", "", (4, 2), None,
                              None, "classical", "", 10**8)
    a, b, c = LocateWorker(settings)(pa.Table.from_pylist(rows)).cast(SCHEMA).to_pylist()
    assert a["status"] == "converged", a["reason"]
    assert np.linalg.norm(np.reshape(a["T_WC"], (4, 4))[:3, 3] - truth[:3, 3]) < 0.1
    assert b["status"] == c["status"] == "error" and "none.png" in b["reason"] and "not 16" in c["reason"]
