"""Work on all cores: in forked processes, within itself, after errors, and within limits."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from cadcam import cores
from cadcam.cad.parts.shape import box
from cadcam.cores import Threads, blocks, on_cores, usable_cores
from cadcam.locate.part import Part

# A fork copies a process without its threads. The child draws, searches and shares out work as the parent did before.
FORKED = """
import multiprocessing
import cadcam
from cadcam.cad.parts.shape import box
from cadcam.cores import on_cores

part = cadcam.Part.of(box((0, 0, 0), (300, 200, 100), name="box"))
camera = cadcam.Camera.from_focal((320, 240), 400.0)
poses = [cadcam.Rigid.look_at([x, -400.0, 500.0], [150.0, 100.0, 50.0]) for x in (300.0, 600.0, 900.0)]
renderer = cadcam.open_renderer(part.scene, threads=2)
photo = cadcam.Photo.of(renderer.render(camera, poses[0]).gray, camera)

def work(k):
    drawn = [float(view.gray.sum()) for view in renderer.render_batch(camera, poses)]
    return on_cores(abs, range(9)), drawn, cadcam.locate_part(part, [photo], poses[k]).found

before = [work(k) for k in range(2)]
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map_async(work, range(2)).get(100) == before
print("as before")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked on Unix")
def test_a_forked_process_has_threads_of_its_own() -> None:
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=150)
    assert done.stdout == "as before\n", done.stderr


def test_a_part_travels_to_another_process() -> None:
    part = Part.of(box((0, 0, 0), (300, 200, 100), name="box"))
    _ = part.lines, part.caster, part.aspects.aspect(0, 0)  # holds what cannot travel
    there = pickle.loads(pickle.dumps(part))
    np.testing.assert_array_equal(there.scene.mesh.vertices, part.scene.mesh.vertices)
    assert repr(there) == repr(part)


def test_results_are_in_order() -> None:
    assert on_cores(lambda k: k * k, range(100)) == [k * k for k in range(100)]
    assert on_cores(str, []) == []
    assert [(s.start, s.stop) for s in blocks(5, 2)] == [(0, 2), (2, 4), (4, 5)]
    assert [(s.start, s.stop) for s in blocks(0)] == [(0, 0)]


def test_work_within_work_ends() -> None:
    """Every thread waits for others to do its items: without care none is left to do them."""
    width = 2 * usable_cores() + 1
    nested = on_cores(lambda i: sum(on_cores(lambda j: i * j, range(width))), range(width))
    assert nested == [i * sum(range(width)) for i in range(width)]


def test_after_an_error_what_has_not_begun_is_not_done() -> None:
    begun: list[int] = []
    held = threading.Event()

    def work(k: int) -> None:
        begun.append(k)
        if k == 0:
            raise ValueError("the first")
        held.wait(5)

    with pytest.raises(ValueError, match="the first"):
        on_cores(work, range(usable_cores() + 50))
    held.set()
    assert len(begun) < 2 * usable_cores() + 2


def test_a_container_limits_the_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(16)), raising=False)
    quota = tmp_path / "cpu.max"
    monkeypatch.setattr(cores, "_QUOTA", quota)
    for said, expected in (
        ("250000 100000", 3),
        ("1000 100000", 1),
        ("max 100000", 16),
        ("6400000 100000", 16),
        ("nonsense", 16),
    ):
        quota.write_text(said + "\n")
        cores._quota.cache_clear()
        assert usable_cores() == expected, said
    quota.unlink()
    cores._quota.cache_clear()
    assert usable_cores() == 16
    monkeypatch.undo()
    cores._quota.cache_clear()


def test_threads_are_as_many_as_asked_for() -> None:
    threads, names = Threads(3), set()
    meeting = threading.Barrier(3)

    def meet() -> None:
        meeting.wait(30)
        names.add(threading.current_thread().name)

    for done in [threads.submit(meet) for _ in range(3)]:
        done.result()
    assert len(names) == 3
