"""Memory stays flat however many frames are rendered, and too large a picture is refused before it is allocated."""

from __future__ import annotations

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal, Lens
from cadcam.errors import MissingCore, MissingExtra, MissingOpenGL, NotEnoughMemory
from cadcam.geometry.rigid import Rigid
from cadcam.render import RENDERERS, memory, open_renderer
from cadcam.render.view import Channel, Renderer, Scene

FRAMES = Path(__file__).with_name("frames.py")
needs_proc = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")


SCENE = Scene.of(Mesh.single(np.eye(3) + np.array([0, 0, 5]), [[0, 1, 2]]))


def opened(name: str) -> Renderer:
    try:
        return open_renderer(SCENE, name)
    except (MissingCore, MissingExtra, MissingOpenGL) as error:
        pytest.skip(str(error))


def growth(name: str, frames: int, *, warm: int) -> float:
    """Return by what share the memory in use grew, from the first quarter of the frames to the last (medians).

    `warm` frames come before and do not count. With one arena for all threads: how many glibc's allocator keeps is
    chance, and a few percent. Mesa draws without threads of its own: with them it took 3 MB at once in one of eight
    processes, whenever these met; without, nothing in ten. BLAS has its own threads, as users have it: with a single
    one, as the tests' workers have, threads that call it take their 3 MB when they first meet, one process in eight.
    """
    opened(name)
    usual = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, str(FRAMES), name, str(frames), str(warm)],
        capture_output=True,
        text=True,
        check=True,
        env={**usual, "MALLOC_ARENA_MAX": "1", "LP_NUM_THREADS": "0"},
    )
    frame, used = np.array([line.split() for line in done.stdout.splitlines()], float).T
    assert frame[-1] == frames
    used /= 2**20
    print(
        f"{name}: {used[0]:.1f} MiB, after {frames} more frames {used[-1]:.1f}, all {used.min():.1f}-{used.max():.1f}"
    )
    quarter = len(used) // 4
    return float(np.median(used[-quarter:]) / np.median(used[:quarter]) - 1)


@needs_proc
@pytest.mark.parametrize(
    ("name", "frames", "warm"), [("raster", 1200, 100), pytest.param("gl", 240, 400, marks=pytest.mark.slow)]
)
def test_memory_stays_flat_over_hundreds_of_frames(name: str, frames: int, warm: int) -> None:
    """A thread that lends a hand takes a megabyte and gives it back, as chance has it: medians of 15 renderers.

    NVIDIA's driver (580.159) takes 4 MB in the first 400 frames, and nothing in the next 1000.
    """
    assert growth(name, frames, warm=warm) < 0.01


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("name", RENDERERS)
def test_memory_stays_flat_over_ten_thousand_frames(name: str) -> None:
    """What grows for ever would grow in the second ten thousand frames as in the first.

    The process of `gl` (Mesa 22.3, llvmpipe) creeps from 165 to 168.5 MiB in its first 12 000 frames, 600 renderers,
    and stands still from there: 168.6 MiB after 20 000. So the first ten thousand are its warm-up.
    """
    assert growth(name, 10_000, warm=10_000 if name == "gl" else 100) < 0.01


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("lens", [Ideal(), BrownConrady(-0.1)], ids=["plain", "lens"])
def test_a_picture_beyond_memory_is_refused_before_it_is_allocated(
    name: str, lens: Lens, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer, camera = opened(name), Camera.from_focal((8000, 6000), 5000.0, lens=lens)
    monkeypatch.setattr(memory, "available_bytes", lambda: 100 * 2**20)
    tracemalloc.start()
    try:
        for render in (
            lambda: renderer.render(camera, Rigid(), channels=Channel.DEPTH),
            lambda: next(iter(renderer.render_batch(camera, [Rigid()]))),
        ):
            with pytest.raises(NotEnoughMemory, match=r"8000 x 6000 px .*needs .* GiB .* 0\.1 GiB are free; .*smaller"):
                render()
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2**20


def test_files_kept_in_memory_leave_a_container_its_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system counts them as used, up to the limit, and drops them when memory is asked for."""
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    monkeypatch.setattr(memory, "_meminfo", lambda: None)
    (tmp_path / "memory.max").write_text("1000000\n")
    (tmp_path / "memory.current").write_text("990000\n")
    (tmp_path / "memory.stat").write_text("anon 190000\nfile 800000\ninactive_file 500000\nactive_file 200000\n")
    assert memory.available_bytes() == 10_000 + 700_000
