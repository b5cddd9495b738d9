"""`cadcam demo`: its files are those it lists, its numbers are the dissertation's, its commands can be run again.

The Python of README, python.md and inspect.md runs as printed on these files.
"""

from __future__ import annotations

import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.camera.estimate import CameraEstimate
from cadcam.cli.demo.as_built import (
    CLOSE_CAMERA,
    CLOSE_POSE,
    DISPLACED,
    FORGOTTEN,
    MARKS_POSE,
    position_in_part,
    true_position,
)
from cadcam.cli.demo.inputs import BENCH_UV, PRINTED, TRUE_CAMERA, TRUE_POSE
from cadcam.cli.main import main
from cadcam.cli.verbs import demo as verb
from cadcam.files.camera import read_camera
from cadcam.files.jsontext import parsed
from cadcam.files.pose_estimate import pose_estimate_at
from cadcam.files.text import read_text
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture

from .job import Ran

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/python.md", "docs/inspect.md")
SNIPPETS = {page: re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL) for page in PAGES}
WITHIN = 4.0  # sigmas, beyond which a figure shown is not one of its covariance: one in 16 000


@dataclass(frozen=True)
class Once:
    """One demo with --json: its folder, what it printed, and what each of its commands told it."""

    folder: Path
    out: str
    err: str
    told: tuple[dict[str, Any], ...]


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return one run, which all tests share."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    told: list[dict[str, Any]] = []
    run = verb._run

    def noted(command: list[str], *, quiet: bool) -> dict[str, Any]:
        told.append(run(command, quiet=quiet))
        return told[-1]

    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(verb, "_run", noted)
        assert main(["demo", str(folder), "--json"]) == 0
    return Once(folder, out.getvalue(), err.getvalue(), tuple(told))


@pytest.fixture(scope="module")
def demo(once: Once) -> Path:
    """Return the folder that one demo has filled."""
    return once.folder


@pytest.fixture(scope="module")
def reader_s(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a reader's copy of it, for what the snippets write, one for the next."""
    return Path(shutil.copytree(demo, tmp_path_factory.mktemp("readme") / "demo"))


def tables_of(folder: Path) -> str:
    """Return the tables of a demo without --json."""
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verb, "print_tables", lambda tables: said.extend(line for t in tables for line in t.lines()))
        assert main(["demo", str(folder)]) == 0
    return "\n".join(said)


@pytest.fixture(scope="module")
def said(once: Once) -> str:
    """Return the tables of the demo: of what its commands told, which are not run again."""
    told = iter(once.told)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verb, "_write_inputs", lambda folder: None)
        patch.setattr(verb, "_run", lambda command, *, quiet: next(told))
        tables = tables_of(once.folder)
    assert next(told, None) is None
    return tables


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


def test_the_close_camera_is_the_one_that_saw_the_marks(demo: Path) -> None:
    estimate = read_camera(demo / "close_camera.json").estimate
    assert estimate is not None
    truth = CameraEstimate(CLOSE_CAMERA, MARKS_POSE, estimate.observations, (), np.zeros_like(estimate.cofactor))
    free = [estimate.parameters.index(name) for name in estimate.free]
    error, C = (estimate.values - truth.values)[free], estimate.covariance[np.ix_(free, free)]
    assert error @ np.linalg.solve(C, error) < 4 * len(free)


def test_the_block_is_found_where_it_was_photographed(demo: Path) -> None:
    pose = pose_estimate_at(parsed(read_text(demo / "pose.json")))
    error = (pose.world_from_part.inv @ CLOSE_POSE).log()
    assert np.abs(error / np.sqrt(np.diag(pose.covariance))).max() < WITHIN
    p, sigma = position_in_part(pose.world_from_part, pose.covariance)
    assert np.abs((p - CLOSE_POSE.origin) / sigma).max() < WITHIN


def test_where_the_camera_stands_is_as_uncertain_as_poses_drawn_from_the_covariance_say(
    rng: np.random.Generator,
) -> None:
    root = rng.normal(scale=1e-3, size=(6, 6)) * np.array([300.0] * 3 + [1.0] * 3)[:, None]
    _, sigma = position_in_part(CLOSE_POSE, root @ root.T)
    drawn = [(CLOSE_POSE @ Rigid.exp(root @ rng.normal(size=6))).inv.translation for _ in range(4000)]
    np.testing.assert_allclose(np.std(drawn, axis=0), sigma, rtol=4 / np.sqrt(2 * 4000) + 0.01)


def test_the_displaced_and_the_forgotten_part_fail_and_nothing_else_is_blamed(demo: Path) -> None:
    report = json.loads((demo / "report.json").read_text())
    assert report["verdict"] == "FAIL"
    judged = {j["feature"]: j for j in report["judgements"]}
    for name in ("bracket", "outer longitudinal"):
        j = judged[name]
        assert abs(j["deviation_mm"] - true_position(name)) < WITHIN * j["expanded_uncertainty_mm"] / j["k"]
    assert [judged[n]["verdict"] for n in ("bracket", "outer longitudinal", "inner longitudinal")] == [
        "FAIL",
        "PASS",
        "FAIL",
    ]
    states = {f["name"]: f["state"] for f in report["features"]}
    assert (states.pop("bracket"), states.pop("inner longitudinal")) == ("displaced", "missing")
    assert set(states.values()) <= {"in place", "unclear", "out of view", "datum"}
    assert all("why" in f for f in report["features"] if f["state"] == "unclear")


def test_the_readme_says_what_the_demo_finds(demo: Path) -> None:
    judged = json.loads((demo / "report.json").read_text())["judgements"][0]
    found = f"bracket {judged['deviation_mm']:.1f} ± {judged['expanded_uncertainty_mm']:.1f} mm off"
    assert found in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_verdict_is_shown_beside_the_truth(said: str) -> None:
    table = said.partition("3. The block")[2]
    line = next(row for row in table.splitlines() if row.strip().startswith("bracket, along y"))
    assert "6.00" in line
    assert "FAIL" in line
    assert "inner longitudinal is missing" in table


def test_the_report_shows_the_photo_and_needs_nothing_else(demo: Path) -> None:
    page = (demo / "report.html").read_text()
    assert "data:image/jpeg;base64," in page
    assert "http" not in page
    assert "inner longitudinal: missing" in page


def test_json_holds_all_that_was_found_and_what_is_true(once: Once) -> None:
    document = json.loads(once.out)
    assert once.err == ""
    assert document["verified"]["verdict"] == "FAIL"
    assert document["verified_truth"] == {"displaced": {DISPLACED: [0.0, 6.0, 0.0]}, "missing": [FORGOTTEN]}
    assert document["located"]["found"] is True
    assert {Path(file).name for file in document["files"]} == {path.name for path in once.folder.iterdir()}
    assert [shlex.split(command)[1] for command in document["commands"]][-3:] == ["calibrate", "locate", "verify"]


@pytest.mark.slow
def test_files_and_tables_are_the_same_again(demo: Path, said: str, tmp_path: Path) -> None:
    again = tmp_path / "again"
    tables = tables_of(again).partition("\nFiles\n")[0]  # whose columns are as wide as the folder's name
    assert tables.replace(str(again), str(demo)) == said.partition("\nFiles\n")[0]
    assert {path.name for path in again.iterdir()} == {path.name for path in demo.iterdir()}
    pictures = [path.name for path in demo.iterdir() if path.suffix in (".png", ".svg")]
    assert len(pictures) >= 8
    for name in pictures:
        made = (again / name).read_bytes().replace(str(again).encode(), str(demo).encode())  # a title names its photo
        assert made == (demo / name).read_bytes()
    first, second = (json.loads((folder / "report.json").read_text()) for folder in (demo, again))
    assert first["judgements"] == second["judgements"]


def test_there_is_a_snippet_for_each_job() -> None:
    assert {page: len(snippets) for page, snippets in SNIPPETS.items()} == dict(zip(PAGES, (5, 4, 1), strict=True))


@pytest.mark.parametrize(
    "snippet",
    [pytest.param(text, id=f"{page}:{k}") for page, texts in SNIPPETS.items() for k, text in enumerate(texts)],
)
def test_a_snippet_runs_as_printed(snippet: str, reader_s: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", snippet], cwd=reader_s, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


def test_the_gallery_is_made_from_it(demo: Path, tmp_path: Path) -> None:
    script = ROOT / "examples" / "gallery.py"
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
    assert "is a file; name a folder" in ran.err


def test_a_folder_that_may_not_be_written_to_is_exit_2_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("cadcam.cli.verbs.demo.os.access", lambda *_: False)  # whoever runs the tests may be root
    code = main(["demo", str(tmp_path)])
    ran = Ran(code, *capsys.readouterr())
    assert ran.code == 2
    assert "read-only" in ran.err
    assert not list(tmp_path.iterdir())
