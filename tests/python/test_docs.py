"""README.md and docs/guide: their Python runs, their commands of README run, and all others name options that exist."""

from __future__ import annotations

import functools
import os
import pathlib
import re
import shlex
import subprocess

import iclk
import numpy as np
import pytest
from conftest import needs_vulkan
from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
COMMAND = os.environ.get("ICLK_COMMAND", "")
needs_command = pytest.mark.skipif(not COMMAND, reason="no iclk command")
FLIGHT = "".join(f"{i / 2} {200 + 4 * i} {200 + 2 * i} {130 + i} 1 {0.01 * i} 0 0\n" for i in range(3))


def python_of(page: pathlib.Path) -> str:
    return "\n".join(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))


def commands_of(page: pathlib.Path) -> list[list[str]]:
    """Lines of code that call iclk, without comments, pipes and redirections."""
    lines = page.read_text().replace("\\\n", " ").split("\n")
    found = [re.match(r"(?:    |\$ )?((?:build/)?iclk [a-z].*)", line) for line in lines if line.startswith(("    ", "build/"))]
    return [shlex.split(re.split(r" [|>] ", m[1])[0], comments=True) for m in found if m]


@needs_vulkan
@pytest.mark.parametrize("page", [p for p in GUIDE if python_of(p)], ids=lambda p: p.name)
def test_the_python_of_a_page_runs(page: pathlib.Path) -> None:
    exec(compile(python_of(page), str(page), "exec"), {})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """What the examples of README read: a pair, its depth and features, a camera, a recording."""
    path = tmp_path_factory.mktemp("readme")
    camera = ["--camera", "517.3,516.5,318.6,255.3"]
    (path / "flight.txt").write_text(FLIGHT)
    terrain = [COMMAND, "render", "--terrain", "procedural:7:400"]
    for options in (["--pairs", "1", *camera, "--altitude", "60,60", "--out", "set"],
                    ["--trajectory", "flight.txt", "--rate", "4", "--size", "188x120", "--out", "recording"]):
        subprocess.run([*terrain, *options], cwd=path, check=True, capture_output=True)
    for name, image in (("a.png", "0.png"), ("b.png", "1.png")):
        (path / "set/images" / f"000000_{image}").rename(path / name)
    (path / "set/features/000000.csv").rename(path / "points.csv")
    depth = np.asarray(Image.open(path / "set/depth/000000.tiff"))
    Image.fromarray(np.round(depth * 500).astype(np.uint16)).save(path / "a_depth.png")
    (path / "camera.yaml").write_text(
        "%YAML:1.0\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 517.3, 0., 318.6, 0., 516.5, 255.3, 0., 0., 1. ]\n")
    (path / "build").symlink_to(pathlib.Path(COMMAND).parent)
    return path


@needs_command
@needs_vulkan
@pytest.mark.parametrize("command", commands_of(ROOT / "README.md"), ids=" ".join)
def test_a_command_of_readme_runs(folder: pathlib.Path, command: list[str]) -> None:
    # The depth of the example has 5000 units a metre; 60 m are more than 16 bits of these.
    command = ["500" if word == "5000" else word for word in command]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr


@needs_command
@needs_vulkan
def test_the_python_of_readme_runs(folder: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    names: dict = {}
    exec(compile(python_of(ROOT / "README.md").replace("/ 5000", "/ 500"), "README.md", "exec"), names)
    assert names["r"].converged, names["r"].reason


@functools.cache
def help_of(*names: str) -> str:
    ran = subprocess.run([COMMAND, *names, "--help"], capture_output=True, text=True)
    return ran.stdout if ran.returncode == 0 else ""


@needs_command
@pytest.mark.parametrize("page", [ROOT / "README.md", *GUIDE], ids=lambda p: p.name)
def test_commands_name_options_that_exist(page: pathlib.Path) -> None:
    for command in commands_of(page):
        names = command[1:3] if command[1] == "model" else command[1:2]
        text = help_of(*names)
        assert text or names[0] in ("eval", "bench"), f"no command: {command}"
        for word in command[2:] if text else []:
            if word.startswith("--"):
                assert re.search(rf"(^|[\s,]){word}\b", text), f"no option {word}: {command}"
        for setting in (b for a, b in zip(command, command[1:]) if a == "--set"):
            assert re.search(rf"^\s+{setting.split('=')[0]}=", text, re.MULTILINE), f"no setting {setting}: {command}"


def test_pages_have_what_is_tested() -> None:
    assert python_of(ROOT / "README.md") and sum(len(commands_of(page)) for page in GUIDE) > 20
    assert len(commands_of(ROOT / "README.md")) >= 3
    assert iclk.__version__ in (ROOT / "README.md").read_text()
