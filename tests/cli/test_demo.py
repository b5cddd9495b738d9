"""`cadcam demo`: its files are those it lists, its numbers are the dissertation's, its commands can be run again."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.estimate import CameraEstimate
from cadcam.cli.demo_inputs import BENCH_UV, PRINTED, TRUE_CAMERA, TRUE_POSE
from cadcam.cli.main import main
from cadcam.files.camera import read_camera
from cadcam.image.picture import read_picture

from .job import Ran


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that one demo has filled."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    with pytest.MonkeyPatch.context() as patch:
        said: list[str] = []
        patch.setattr("cadcam.cli.demo.print_tables", lambda tables: said.extend(x for t in tables for x in t.lines()))
        assert main(["demo", str(folder)]) == 0
    (folder.parent / "said.txt").write_text("\n".join(said))
    return folder


@pytest.fixture
def said(demo: Path) -> str:
    """Return the tables of the demo."""
    return (demo.parent / "said.txt").read_text()


def test_every_file_listed_is_there_and_no_other(demo: Path, said: str) -> None:
    listed = {Path(line.split()[0]).name for line in said.splitlines() if line.strip().startswith(str(demo))}
    assert listed == {p.name for p in demo.iterdir()}
    assert len(listed) >= 10


def test_the_pictures_are_not_blank(demo: Path) -> None:
    for path in demo.glob("*.png"):
        assert read_picture(path).std() > 0.05


def test_the_direct_linear_transform_gives_the_printed_values(said: str) -> None:
    rows = {line.split()[0]: line.split() for line in said.partition("2. The camera")[0].splitlines() if line.strip()}
    for name, printed in PRINTED.items():
        linear, shown = rows[name][2:4] if name == "residual" else rows[name][4:6]
        assert shown == printed
        assert f"{float(linear):.{len(printed.partition('.')[2])}f}" == printed


def test_the_true_camera_is_found_within_its_covariance(demo: Path) -> None:
    estimate = read_camera(demo / "camera.json").estimate
    assert estimate is not None
    truth = CameraEstimate(TRUE_CAMERA, TRUE_POSE, estimate.observations, (), np.zeros_like(estimate.cofactor))
    free = [estimate.parameters.index(name) for name in estimate.free]
    error = (estimate.values - truth.values)[free]
    C = estimate.covariance[np.ix_(free, free)]
    distance = error @ np.linalg.solve(C, error)
    assert distance < 4 * len(free)  # expected: about 12 of 12 + 12/36 of them; four times as much is beyond 99.99 %


def test_its_commands_give_the_same_files_again(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cadcam.cli.demo import _commands

    for command in _commands(demo)[1:3]:
        output = Path(command[command.index("-o") + 1])
        before = output.read_bytes()
        output.unlink()
        assert main(shlex.split(shlex.join(command))[1:]) == 0
        assert output.read_bytes() == before
    capsys.readouterr()


def test_the_gallery_is_made_from_it(demo: Path, tmp_path: Path) -> None:
    script = Path(__file__).resolve().parents[2] / "examples" / "gallery.py"
    command = [sys.executable, "-W", "error", script, demo, tmp_path]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    made = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert {line.partition(":")[0] for line in ran.stdout.splitlines()} == made
    assert (tmp_path / "examples/data/block_points.csv").read_bytes() == (demo / "points.csv").read_bytes()


def test_the_table_shipped_is_the_dissertations(shared: object) -> None:
    from cadcam.cad.parts import BENCH_POINTS
    from cadcam.files.points import read_points

    table = read_points(shared("thesis/tables/table_2_3.csv"))
    np.testing.assert_array_equal(table.UV, BENCH_UV)
    np.testing.assert_array_equal(table.p_world, BENCH_POINTS)


def test_a_folder_that_cannot_be_made_is_exit_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    code = main(["demo", str(tmp_path / "file" / "folder")])
    ran = Ran(code, *capsys.readouterr())
    assert ran.code == 2
    assert "name another folder" in ran.err
