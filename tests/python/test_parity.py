"""iclk.align gives what `iclk align` gives, bit for bit. ICLK_COMMAND names the command; without it this is left out."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import iclk
import numpy as np
import pytest
from conftest import Scene, make_scene, needs_vulkan, pose

COMMAND = os.environ.get("ICLK_COMMAND")
pytestmark = pytest.mark.skipif(not COMMAND, reason="ICLK_COMMAND is not set")


def save(path: Path, image: np.ndarray) -> str:
    """PGM or PPM, whose 16 bits are big-endian."""
    kind = b"P6" if image.ndim == 3 else b"P5"
    most = 65535 if image.dtype == np.uint16 else 255
    pixels = image.astype(">u2") if most > 255 else image
    path.write_bytes(kind + f"\n{image.shape[1]} {image.shape[0]}\n{most}\n".encode() + pixels.tobytes())
    return str(path)


def command(folder: Path, s: Scene, *more: str, mask: np.ndarray | None = None) -> dict:
    features = folder / "points.csv"
    rows = [f"{u:.17g},{v:.17g},{z:.17g}" for (u, v), z in zip(s.uv, s.z)]
    features.write_text("\n".join(["u,v,depth", *rows, ""]))
    line = [COMMAND, "align", save(folder / "a.ppm", s.reference), save(folder / "b.ppm", s.target)]
    line += ["--features", str(features), "--camera", ",".join(f"{k:.17g}" for k in s.K), "--json", *more]
    if mask is not None:
        line += ["--target-mask", save(folder / "mask.pgm", mask)]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.stdout, done.stderr
    return json.loads(done.stdout)


def plain(x: object) -> object:
    """NaN is null in JSON."""
    return np.where(np.isnan(x), None, x).tolist()


def close(x: object, y: object) -> bool:
    """Structure's covariances come of factorisations that Ceres has from SuiteSparse in the command, but not in the wheel."""
    return np.allclose(np.array(plain(x), float), np.array(y, float), rtol=1e-9, atol=0, equal_nan=True)


def same(r: iclk.Alignment, j: dict) -> None:
    assert (r.status, r.reason, r.model, r.refined) == (j["status"], j["reason"], j["model"], j["refined"])
    assert r.T_10.tolist() == j["T_10"]
    exact = "inverse_depth_sigma" not in j["features"][0]
    assert plain(r.covariance) == j["covariance"] if exact else close(r.covariance, j["covariance"])
    assert [list(x) for x in plain(r.uv)] == [[f["u1"], f["v1"]] for f in j["features"]]
    assert list(r.feature_status) == [f["status"] for f in j["features"]]
    assert r.inverse_depth.tolist() == [f["inverse_depth"] for f in j["features"]]
    if "covariance" in j["features"][0]:
        assert plain(r.uv_covariance) == [f["covariance"] for f in j["features"]]
    if not exact:
        assert close(r.inverse_depth_sigma, [f["inverse_depth_sigma"] for f in j["features"]])
    for key in ("gain", "bias", "visible_fraction", "correlation", "agreement"):
        assert getattr(r, key) == j[key], key
    assert (r.turn is None) == (j["turn"] is None)
    assert (r.blur is None) == (j["blur"] is None)
    assert [(s.name, s.T_10.tolist(), s.cost) for s in r.stages] == [(s["name"], s["T_10"], s["cost"]) for s in j["stages"]]
    assert [a._asdict() for a in r.attempts] == j["attempts"]


@pytest.mark.parametrize("kind", ["colour", "grey", "deep"])
def test_features_that_are_chosen(tmp_path: Path, colour: Scene, small: Scene, kind: str) -> None:
    s = {"colour": colour, "grey": small, "deep": small.like(deeper)}[kind]
    raw = np.round(s.depth * 5000).astype(np.uint16)
    raw[20:60, 30:90] = 0
    line = [COMMAND, "align", save(tmp_path / "a.ppm", s.reference), save(tmp_path / "b.ppm", s.target)]
    line += ["--depth", save(tmp_path / "depth.pgm", raw), "--depth-scale", "5000", "--camera", ",".join(map(str, s.K))]
    how = ["--solver", "cpu", "--model", "classical", "--set", "refine=no", "--json"]
    j = json.loads(subprocess.run([*line, *how], capture_output=True, text=True).stdout)
    depth = raw.astype(np.float32) * np.float32(1 / 5000)
    uv, _ = iclk.detect(s.reference, depth)
    assert len(uv) > 60 and uv.tolist() == [[f["u0"], f["v0"]] for f in j["features"]]
    same(iclk.align(s.reference, s.target, None, depth, s.K, device="cpu", model="classical", refine=False), j)


def deeper(a: np.ndarray) -> np.ndarray:
    return a.astype(np.uint16) * 251


CPU = [
    ({}, []),
    ({"refine": False}, ["--set", "refine=no"]),
    ({"structure": True}, ["--set", "structure=yes"]),
    ({"robust": "tukey", "levels": 3}, ["--set", "robust=tukey", "--set", "levels=3"]),
    ({"damping": "adaptive"}, ["--set", "damping=adaptive"]),
    ({"search": "off", "photometric": False}, ["--set", "search=off", "--set", "photometric=no"]),
    ({"search": "on", "rolling_shutter": False}, ["--set", "search=on", "--set", "rolling-shutter=no"]),
    ({"camera_sigma": 0.3}, ["--set", "camera-sigma=0.3"]),
    ({"model": "sd6dof-small", "recolour": False}, ["--model", "sd6dof-small", "--set", "recolour=no"]),
]


@pytest.mark.parametrize("options, words", CPU, ids=lambda x: " ".join(x) if isinstance(x, list) else "")
def test_the_cpu_reference(tmp_path: Path, small: Scene, options: dict, words: list[str]) -> None:
    chosen = {"model": "classical", **options}
    how = words if "model" in options else ["--model", "classical", *words]
    j = command(tmp_path, small, "--solver", "cpu", *how)
    same(iclk.align(small.reference, small.target, small.uv, small.z, small.K, device="cpu", **chosen), j)


def test_a_guess_a_mask_and_colours(tmp_path: Path, colour: Scene) -> None:
    mask = np.full(colour.target.shape[:2], 255, np.uint8)
    mask[:60] = 0
    guess = pose((0.05, -0.03, 0.04), (0.008, 0.012, -0.015))
    text = " ".join(f"{x:.17g}" for x in guess.ravel())
    how = ["--solver", "cpu", "--model", "classical", "--initial-pose", text]
    j = command(tmp_path, colour, *how, mask=mask)
    guess = np.array(guess)
    r = iclk.align(
        colour.reference, colour.target, colour.uv, colour.z, colour.K, T_10=guess, mask=mask, device="cpu", model="classical"
    )
    same(r, j)


@needs_vulkan
@pytest.mark.parametrize("solver", ["host", "device"])
def test_on_the_device(tmp_path: Path, small: Scene, colour: Scene, solver: str) -> None:
    deep = small.like(deeper)
    for s in (colour, deep):
        j = command(tmp_path, s, "--solver", solver, "--model", "classical")
        same(iclk.align(s.reference, s.target, s.uv, s.z, s.K, solver=solver, model="classical"), j)


def test_what_does_not_converge_goes_on_to_the_other_models(tmp_path: Path) -> None:
    near, other = make_scene(160, 120), make_scene(160, 120, seed=9)
    pair = Scene(near.reference, other.target, near.depth, near.K, near.T_10, near.uv, near.z)
    j = command(tmp_path, pair, "--solver", "cpu")
    assert len(j["attempts"]) == 4
    aligner = iclk.Aligner(160, 120, device="cpu", batch=2)
    aligner.set_reference(0, pair.reference, pair.uv, pair.z, pair.K)
    settled, r = aligner.align_batch([(0, near.target), (0, pair.target)])
    same(r, j)
    same(settled, command(tmp_path, near, "--solver", "cpu"))


def test_models_and_devices(tmp_path: Path) -> None:
    def said(*words: str) -> str:
        return subprocess.run([COMMAND, *words, "--json"], capture_output=True, text=True).stdout

    assert iclk.model_info("sd6dof-small") == json.loads(said("model", "info", "sd6dof-small"))
    listed = said("devices")
    assert iclk.devices() == (json.loads(listed) if listed else [])
