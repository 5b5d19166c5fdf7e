"""Threads, signals, forks, the interpreter's end, memory."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import iclk
import numpy as np
import pytest
from conftest import Scene, make_scene, needs_vulkan

SETUP = """
import os, signal, sys, threading, time
import numpy as np
import iclk
from conftest import make_scene
s = make_scene(160, 120)
device = {device!r}
def aligner(batch=16):
    a = iclk.Aligner(160, 120, "classical", device, batch=batch)
    a.set_reference(0, s.reference, s.uv, s.z, s.K)
    return a
"""


CHILDREN: list[subprocess.Popen] = []


@pytest.fixture(autouse=True)
def no_child_is_left() -> Iterator[None]:
    yield
    while CHILDREN:
        child = CHILDREN.pop()
        if child.poll() is None:  # of a test that failed
            child.kill()
            child.communicate()


def python(code: str, device: str | None = "cpu", **environment: str) -> subprocess.Popen:
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    child = subprocess.Popen(
        [sys.executable, "-X", "faulthandler", "-c", SETUP.format(device=device) + textwrap.dedent(code)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path, "ICLK_ALLOW_NO_DEVICE": "1", **environment},
    )
    CHILDREN.append(child)
    return child


def test_two_threads_with_an_aligner_each(small: Scene, device: str | None) -> None:
    scenes = [small, make_scene(160, 120, seed=2)]

    def work(s: Scene) -> list[np.ndarray]:
        a = iclk.Aligner(160, 120, "classical", device, batch=2)
        a.set_reference(0, s.reference, s.uv, s.z, s.K)
        return [r.T_10 for _ in range(3) for r in a.align_batch([(0, s.target)] * 2)]

    one_by_one = [work(s) for s in scenes]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(work, scenes))
    for a, b in zip(one_by_one, together):
        for x, y in zip(a, b):
            np.testing.assert_array_equal(x, y)


def test_threads_take_turns_with_one_aligner_and_with_the_function(small: Scene) -> None:
    a = iclk.Aligner(160, 120, "classical", "cpu")
    a.set_reference(0, small.reference, small.uv, small.z, small.K)
    expected = a.align(0, small.target).T_10

    def function(_: int) -> np.ndarray:
        return iclk.align(small.reference, small.target, small.uv, small.z, small.K, device="cpu", model="classical").T_10

    with ThreadPoolExecutor(3) as pool:
        for T in [*pool.map(lambda _: a.align(0, small.target).T_10, range(6)), *pool.map(function, range(6))]:
            np.testing.assert_array_equal(T, expected)


def test_other_threads_run_meanwhile(small: Scene) -> None:
    """With the GIL held, this thread would not count while the other one is inside."""
    a = iclk.Aligner(160, 120, "classical", "cpu", batch=1000)
    a.set_reference(0, small.reference, small.uv, small.z, small.K)
    inside, counted = threading.Event(), 0

    def work() -> None:
        inside.set()
        a.align_batch([(0, small.target)] * 8)

    thread = threading.Thread(target=work)
    thread.start()
    inside.wait()
    while thread.is_alive():
        counted += 1
        thread.join(0.001)
    assert counted > 8


def test_ctrl_c_ends_a_long_batch(device: str | None) -> None:
    child = python(
        """
        signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in a shell's background ignore it
        a = aligner(batch=4)
        a.align(0, s.target)
        print("ready", flush=True)
        a.align_batch([(0, s.target)] * 1_000_000)
        """,
        device,
    )
    assert child.stdout and child.stdout.readline() == "ready\n"
    child.send_signal(signal.SIGINT)
    _, error = child.communicate(timeout=120)
    assert "KeyboardInterrupt" in error and child.returncode == -signal.SIGINT


def test_the_interpreter_may_end_while_work_is_under_way(device: str | None) -> None:
    child = python(
        """
        def forever():
            a = aligner()
            while True:
                a.align_batch([(0, s.target)] * 4)
                begun.set()
        begun = threading.Event()
        for _ in range(2):
            threading.Thread(target=forever, daemon=True).start()
        begun.wait()
        kept = aligner()
        iclk.align(s.reference, s.target, s.uv, s.z, s.K, device=device, model="classical")
        print("end")
        """,
        device,
    )
    out, error = child.communicate(timeout=120)
    assert (child.returncode, out, error) == (0, "end\n", "")


FORK = """
    import multiprocessing
    a = aligner()
    first = a.align(0, s.target).T_10
    iclk.align(s.reference, s.target, s.uv, s.z, s.K, device=device, model="classical")
    def worker(_):
        try:
            a.align(0, s.target)
            return "worked"
        except iclk.Error as e:
            message = str(e)
        own = aligner().align(0, s.target).T_10
        again = iclk.align(s.reference, s.target, s.uv, s.z, s.K, device=device, model="classical").T_10
        assert (own == first).all() and again.shape == (4, 4)
        return message
    with multiprocessing.get_context("fork").Pool(1) as pool:
        print(pool.map(worker, [0])[0], flush=True)
    assert (a.align(0, s.target).T_10 == first).all()
    if os.fork() == 0:
        del a
        sys.exit(0)  # the whole way down
    print(os.wait()[1])
"""


def test_a_forked_worker_makes_its_own(device: str | None) -> None:
    child = python(FORK, device)
    out, error = child.communicate(timeout=120)
    assert child.returncode == 0, error
    message, status = out.splitlines()
    assert "before the process was forked" in message and "make it in the worker" in message and status == "0"


def test_without_vulkan_the_cpu_works(tmp_path: Path) -> None:
    nothing = str(tmp_path / "none.json")
    child = python(
        """
        assert iclk.devices() == []
        assert aligner().align(0, s.target).converged
        try:
            iclk.Aligner(160, 120)
        except iclk.Error as e:
            print(e.code, "/", e)
        """,
        VK_DRIVER_FILES=nothing,
        VK_ICD_FILENAMES=nothing,
    )
    out, error = child.communicate(timeout=120)
    assert child.returncode == 0, error
    assert out.startswith("no_driver / ") and 'device="cpu"' in out


CALLS = int(os.environ.get("ICLK_LEAK_CALLS", "500"))


def test_no_memory_is_left_behind() -> None:
    """ICLK_LEAK_CALLS=10000 for the figure of docs/results/python.md."""
    s = make_scene(64, 48)
    aligner = iclk.Aligner(64, 48, "classical", "cpu", levels=2, search="off", references=1)
    options = {"device": "cpu", "model": "classical", "levels": 2, "search": "off"}

    def calls(count: int) -> None:
        for i in range(count):
            aligner.set_reference(0, s.reference, s.uv, s.z, s.K)
            aligner.align(0, s.target)
            iclk.align(s.reference, s.target, s.uv, s.z, s.K, **options)
            iclk.detect(s.reference, s.depth, 20)
            with pytest.raises(ValueError):
                iclk.align(s.reference, s.target[1:], s.uv, s.z, s.K, **options)
            with pytest.raises(ValueError):
                aligner.align(1, s.target)

    def resident() -> int:
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    calls(200)
    counts = [sys.getrefcount(x) for x in (s.reference, s.target, s.uv, s.z)]
    before, objects = resident(), len(gc.get_objects())
    calls(CALLS)
    assert [sys.getrefcount(x) for x in (s.reference, s.target, s.uv, s.z)] == counts
    assert len(gc.get_objects()) - objects < 200
    assert resident() - before < 2 << 20


class MallInfo(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena blocks small maps mapped top trimmed used free keep".split()]


@needs_vulkan
@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="needs glibc 2.33")
def test_an_aligner_takes_its_memory_along() -> None:
    """What malloc has in use: glibc keeps what a software device's compiler frees (docs/results/python.md)."""
    s = make_scene(160, 120)
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = MallInfo

    def used_after(count: int) -> int:
        for _ in range(count):
            aligner = iclk.Aligner(160, 120, "classical", refine=False)
            aligner.set_reference(0, s.reference, s.uv, s.z, s.K)
            assert aligner.align(0, s.target).converged
            del aligner
        gc.collect()
        info = mallinfo()
        return info.used + info.mapped

    before = used_after(2)  # what is made once is there
    assert used_after(6) - before < 20 << 20  # one that is kept has 54 MB
