"""Types, examples, what lies in the package."""

from __future__ import annotations

import importlib.util
import inspect
import subprocess
import sys
from pathlib import Path

import iclk
import numpy as np
import pytest
from conftest import needs_vulkan

EXAMPLES = Path(__file__).parents[2] / "examples"
USE = """
import numpy as np
import iclk
r = iclk.align(np.zeros((2, 2), np.uint8), None, [[0, 0]], [1.0], (1, 1, 0, 0), levels=3)
reveal_type(r.T_10)
reveal_type(r.status)
reveal_type(iclk.devices()[0]["name"])
reveal_type(iclk.Aligner(2, 2).align_batch([(0, None)])[0].aligned)
iclk.align(1, 2, 3, 4)
iclk.Aligner(2, 2, levels="three")
iclk.Aligner(2, 2, level=3)
"""


def test_types(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    folder = Path(iclk.__file__).parent
    assert (folder / "py.typed").exists() and (folder / "_core.pyi").exists()
    (tmp_path / "use.py").write_text(USE)
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "--cache-dir", str(tmp_path / "cache")]
    files = [tmp_path / "use.py", *EXAMPLES.glob("*.py")]
    done = subprocess.run([*command, *map(str, files)], capture_output=True, text=True)
    lines = done.stdout.splitlines()
    said = [line.split(": ", 1)[1] for line in lines if line.startswith(str(tmp_path / "use.py"))]
    notes = [line for line in said if line.startswith("note: Revealed")]
    assert len(notes) == 4 and "float64" in notes[0] and "'converged'" in notes[1] and "str" in notes[2], done.stdout
    errors = [line for line in said if line.startswith("error")]
    assert len(errors) == 3 and '"K"' in errors[0] and "levels" in errors[1] and '"level"' in errors[2], done.stdout
    ours = [line for line in lines if ": error:" in line and "use.py" not in line and "iclk" in line]
    assert not ours, "\n".join(ours)


def test_everything_is_documented_and_there() -> None:
    for name in iclk.__all__:
        thing = getattr(iclk, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), name
            for method, function in inspect.getmembers(thing, inspect.isfunction):
                if not method.startswith("_") and thing.__module__.startswith("iclk"):
                    assert inspect.getdoc(function), f"{name}.{method}"
    assert {p.stem for p in (Path(iclk.__file__).parent / "models").glob("*.safetensors")} == {"sd6dof", "sd6dof-small"}
    assert iclk.__version__.count(".") == 2


def example(name: str, *arguments: object) -> str:
    done = subprocess.run([sys.executable, str(EXAMPLES / name), *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_vulkan
def test_example_of_two_images(tmp_path: Path) -> None:
    wanted: list[object] = []
    if importlib.util.find_spec("matplotlib"):
        wanted += ["--out", tmp_path / "aligned.png"]
    if importlib.util.find_spec("rerun"):
        wanted += ["--rrd", tmp_path / "aligned.rrd"]
    said = example("align_two_images.py", *wanted)
    assert said.startswith("converged: ")
    for path in wanted[1::2]:
        assert Path(str(path)).stat().st_size > 10_000


@needs_vulkan
def test_example_of_a_trajectory(tmp_path: Path) -> None:
    said = example("trajectory.py", "--out", tmp_path, "--frames", 5)
    assert "5 of 5 frames tracked" in said
    found, truth = (np.loadtxt(tmp_path / name) for name in ("trajectory.txt", "truth.txt"))
    assert found.shape == truth.shape == (5, 8)
    np.testing.assert_allclose(np.linalg.norm(found[:, 4:], axis=1), 1, atol=1e-6)
    way = np.linalg.norm(truth[-1, 1:4] - truth[0, 1:4])
    assert abs(np.linalg.norm(found[-1, 1:4] - found[0, 1:4]) - way) < 0.05 * way
    assert (tmp_path / "images.txt").read_text().count(".png") == 5
    if importlib.util.find_spec("evo"):
        from evo.core import metrics, sync
        from evo.tools import file_interface

        pair = sync.associate_trajectories(
            *(file_interface.read_tum_trajectory_file(str(tmp_path / name)) for name in ("truth.txt", "trajectory.txt"))
        )
        pair[1].align(pair[0])
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data(pair)
        assert ape.get_statistic(metrics.StatisticsType.rmse) < 0.05 * way
