"""`cadcam variability`: tables, one JSON document, figures; what cannot be done is refused before the work."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.calibrate.variability.methods import first_order_variability, monte_carlo_variability
from cadcam.camera.observations import Observations
from cadcam.files.points import read_points, write_points
from cadcam.image.picture import read_picture_with_info

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]
QUICK = ("--draws", "200", "--steps", "12000")


@pytest.fixture
def points(tmp_path: Path) -> Path:
    """Return the file of thirty points in space, enough for all eleven parameters."""
    rng = np.random.default_rng(3)
    p = rng.uniform(0, 1, (30, 3)) * [120, 90, 70]
    q = CAMERA.project(POSE @ p) + rng.normal(scale=0.1, size=(30, 2))
    write_points(tmp_path / "thirty.csv", Observations(p, q))
    return tmp_path / "thirty.csv"


def test_the_json_is_the_librarys_answer_in_degrees(cadcam: Cadcam, points: Path) -> None:
    ran = cadcam("variability", points, "--size", "320x240", *QUICK, "--seed", "7", "--json")
    assert ran.code == 0, ran.err
    estimate = calibrate_camera(read_points(points), SIZE)
    expected = monte_carlo_variability(estimate, rng=np.random.default_rng([7, 0]), draws=200)
    stated = ran.json["monte_carlo"]
    assert stated["parameters"]["focal"]["sigma"] == pytest.approx(expected.sigma[7], rel=1e-12)
    assert stated["parameters"]["a_deg"]["sigma"] == pytest.approx(np.degrees(expected.sigma[3]), rel=1e-12)
    assert stated["sigma_px"] == pytest.approx(estimate.noise_px)
    first = ran.json["first_order"]["parameters"]
    assert first["U0"]["sigma"] == pytest.approx(first_order_variability(estimate).sigma[9], rel=1e-12)
    chain = ran.json["markov_chain"]
    assert chain["chains"] == 4
    assert 1.0 <= chain["parameters"]["focal"]["r_hat"] < 1.1
    assert np.shape(ran.json["projection"]["sigma_px"]) == (49, 65)


def test_equal_seeds_print_the_same_and_other_seeds_do_not(cadcam: Cadcam, points: Path) -> None:
    def out(seed: int) -> str:
        return cadcam("variability", points, "--size", "320x240", *QUICK[:2], "--steps", "0", "--seed", seed).out

    assert out(1) == out(1)
    assert out(1) != out(2)


def test_the_tables_have_both_methods_and_the_map(cadcam: Cadcam, points: Path) -> None:
    ran = cadcam("variability", points, "--size", "320x240", *QUICK, "--alternate", "20,2")
    for title in ("Monte Carlo (Method A)", "Markov chain (Method B)", "Correlations, Markov chain",
                  "Alternating externals", "Where a known point is seen"):  # fmt: skip
        assert title in ran.out
    assert "effective sample size" in ran.out
    assert ran.err == ""


def test_without_draws_and_steps_first_order_is_left(cadcam: Cadcam, points: Path) -> None:
    ran = cadcam("variability", points, "--size", "320x240", "--draws", "0", "--steps", "0", "--fix", "skew=0")
    assert "First order" in ran.out
    assert "Method" not in ran.out
    assert "skew" not in ran.out


def test_noise_of_the_world_leaves_method_b_out(cadcam: Cadcam, points: Path) -> None:
    ran = cadcam("variability", points, "--size", "320x240", "--draws", "200", "--points-sigma", "0.1")
    assert "0.1 mm a world coordinate" in ran.out
    assert "Method B" not in ran.out


def test_a_known_camera_varies_in_its_pose(cadcam: Cadcam, job: Path) -> None:
    ran = cadcam(
        "variability", job / "points.csv", "--internals", job / "camera.json", *QUICK[:2], "--steps", "0", "--json"
    )
    assert list(ran.json["monte_carlo"]["parameters"]) == ["X", "Y", "Z", "a_deg", "b_deg", "c_deg"]


def test_the_figures_are_written_and_named(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    folder = tmp_path / "figures"
    ran = cadcam("variability", points, "--size", "320x240", *QUICK, "--plots", folder)
    assert ran.code == 0, ran.err
    written = sorted(path.name for path in folder.iterdir())
    stems = (
        "correlations",
        "distributions_externals",
        "distributions_internals",
        "distributions_together",
        "projection",
    )
    assert written == [f"{stem}.png" for stem in stems]
    assert all(f"wrote {folder / name}" in ran.err for name in written)
    for name in written:
        picture, info = read_picture_with_info(folder / name)
        assert min(info.size) > 300
        assert np.ptp(picture) > 0.5


@pytest.mark.usefixtures("unread")
def test_the_figures_are_kept_even_if_nobody_reads_the_tables(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    none = ("--draws", "0", "--steps", "0")
    assert cadcam("variability", points, "--size", "320x240", *none, "--plots", tmp_path / "figures").code != 0
    assert len(list((tmp_path / "figures").iterdir())) == 2


def test_first_order_alone_has_two_figures_of_any_kind(cadcam: Cadcam, points: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    words = ("--draws", "0", "--steps", "0", "--plots", tmp_path / "figures", "--format", "svg")
    assert cadcam("variability", points, "--size", "320x240", *words).code == 0
    assert sorted(p.name for p in (tmp_path / "figures").iterdir()) == ["correlations.svg", "projection.svg"]
    assert "<svg" in (tmp_path / "figures" / "projection.svg").read_text()


def test_without_matplotlib_the_extra_is_named_before_the_work(
    cadcam: Cadcam, points: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ran = cadcam("variability", points, "--size", "320x240", *QUICK, "--plots", tmp_path / "figures")
    assert ran.code == 2
    assert "cadcam[plots]" in ran.err
    assert ran.out == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--draws", "5"), "100 to 10000000, or 0"),
        (("--steps", "10"), "10000 to 10000000, or 0"),
        (("--points-sigma", "0.1", "--steps", "20000"), "B has noise of pixels only"),
        (("--unseen",), "--alternate"),
        (("--alternate", "30"), "2 numbers"),
        (("--alternate", "30,x"), "a number"),
        (("--alternate", "30,3", "--unseen"), "nothing to see behind"),
        (("--alternate", "30,3", "--fix", "skew=0"), "all eleven"),
        (("--plane", "0,0,1"), "NX,NY,NZ,D"),
        (("--plane", "0,0,0,1"), "not zero"),
        (("--depth", "-3"), "a positive distance"),
        (("--method", "dlt", "--fix", "skew=0"), "reprojection"),
    ],
)
def test_what_cannot_be_done_is_refused(cadcam: Cadcam, points: Path, words: tuple[str, ...], said: str) -> None:
    ran = cadcam("variability", points, "--size", "320x240", *QUICK[:2], "--steps", "0", *words)
    assert ran.code == 2
    assert said in ran.err
    assert ran.out == ""


def test_a_file_in_place_of_the_figures_folder_is_refused(cadcam: Cadcam, points: Path) -> None:
    pytest.importorskip("matplotlib")
    ran = cadcam("variability", points, "--size", "320x240", "--plots", points)
    assert ran.code == 2
    assert "is a file" in ran.err


def test_chains_that_do_not_mix_leave_the_other_methods_their_results(
    cadcam: Cadcam, points: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chains of the usual length are left out; of a length that was asked for it is an error."""
    monkeypatch.setattr("cadcam.cli.verbs.variability._STEPS", 2_000)
    ran = cadcam("variability", points, "--size", "320x240", "--draws", "200", "--json")
    assert ran.code == 0, ran.err
    assert "Method B is left out: the Markov chains have not mixed" in ran.err
    assert ran.json["markov_chain_left_out"] in ran.err
    assert "markov_chain" not in ran.json
    assert "monte_carlo" in ran.json
    with monkeypatch.context() as any_length:
        any_length.setattr("cadcam.cli.verbs.variability._check", lambda arguments: None)
        asked = cadcam("variability", points, "--size", "320x240", "--draws", "200", "--steps", "2000")
    assert asked.code == 2
    assert "have not mixed" in asked.err
