"""Tables say values with their sigmas, name what is doubtful, and stay readable without a terminal."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.geometry.rigid import Rigid
from cadcam.report.camera import (
    estimate_tables,
    opengl_as_json,
    opengl_tables,
    parameter_table,
    residual_table,
    strong_correlations,
)
from cadcam.report.table import Table, plain, show, with_sigma


@pytest.fixture
def estimate(rng: np.random.Generator) -> CameraEstimate:
    """Return a made-up estimate of nine points, six of its parameters free."""
    camera = Camera.from_focal((768, 576), 800, skew=1.0, lens=BrownConrady(k1=-0.1))
    pose = Rigid.look_at([300, 200, -900], [0, 0, 0])
    p = rng.uniform(-50, 50, (9, 3))
    q = camera.project(pose @ p) + rng.normal(scale=0.3, size=(9, 2))
    A = rng.normal(size=(23, 23))
    return CameraEstimate(camera, pose, Observations(p, q), NAMES[:6], A @ A.T, "made up")


class Terminal(io.StringIO):
    """A text file that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def shown(*tables: Table, file: io.StringIO) -> str:
    show(tables, file)
    return file.getvalue()


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (805.9312, 5.4321, ("805.9", "5.4")),
        (43122.4, 251.0, ("43122", "251")),
        (1.00731, 0.0020, ("1.0073", "0.0020")),
        (-0.01234, 0.00011, ("-0.01234", "0.00011")),
        (7.5, 0.0, ("7.5", "")),
        (7.0, np.inf, ("7.00000", "unknown")),
    ],
)
def test_a_value_is_shown_to_two_digits_of_its_sigma(value: float, sigma: float, expected: tuple[str, str]) -> None:
    assert with_sigma(value, sigma) == expected


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (123456.789, "123457"), (1e-9, "1.00000e-09"), (0.25, "0.250000"), (np.inf, "inf")]
)
def test_a_number_keeps_six_digits(value: float, text: str) -> None:
    assert plain(value) == text


def test_fixed_parameters_carry_no_sigma_and_angles_are_in_degrees(estimate: CameraEstimate) -> None:
    rows = {row[0]: row for row in parameter_table(estimate).rows}
    assert rows["focal"][1:4] == ("800", "fixed", "px")
    a, sigma = np.degrees(estimate.value("a")), np.degrees(estimate.sigma("a"))
    assert rows["a"][1:4] == (with_sigma(a, sigma)[0], f"+- {with_sigma(a, sigma)[1]}", "deg")
    assert rows["k1"][1] == "-0.1"


def test_the_worst_point_is_marked(estimate: CameraEstimate) -> None:
    worst, distance = estimate.worst()
    marked = [row for row in residual_table(estimate).rows if row[-1]]
    assert [(row[0], row[-2], row[-1]) for row in marked] == [(worst, f"{distance:.2f}", "worst")]


def test_unknown_noise_is_said_not_invented(estimate: CameraEstimate) -> None:
    few = replace(estimate, observations=Observations(estimate.observations.p_world[:3], estimate.observations.q[:3]))
    assert few.dof == 0
    table = parameter_table(few)
    assert any("sigmas unknown" in note for note in table.notes)
    assert {row[2] for row in table.rows[:6]} == {"+- unknown"}


def test_stated_noise_is_named_beside_what_the_residuals_say(estimate: CameraEstimate) -> None:
    stated = replace(estimate, observations=replace(estimate.observations, sigma_px=0.3))
    assert any("stated noise of 0.3 px" in n and "the residuals say" in n for n in parameter_table(stated).notes)


def test_few_degrees_of_freedom_are_said_to_know_little_of_the_noise(estimate: CameraEstimate) -> None:
    """Checked by drawing: of residuals with 2 degrees of freedom 5 % tell less than 1/4.42 of the noise."""
    observed = estimate.observations
    few = replace(estimate, observations=Observations(observed.p_world[:4], observed.q[:4]))
    assert few.dof == 2
    (warning,) = [note for note in parameter_table(few).notes if note.startswith("warning")]
    assert "2 degrees of freedom" in warning
    assert "4.4 times" in warning
    drawn = np.sqrt(np.sum(np.random.default_rng(3).normal(size=(100_000, 2)) ** 2, axis=1) / 2)
    assert np.mean(1 / drawn > 4.4) == pytest.approx(0.05, abs=0.003)  # 4 sigma of the share
    stated = replace(few, observations=replace(few.observations, sigma_px=0.3))
    assert not any(note.startswith("warning") for table in (stated, estimate) for note in parameter_table(table).notes)


def test_the_size_of_the_points_is_said_and_doubted_where_it_cannot_be_mm(estimate: CameraEstimate) -> None:
    observed = estimate.observations
    size = " x ".join(f"{v:.4g}" for v in np.ptp(observed.p_world, axis=0))
    assert f"the points span {size} mm in X, Y, Z" in parameter_table(estimate).notes
    tiny = replace(estimate, observations=replace(observed, p_world=observed.p_world / 1000))
    assert any("is their unit right" in note for note in parameter_table(tiny).notes)


def test_pixels_outside_the_picture_are_counted(estimate: CameraEstimate) -> None:
    q = np.array(estimate.observations.q)
    q[:2] = [[768.0, 5.0], [5.0, -0.6]]
    strayed = replace(estimate, observations=replace(estimate.observations, q=q))
    assert any("2 of 9 pixels lie outside the picture of 768 x 576 px" in n for n in parameter_table(strayed).notes)


def test_only_strong_correlations_are_named_strongest_first(estimate: CameraEstimate) -> None:
    C = estimate.correlation
    strong = strong_correlations(estimate, beyond=0.2)
    expected = {frozenset((i, j)): C[i, j] for i in range(6) for j in range(i) if abs(C[i, j]) > 0.2}
    assert {frozenset(map(estimate.free.index, pair[:2])): pair[2] for pair in strong} == pytest.approx(expected)
    sizes = [abs(value) for _, _, value in strong]
    assert sizes == sorted(sizes, reverse=True)
    assert len(strong) > 0


def test_plain_text_is_aligned_and_has_no_escape_codes(estimate: CameraEstimate) -> None:
    text = shown(*estimate_tables(estimate), file=io.StringIO())
    assert "\x1b" not in text
    assert text.isascii()
    rows = [line for line in text.splitlines() if line.startswith("  ") and " mm " in line + " "]
    assert len({line.index(" mm") for line in rows[:3]}) == 1


def test_a_terminal_gets_the_same_cells(estimate: CameraEstimate) -> None:
    text = shown(*estimate_tables(estimate), file=Terminal())
    for row in residual_table(estimate).rows:
        assert all(cell in text for cell in row)


def test_markup_in_names_is_printed_as_it_is() -> None:
    table = Table("[bold]t", ("a",), (("[red]x[/red]",),))
    assert "[red]x[/red]" in shown(table, file=Terminal())


def test_what_opengl_cannot_carry_is_said(estimate: CameraEstimate) -> None:
    notes = opengl_tables(estimate.camera, estimate.camera_from_world, near=1, far=10)[0].notes
    assert any("skew" in note for note in notes)
    assert any("lens" in note for note in notes)
    plain_camera = Camera.from_focal((768, 576), 800)
    assert not opengl_tables(plain_camera, estimate.camera_from_world, near=1, far=10)[0].notes


def test_opengl_as_json_names_its_units(estimate: CameraEstimate) -> None:
    document = opengl_as_json(estimate.camera, estimate.camera_from_world, near=1, far=10)
    assert set(document) == {"glFrustum_mm", "gluLookAt", "glViewport_px", "clip_from_eye", "eye_from_world"}
    assert document["glFrustum_mm"]["near"] == 1


def test_both_poses_of_a_flat_target_stand_side_by_side(estimate: CameraEstimate) -> None:
    other = replace(estimate, camera_from_world=estimate.camera_from_world @ Rigid.exp(np.full(6, 0.01)))
    table = estimate_tables(replace(estimate, alternative=other))[-1]
    assert table.rows[-1][1:3] == (f"{estimate.thesis_residual:.3g}", f"{other.thesis_residual:.3g}")


def test_what_steers_a_terminal_is_spelled_out() -> None:
    """Names may hold line ends, colours and changes of direction: each row stays one line; letters stay letters."""
    table = Table("a\nb", ("name",), (("x\ny",), ("\x1b[31mred",), ("\u202eabc",), ("\u05d1\u05b8 \u6f22",)), ("name",))
    lines = table.lines()
    assert [line.strip() for line in lines if "-" not in line] == [
        r"a\nb", "name", r"x\ny", r"\x1b[31mred", r"\u202eabc", "\u05d1\u05b8 \u6f22"
    ]  # fmt: skip


def test_on_a_narrow_terminal_sentences_follow_their_rows_and_no_word_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    why = "most of U is edges' own errors: go closer, or take another view"
    rows = (
        ("hole 8 mm", "diameter", "-0.004 mm", "0.013", "UNDECIDED", why),
        ("front", "position", "0", "0", "PASS", ""),
    )
    table = Table("t", ("feature", "what", "deviation", "U", "verdict", "why"), rows, ("feature", "what", "why"))
    lines = re.sub(r"\x1b\[[0-9;]*m", "", shown(table, file=Terminal())).splitlines()
    assert all(len(line.rstrip()) <= 60 for line in lines)
    assert lines[3].split() == ["hole", "8", "mm", "diameter", "-0.004", "mm", "0.013", "UNDECIDED"]
    assert " ".join(" ".join(lines[4:6]).split()) == why
    assert lines[6].split() == ["front", "position", "0", "0", "PASS"]
    monkeypatch.setenv("COLUMNS", "200")
    assert f"UNDECIDED   {why}" in re.sub(r"\x1b\[[0-9;]*m", "", shown(table, file=Terminal()))
