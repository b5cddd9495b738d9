"""The C core behind its one Python module: instruction sets agree, bad input stops before it, sanitizers are silent."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Division
from cadcam.errors import BadValue, MissingCore
from cadcam.geometry.rigid import Rigid
from cadcam.native import core, fields, grouped, marks, profiles
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Scene

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SOURCES = Path(core.__file__).parent
FUZZ = ("fuzz.c", "fuzz_lines.c")
FUZZ_CORRELATE = ("fuzz_correlate.c",)
SANITIZERS = ("-fsanitize=address,undefined,float-cast-overflow",)
Build = Callable[[str], list[str]]
BEST = "baseline" if core.choose_variant(-1) == "baseline" else "avx2"  # of this processor; the other one is slow's


def test_instruction_sets_give_the_same_bits() -> None:
    best = core.choose_variant(-1)
    if best == "baseline":
        pytest.skip("this processor has the baseline only")
    renderer = RasterRenderer(Scene.of(machined_bracket()))
    pose = Rigid.look_at([400, 300, 350], [60, 40, 30])
    cameras = [
        Camera.from_focal((203, 151), 220.0, skew=3.0),
        Camera.from_focal((203, 151), 150.0, lens=Division(-0.2)),
    ]
    try:
        for camera in cameras:
            core.choose_variant(-1)
            fast = renderer.render(camera, pose)
            assert core.choose_variant(0) == "baseline"
            slow = renderer.render(camera, pose)
            for name in fast.layers:
                assert np.array_equal(fast.layers[name], slow.layers[name]), name
    finally:
        core.choose_variant(-1)


@pytest.mark.parametrize(
    ("vertices", "faces", "paint", "words"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], [0], "vertex 2 is .*nan.*expected finite"),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]], [0], "vertex 2 is .*inf.*expected finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], [0], "face's vertex is from 0 to 3"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], [1], "face's colour is from 1 to 1"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], [0, 0], "faces is of shape"),
    ],
)
def test_bad_scenes_stop_before_the_core(vertices: list, faces: list, paint: list, words: str) -> None:
    with pytest.raises(BadValue, match=words):
        core.NativeScene(
            np.array(vertices), np.array(faces), np.array([0]), np.array(paint), np.ones((1, 3), np.float32)
        )


def test_directions_too_close_for_a_number_share_a_cell() -> None:
    assert core.NativeLens(np.array([[[0.0, 0.0], [1e-310, 0.0]]])).size == (2, 1)


def test_a_missing_core_says_why_and_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    core.library.cache_clear()
    broken = tmp_path / "broken.so"
    broken.write_bytes(b"not a library")
    try:
        for path, words in ((tmp_path / "none.so", "not built"), (broken, "cannot be loaded")):
            monkeypatch.setattr(core, "LIBRARY", path)
            with pytest.raises(MissingCore, match=f"{words}.*renderer 'ray'"):
                core.library()
        with pytest.raises(MissingCore, match=r"the fit to edges is not available: .*; reinstall"):
            core.functions("the fit to edges", {})
    finally:
        core.library.cache_clear()


def test_numbers_that_python_and_the_core_both_state_are_the_same() -> None:
    """Memory is laid out by Python's: one that is too small would be written beyond."""
    text = "".join(header.read_text() for header in SOURCES.glob("*.h"))
    stated = {name: int(value) for name, value in re.findall(r"\b(CC_[A-Z_]+)(?: =)? (\d+)\b", text)}
    ours = {
        "CC_STEP_SUMS": profiles.STEP_SUMS,
        "CC_STEP_ALL": profiles.STEP_ALL,
        "CC_STEP_TERMS": profiles.STEP_TERMS,
        "CC_BAND_BINS": profiles.BAND_BINS,
        "CC_BAND_KNOWN": profiles.BAND_KNOWN,
        "CC_LENS": profiles.LENS,
        "CC_MOST_STEPS": profiles.MOST_STEPS,
        "CC_SECTORS": fields.SECTORS,
        "CC_MARGIN": fields.MARGIN,
        "CC_SPARE": fields.SPARE,
        "CC_SWEPT": fields.SWEPT,
        "CC_UNKNOWNS": grouped.UNKNOWNS,
        "CC_MARK_RADII": marks._MOST_RADII,
        "CC_MARK_TERMS": marks._MOST_TERMS,
    }
    assert {name: stated[name] for name in ours} == ours


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Return a function that builds the core with AddressSanitizer and UBSan, once for each set of vectors."""

    @cache
    def build(vectors: str) -> list[str]:
        if vectors == "avx2" and core.choose_variant(-1) == "baseline":
            pytest.skip("this processor has the baseline only")
        return objects(sorted(SOURCES.glob("*.c")), tmp_path_factory.mktemp(vectors), vectors)

    return build


def objects(files: list[Path], folder: Path, vectors: str) -> list[str]:
    """Compile C files with sanitizers, on all cores; return the objects.

    Unoptimised: it takes a third of the time, and no check is optimised away.
    """
    flags = ["-std=c11", "-g", "-O0", "-ffp-contract=off", *SANITIZERS]
    flags += ["-fno-sanitize-recover=all", "-DCC_VARIANT=_baseline", "-DCC_BASELINE_ONLY", f"-I{SOURCES}"]
    flags += ["-mavx2", "-mfma"] if vectors == "avx2" else []

    def compiled(file: Path) -> str:
        out = str(folder / f"{file.stem}.o")
        run_compiler(*flags, "-c", str(file), "-o", out)
        return out

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compiled, files))


def run_compiler(*words: str) -> None:
    compiler = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), None)
    if compiler is None:
        pytest.skip("no C compiler")
    made = subprocess.run([compiler, *words], capture_output=True, text=True, check=False)
    if made.returncode and "sanitize" in made.stderr:
        pytest.skip("the compiler has no sanitizers")
    assert made.returncode == 0, made.stderr


def fuzz(tmp_path: Path, scenes: int, core_objects: list[str], vectors: str, harness: tuple[str, ...] = FUZZ) -> None:
    """Give the core, built with sanitizers, random and vicious tasks."""
    program = tmp_path / "fuzz"
    own = objects([Path(__file__).with_name(name) for name in (*harness, "fuzz_chance.c")], tmp_path, vectors)
    run_compiler(*SANITIZERS, *core_objects, *own, "-lm", "-o", str(program))
    done = subprocess.run([str(program), str(scenes)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stdout.startswith(f"{scenes} scenes")


LOADED_AGAIN = """
import numpy as np
from cadcam.native import core
from cadcam.native.rays import NativeRays

def cast():
    rays = NativeRays(1e6 * np.eye(3), np.arange(3, dtype=np.int32)[None])
    return rays.first_hit(np.zeros((1, 3)), np.full((1, 3), 3**-0.5), np.array([np.inf]))

first = cast()
core.library.cache_clear()
for _ in range(100):
    assert cast() == first == [0]
print("freed")
"""


def test_what_a_library_made_is_freed_by_it_though_the_core_was_loaded_again() -> None:
    """The other's function is not told that it takes a pointer, and cuts it to 32 bits."""
    done = subprocess.run([sys.executable, "-c", LOADED_AGAIN], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "freed\n", done.stderr


def test_sanitizers_are_silent_over_a_few_vicious_scenes(tmp_path: Path, built: Build) -> None:
    fuzz(tmp_path, 200, built(BEST), BEST)


def test_sanitizers_are_silent_over_vicious_templates(tmp_path: Path, built: Build) -> None:
    fuzz(tmp_path, 300, built(BEST), BEST, FUZZ_CORRELATE)


@pytest.mark.slow
@pytest.mark.parametrize("vectors", ["avx2", "baseline"])
def test_sanitizers_are_silent_over_ten_thousand_vicious_scenes(tmp_path: Path, built: Build, vectors: str) -> None:
    fuzz(tmp_path, 10_000, built(vectors), vectors)
    fuzz(tmp_path, 300, built(vectors), vectors, FUZZ_CORRELATE)


def test_a_huge_value_is_in_the_means_of_its_neighbours_and_of_no_others() -> None:
    """Sums are carried along a line: what a far larger term hid in them comes back when it leaves."""
    values = np.array([[0.1], [0.3], [1e17], [np.nan], [0.2], [0.4], [0.6], [0.5]])
    run = np.array([0, 0, 0, 0, 0, 0, 0, 1], np.int32)
    mean = profiles.along_runs(values, run, 1)[:, 0]
    assert np.allclose(mean[[1, 2, 3]], [1e17 / 3, 1e17 / 2, 1e17 / 2], rtol=1e-15)
    assert np.allclose(mean[[0, 4, 5, 6, 7]], [0.2, 0.3, 0.4, 0.5, 0.5], rtol=4e-16)
