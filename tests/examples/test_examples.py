"""Every example runs as its docstring says, in an empty folder, and says what it promises."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"

# script -> arguments, files it leaves, what it says
RUNS: dict[str, tuple[list[str], list[str], str]] = {
    "calibrate_from_board.py": ([], [], "next: hold the board"),
    "calibrate_from_points.py": ([], ["camera.json"], "focal"),
    "decompose_matrix.py": ([], [], "-3 P has the same parameters"),
    "find_targets.py": ([], [], "through the camera: 6 marks"),
    "hand_eye.py": ([], [], "off the truth by"),
    "overlay_on_photo.py": ([], ["overlay.png"], "median distance"),
    "make_dataset.py": ([], ["bracket_set/contact.png"], "key points reproject to 0.0000 px"),
    "photograph_a_part.py": (["shots", "2"], ["shots/photo_phone.jpg"], "sharp within 2 px"),
    "part_in_robot_base.py": ([], [], "go to X 700.0"),
    "pose_of_a_flat_target.py": ([], [], "Two poses explain these points"),
    "measure_with_a_moved_camera.py": ([], ["measured.csv"], "motion to away"),
    "render_bench.py": ([], ["bench.png", "depth.npy"], "15 of 16 targets are in view"),
    "measure_with_a_gantry.py": ([], [], "the map is off the truth by"),
    "plan_a_layout.py": (
        [],
        ["scenes/four_fixed.yaml", "scenes/six_stations.yaml", "scenes/uncertainty.jpg"],
        "one camera at 6 places",
    ),
    "inspect_a_line.py": (["line"], ["line/inspected/index.html", "line/rib.svg"], "S008          FAIL"),
    "judge_by_the_drawing.py": (
        ["drawn", "4"],
        ["drawn/tolerances.yaml", "drawn/report.html", "drawn/verify.svg"],
        "12.4 mm measured, 12 to 12.2 mm allowed; beyond the limit",
    ),
    "verify_a_part.py": (["judged", "4"], ["judged/report.html", "judged/verify.svg"], "FAIL"),
    "sample_parts.py": (["models"], ["models/bench.glb", "models/bracket.stl"], "shipblock_10k.obj"),
}
# script -> the public data that it is run on (skipped where they are not here), and what it says
ON_DATA = {"locate_on_photos.py": ("data/visp_teabox", "both photos: at (-5")}
ELSEWHERE = {"gallery.py": "tests/cli/test_demo.py"}  # it needs a demo's folder, which that test has


@pytest.mark.parametrize("script", sorted(RUNS))
def test_the_example_runs_in_an_empty_folder(tmp_path: Path, script: str) -> None:
    arguments, files, says = RUNS[script]
    ran = subprocess.run(
        [sys.executable, "-W", "error", EXAMPLES / script, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert says in ran.stdout
    for name in files:
        assert (tmp_path / name).stat().st_size > 0


@pytest.mark.parametrize("script", sorted(ON_DATA))
def test_the_example_runs_on_public_data(shared: Callable[[str], Path], tmp_path: Path, script: str) -> None:
    folder, says = ON_DATA[script]
    command = [sys.executable, "-W", "error", EXAMPLES / script, shared(folder), "out.png"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert says in ran.stdout
    assert (tmp_path / "out.png").stat().st_size > 0


def test_every_example_is_run() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(RUNS) | set(ON_DATA) | set(ELSEWHERE)
    for script, test in ELSEWHERE.items():
        assert f'"{script}"' in (ROOT / test).read_text()


def test_the_gallery_stays_small() -> None:
    assert sum(path.stat().st_size for path in (ROOT / "renders").iterdir()) < 1_000_000
