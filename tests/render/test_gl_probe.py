"""EGL devices are probed without side effects, and their absence is one line of a report."""

from __future__ import annotations

import shutil
import subprocess
from ctypes.util import find_library
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.errors import MissingExtra, MissingOpenGL
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.gl import context as gl_context
from cadcam.render.gl.bend import LONGEST_PX, BendTable, bend_table
from cadcam.render.gl.context import GlInfo, probe
from cadcam.render.gl.pieces import NEAR_SHARE, REACH_PX, frustum_of, pieces
from cadcam.render.gl.tiles import tiles
from cadcam.render.view import Scene

TRIANGLE = Mesh.single(np.array([[0, 0, 100.0], [50, 0, 100], [0, 50, 100]]), np.array([[0, 1, 2]]))
SCENE = Scene.of(TRIANGLE, edges=NO_EDGES)
GPU = GlInfo(True, "NVIDIA H100", "NVIDIA Corporation", "4.6.0", False, 1)
SOFTWARE = GlInfo(True, "llvmpipe (LLVM 15)", "Mesa", "4.5", True, 0)


@pytest.fixture(autouse=True)
def _no_names(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CADCAM_GL_DEVICE", "CADCAM_LIBEGL", "CADCAM_LIBGL"):
        monkeypatch.delenv(name, raising=False)


def answer_with(monkeypatch: pytest.MonkeyPatch, *found: GlInfo) -> None:
    monkeypatch.setattr(gl_context, "devices", lambda: found)


def script(monkeypatch: pytest.MonkeyPatch, folder: Path, text: str) -> tuple[GlInfo, ...]:
    """Have the child process run `text` instead of asking EGL."""
    pytest.importorskip("moderngl", reason="needs the extra gl")
    file = folder / "probe.py"
    file.write_text(text)
    monkeypatch.setattr(gl_context.gl_probe, "__file__", str(file))
    return gl_context._devices.__wrapped__("", "")


# the latter comes first on a machine without any OpenGL
NOT_LOADED = rf"{'libNoSuchEGL.so' if find_library('OpenGL') else 'libOpenGL.so.0'} not loaded"


def test_a_broken_egl_name_costs_one_clear_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("moderngl", reason="needs the extra gl")
    monkeypatch.setenv("CADCAM_LIBEGL", "libNoSuchEGL.so")
    with pytest.raises(MissingOpenGL, match=rf"{NOT_LOADED}; use the renderer 'auto'") as caught:
        open_renderer(SCENE, "gl")
    assert "\n" not in str(caught.value)
    assert open_renderer(SCENE).name != "gl"
    assert capfd.readouterr() == ("", "")


def test_a_driver_that_crashes_or_hangs_or_talks_takes_nobody_with_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    crash = "import os, signal\nprint('libEGL warning: x')\nos.kill(os.getpid(), signal.SIGSEGV)"
    (info,) = script(monkeypatch, tmp_path, crash)
    assert (info.available, info.reason) == (False, "the OpenGL driver ended its process with signal 11")
    monkeypatch.setattr(gl_context, "_PATIENCE", 0.2)
    (info,) = script(monkeypatch, tmp_path, "import time; time.sleep(60)")
    assert not info.available
    assert "did not answer" in info.reason
    monkeypatch.setattr(gl_context, "_PATIENCE", 30.0)
    good = '{"device": 0, "renderer": "llvmpipe (LLVM 15)", "vendor": "Mesa", "version": "4.5"}'
    (info,) = script(monkeypatch, tmp_path, f"print('{good}')")
    assert info == SOFTWARE
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("void __attribute__((constructor)) start(void) { abort(); }", "ended its process with signal 6"),
        ("void __attribute__((constructor)) start(void) { exit(3); }", "ended its process with exit status 3"),
        ("int eglGetError(void) { return 0; }", "not found"),
    ],
)
def test_an_egl_that_is_there_but_broken_costs_a_line_and_not_the_process(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str], source: str, words: str
) -> None:
    pytest.importorskip("moderngl", reason="needs the extra gl")
    compiler = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), None)
    if compiler is None:
        pytest.skip("no C compiler")
    (tmp_path / "egl.c").write_text(f"#include <stdlib.h>\n{source}\n")
    library = tmp_path / "libEGL.so"
    subprocess.run([compiler, "-shared", "-fPIC", str(tmp_path / "egl.c"), "-o", str(library)], check=True)
    monkeypatch.setenv("CADCAM_LIBEGL", str(library))
    with pytest.raises(MissingOpenGL, match=f"{words}; use the renderer 'auto'") as caught:
        open_renderer(SCENE, "gl")
    assert "\n" not in str(caught.value)
    renderer = open_renderer(SCENE)
    assert renderer.name != "gl"
    assert renderer.render(Camera.from_focal((40, 30), 40.0), Rigid()).mask.any()
    assert capfd.readouterr() == ("", "")


def test_a_gpu_is_chosen_before_software_and_any_device_by_number_or_name(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, SOFTWARE, GPU)
    assert probe() == GPU
    assert probe(0) == probe("llvmpipe") == SOFTWARE
    assert probe("nvidia") == probe("1") == GPU
    monkeypatch.setenv("CADCAM_GL_DEVICE", "llvm")
    assert probe() == SOFTWARE
    assert probe(7).reason.startswith("unknown OpenGL device '7'")
    answer_with(monkeypatch, SOFTWARE, replace(GPU, available=False, reason="no permission"))
    monkeypatch.delenv("CADCAM_GL_DEVICE")
    assert probe() == SOFTWARE


def test_auto_leaves_opengl_to_those_who_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    answer_with(monkeypatch, GPU)
    assert open_renderer(SCENE).name != "gl"


def test_without_its_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_context, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r'pip install "cadcam\[gl\]"'):
        open_renderer(SCENE, "gl")
    assert open_renderer(SCENE).name != "gl"
    assert "cadcam[gl]" in gl_context._devices.__wrapped__("", "")[0].reason


@pytest.mark.parametrize("size", [(1, 1), (7, 5), (640, 480), (20_000, 3), (3, 20_000)])
def test_tiles_cover_each_pixel_once(size: tuple[int, int]) -> None:
    count = np.zeros(size[::-1], int)
    for tile in tiles(size, side=100, pixels=900):
        assert max(tile.width, tile.height) <= 100
        assert tile.width * tile.height <= 900
        count[tile.rows, tile.columns] += 1
    assert (count == 1).all()


LENSES = [BrownConrady(-0.3, 0.09, 5e-3, -4e-3), BrownConrady(0.4), Fisheye(0.05, -0.02)]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("focal", [160.0, 900.0])
def test_pieces_reach_every_pixel_that_their_face_covers(lens: Lens, focal: float, rng: np.random.Generator) -> None:
    """Random faces, many passing the camera's plane: each point lies within reach of what is drawn for its face."""
    camera = Camera.from_focal((320, 240), focal, cx=140.0, lens=lens)
    corners = rng.normal(size=(60, 3, 3)) * [200, 200, 150] + [0, 0, 150]
    frustum = frustum_of(camera, NEAR_SHARE * corners[..., 2].max())
    found, owner = pieces(camera, frustum, corners)
    asked = 0
    for k, triangle in enumerate(corners):
        q = camera.project(rng.dirichlet([0.4, 0.4, 0.4], size=400) @ triangle)
        q = q[camera.sees(q)]
        mine = found[owner == k]
        assert len(mine) or not len(q)
        asked += len(q)
        if len(q):
            assert _distance(mine, q).max() < REACH_PX
    assert asked > 300


@pytest.mark.parametrize("lens", [*LENSES, BrownConrady(-0.2, 0.05, 1e-3, -5e-4), BrownConrady(-0.4, 0.5), Ideal()])
@pytest.mark.parametrize("focal", [90.0, 420.0, 20_000.0])
def test_edges_bend_no_more_than_the_table_of_their_ends_says(
    lens: Lens, focal: float, rng: np.random.Generator
) -> None:
    """The images of random edges between directions that the table knows, and those directions' pixels."""
    camera = Camera.from_focal((640, 480), focal, cx=300.0, lens=lens)
    frustum = frustum_of(camera, 1.0)
    table, n = bend_table(camera, frustum), 4000
    ends = [table.low + rng.uniform(0, 510.9, size=(n, 2)) * table.step for _ in range(2)]
    ends[1] = np.where(rng.random((n, 1)) < 0.5, ends[1], ends[0] + 40 * table.step * rng.normal(size=(n, 2)))
    ends[1] = np.clip(ends[1], table.low, table.low + 510.9 * table.step)
    (qa, ba), (qb, bb) = (looked_up(table, s) for s in ends)
    length, bending = np.linalg.norm(qa - qb, axis=1), np.maximum(ba, bb)
    chosen = (np.minimum(ba, bb) >= 0) & (length < LONGEST_PX)
    assert chosen.sum() > n / 20
    a, b = (direction(s[chosen]) for s in ends)
    for q, d in ((qa, a), (qb, b)):
        assert np.linalg.norm(q[chosen] - camera.project(d), axis=1).max() < 0.2
    most = np.zeros(chosen.sum())
    across = (qb - qa)[chosen][:, ::-1] * [1, -1] / np.maximum(length[chosen], 1e-9)[:, None]
    for t in np.linspace(0.1, 0.9, 9):
        q = camera.project(a * (1 - t) + b * t)
        assert np.isfinite(q).all()
        most = np.maximum(most, np.abs(np.sum((q - camera.project(a)) * across, axis=1)))
    assert (most < 0.25 * bending[chosen] * length[chosen] ** 2 + 0.4).all()


def looked_up(table: BendTable, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels and the bending of directions s (N, 2), as the shader does."""
    at = (s - table.low) / table.step
    j, i = np.floor(at).astype(int).clip(0, 510).T
    t = (at - np.stack([j, i], axis=1))[:, None]
    q = table.nodes[..., :2].astype(float)
    low, high = (q[i + k, j] * (1 - t[..., 0]) + q[i + k, j + 1] * t[..., 0] for k in range(2))
    return low * (1 - t[..., 1]) + high * t[..., 1], table.nodes[i, j, 2].astype(float)


def direction(s: np.ndarray) -> np.ndarray:
    square = np.sum(s * s, axis=1, keepdims=True)
    return np.asarray(np.hstack([2 * s, 1 - square]) / (1 + square))


def _distance(triangles: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return how far points q (N, 2) lie outside the nearest of some triangles (M, 3, 2)."""
    a, b = triangles[:, None], np.roll(triangles, -1, axis=1)[:, None]
    p, d = q[None, :, None], b - a
    t = np.clip(np.sum((p - a) * d, axis=-1) / np.maximum(np.sum(d * d, axis=-1), 1e-300), 0, 1)
    distance = np.linalg.norm(a + t[..., None] * d - p, axis=-1).min(axis=2)
    side = d[..., 0] * (p - a)[..., 1] - d[..., 1] * (p - a)[..., 0]
    inside = (side >= 0).all(axis=2) | (side <= 0).all(axis=2)
    return np.asarray(np.where(inside, 0.0, distance).min(axis=0))
