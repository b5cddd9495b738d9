"""`cadcam match`: templates and parts are found, absence is exit 3, and invalid requests are one-line errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.observations import Observations
from cadcam.errors import MissingCore
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture
from cadcam.native import core
from cadcam.render import open_renderer
from cadcam.render.view import Look, Scene

from .job import CAMERA, POSE, Ran
from .locating import CAMERA as SEEN_BY
from .locating import MODELS, make_photo_job

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)


@pytest.fixture
def photo(job: Path) -> Path:
    """Return a photo of the block on a floor, with noise, in place of the job's."""
    view = open_renderer(Scene.of(read_model(job / "block.obj")), threads=1).render(
        CAMERA, POSE, look=Look(background=(0.35, 0.35, 0.35), head=0.3, fill=0.6, supersampling=3)
    )
    noise = np.random.default_rng(3).normal(scale=0.01, size=view.gray.shape)
    write_picture(job / "photo.png", np.clip(view.gray + noise, 0, 1).astype(np.float32))
    return job / "photo.png"


def test_a_template_is_found_where_it_was_cut_out(cadcam: Callable[..., Ran], job: Path, photo: Path) -> None:
    gray = read_picture(photo)
    h, w = gray.shape[:2]
    x, y = w // 2 - 24, h // 2 - 20
    write_picture(job / "corner.png", gray[y : y + 40, x : x + 48])
    ran = cadcam("match", photo, job / "corner.png", "--json", "-o", job / "where.png")
    assert ran.code == 0
    best = ran.json["peaks"][0]
    assert best["q"] == pytest.approx([x + 23.5, y + 19.5], abs=0.01)
    assert best["angle_deg"] == pytest.approx(0, abs=0.05)
    assert best["score"] > 0.999
    assert read_picture(job / "where.png").shape[:2] == (h, w)
    table = cadcam("match", photo, job / "corner.png")
    assert "gap" in table.out
    assert "1  1.0000" in table.out
    assert "-0.00" not in table.out


def test_what_is_not_there_is_exit_3_and_a_sentence(cadcam: Callable[..., Ran], job: Path, photo: Path) -> None:
    write_picture(job / "other.png", np.random.default_rng(1).uniform(size=(6, 6)).repeat(8, 0).repeat(8, 1))
    ran = cadcam("match", photo, job / "other.png", "--least-score", "0.8")
    assert ran.code == 3
    assert "nothing in the picture looks like the template" in ran.out
    assert cadcam("match", photo, job / "other.png", "--least-score", "0.8", "--json").json["peaks"] == []


@pytest.mark.parametrize("dots", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_template_with_hardly_any_structure_is_told_how_much_it_has(
    cadcam: Callable[..., Ran], job: Path, dots: int
) -> None:
    """Coarse pixels see only how bright the wall is, here and there: the template is not found in its own photo."""
    y, x = np.mgrid[:700, :900]
    wall = 0.5 + 0.05 * x / 900 + 0.025 * y / 700 + 0.01 * np.random.default_rng(1).standard_normal(x.shape)
    wall += dots * 0.4 * ((np.hypot(x - 460, y - 360) < 5.5) | (np.hypot(x - 475, y - 350) < 3.5))
    write_picture(job / "wall.png", wall)
    whole, close = wall[100:600, 200:700], wall[330:390, 430:490]
    write_picture(job / "large.png", whole)
    ran = cadcam("match", job / "wall.png", job / "large.png")
    told = re.search(r"(\d+) of the template's 250000 pixels lie on a border or texture", ran.out)
    assert told
    assert "a smaller one, cut out around them" in ran.out
    # a slope reaches 2 px beyond a disc's rim; of noise, 4 slopes of a million stand out
    most = sum(np.pi * (r + 2) ** 2 for r in (5.5, 3.5)) * dots + 10
    assert sum(2 * np.pi * r for r in (5.5, 3.5)) * dots <= int(told[1]) <= most
    document = cadcam("match", job / "wall.png", job / "large.png", "--json").json
    assert (document["template_pixels"], document["structured_pixels"]) == (250000, int(told[1]))
    if dots:  # as advised
        write_picture(job / "close.png", close)
        ran = cadcam("match", job / "wall.png", job / "close.png")
        assert ran.code == 0
        assert "border or texture" not in ran.out
        assert re.search(r"^ *1  1\.0000", ran.out, re.MULTILINE)


def test_a_part_comes_with_features_edges_and_pose(cadcam: Callable[..., Ran], job: Path, photo: Path) -> None:
    start = Rigid(translation=[2.0, -1.5, 3.0]) @ POSE @ Rigid.exp([0, 0, 0, 0.02, -0.02, 0.02])
    write_camera(job / "camera.json", CAMERA, camera_from_world=start)
    words = ["match", photo, job / "block.obj", "--camera", job / "camera.json"]
    ran = cadcam(*words, "--json", "-o", job / "features.png")
    assert ran.code == (0 if ran.json["found"] else 3)
    assert len(ran.json["features"]) >= 2
    assert {"drawn", "p_part", "chosen", "peaks", "complete"} == set(ran.json["features"][0])
    assert len(ran.json["edges"]["each"]) == 9  # the edges of a block that can be seen at once
    assert read_picture(job / "features.png").shape == (240, 320, 3)
    words_out = cadcam(*words, "--measure", "--peaks").out
    assert "features" in words_out
    assert "How close the photo's edges are" in words_out
    assert "Feature 1, drawn at" in words_out


def test_the_calibration_s_uncertainty_is_part_of_the_pose_s(cadcam: Callable[..., Ran], tmp_path: Path) -> None:
    make_photo_job(tmp_path)
    p = np.random.default_rng(4).uniform([-80, -60, 250], [80, 60, 450], size=(40, 3))
    seen = SEEN_BY.project(p) + np.random.default_rng(5).normal(scale=0.3, size=(40, 2))
    calibrated = calibrate_camera(Observations(p, seen, tuple(map(str, range(40)))), SEEN_BY.size, lens=SEEN_BY.lens)
    write_camera(tmp_path / "calibrated.json", calibrated)
    write_camera(tmp_path / "exact.json", calibrated.camera)
    words = ("match", tmp_path / "photo.png", MODELS / "bracket.stl", "--pose", tmp_path / "start.txt", "--camera")
    known, exact = (cadcam(*words, tmp_path / name, "--json").json for name in ("calibrated.json", "exact.json"))
    share = np.array(known["from_calibration"])
    assert np.sqrt(np.diag(share)[:3]).max() > 0.05  # mm: 0.3 px on 40 points, at some 350 mm
    assert not np.array(exact["from_calibration"]).any()
    np.testing.assert_allclose(np.array(known["covariance"]) - share, exact["covariance"], rtol=1e-9, atol=1e-12)
    assert "part's axes, calibration included" in cadcam(*words, tmp_path / "calibrated.json").out


def test_a_part_that_is_not_there_is_exit_3(cadcam: Callable[..., Ran], job: Path) -> None:
    ran = cadcam("match", job / "photo.png", job / "block.obj", "--camera", job / "camera.json")
    assert ran.code == 3
    assert "not found" in ran.out
    write_picture(job / "photo.png", np.full((240, 320), 0.5))
    none = cadcam("match", job / "photo.png", job / "block.obj", "--camera", job / "camera.json").out
    assert "no more edges of the photo lie on the visible lines at the pose given than by chance" in none
    assert "-0" not in none


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["block.obj"], "--camera is missing"),
        (["photo.png", "--angles", "10,-10"], "angles"),
        (["none.png"], "none.png"),
        (["photo.png", "-o", "where.svg"], "suffix"),
        (["photo.png", "--count", "0"], "count"),
        (["points.csv"], "expected a picture (.png .jpg"),
        (["large.png"], "large.png is 700 x 600 px, which does not fit into the photo"),
        (["wide.png"], "wide.png is 330 x 100 px, which does not fit into the photo"),
        (["tall.png", "--angles", "-10,10"], "tall.png is 100 x 260 px, which does not fit into the photo"),
        (["block.obj", "--camera", "alone.json"], "expected a camera file with camera_from_world, or --pose FILE\n"),
        (["photo.png", "--mask", "small.png"], "small.png is 4 x 4 px; expected the template's 320 x 240 px"),
    ],
)
def test_wrong_wishes_are_exit_2_with_one_message(
    words: list[str], said: str, cadcam: Callable[..., Ran], job: Path
) -> None:
    write_picture(job / "small.png", np.full((4, 4), 0.5))
    write_picture(job / "large.png", np.random.default_rng(1).uniform(size=(600, 700)))
    write_picture(job / "wide.png", np.random.default_rng(1).uniform(size=(100, 330)))
    write_picture(job / "tall.png", np.random.default_rng(1).uniform(size=(260, 100)))
    write_camera(job / "alone.json", SEEN_BY)
    at = [str(job / w) if w.endswith((".png", ".obj", ".svg", ".csv", ".json")) else w for w in words]
    ran = cadcam("match", job / "photo.png", *at)
    assert ran.code == 2
    assert said in ran.err
    assert ran.err.count("cadcam match:") == 1


def test_a_template_that_fits_when_turned_or_where_it_counts_is_searched_for(
    cadcam: Callable[..., Ran], job: Path, photo: Path
) -> None:
    """It must lie in the photo of 320 x 240 px with the pixels that count."""
    gray = read_picture(photo)
    write_picture(job / "upright.png", np.rot90(gray[60:160, 10:310]))
    ran = cadcam("match", photo, job / "upright.png", "--angles", "85,95")
    assert ran.code == 0, ran.err
    y, x = np.mgrid[:240, :240] - 119.5
    write_picture(job / "round.png", gray[:, 40:280], alpha=np.hypot(x, y) < 119)
    assert cadcam("match", photo, job / "round.png", "--angles", "40,50").code in (0, 3)
    large, counts = np.pad(gray, 50, mode="edge"), np.pad(np.ones((180, 240)), ((80, 80), (90, 90)))
    write_picture(job / "padded.png", large, alpha=counts)
    assert cadcam("match", photo, job / "padded.png", "--angles", "-1,1").code == 0


def test_along_an_edge_the_place_is_said_not_to_be_determined(cadcam: Callable[..., Ran], tmp_path: Path) -> None:
    x = np.arange(200.0)
    edge = np.tile(0.5 + 0.2 * np.tanh((x - 90) / 1.0), (160, 1))
    rng = np.random.default_rng(2)
    write_picture(tmp_path / "photo.png", edge + 0.01 * rng.standard_normal(edge.shape))
    write_picture(tmp_path / "edge.png", edge[:48, 66:114] + 0.01 * rng.standard_normal((48, 48)))
    document = cadcam("match", tmp_path / "photo.png", tmp_path / "edge.png", "--json").json
    best = document["peaks"][0]
    assert np.abs(best["not_determined"]["along"]) == pytest.approx(np.array([[0, 1]]), abs=0.02)
    assert best["not_determined"]["angle"] is False
    assert best["sigma_px"][1] == pytest.approx(160 / np.sqrt(12), rel=0.01)
    C = np.array(best["covariance"])
    np.testing.assert_allclose(np.sqrt(np.diag(C)[:2]), best["sigma_px"])
    across = np.sqrt(np.linalg.eigvalsh(C[:2, :2])[0])
    assert abs(best["q"][0] - 89.5) < 4 * across < 0.2  # the template's middle, 23.5 px from its first column, 66
    out = cadcam("match", tmp_path / "photo.png", tmp_path / "edge.png").out
    assert "not determined along (" in out
    row = next(line.split() for line in out.splitlines() if line.strip().startswith("1 "))
    assert f"{across:.3f}" in row  # what is said of x and y is what is known, across the edge
    corner = edge.copy()
    corner[:60] = 0.3
    write_picture(tmp_path / "corner.png", corner)
    write_picture(tmp_path / "of_it.png", corner[36:84, 66:114])
    ran = cadcam("match", tmp_path / "corner.png", tmp_path / "of_it.png", "--count", "1")
    assert ran.code == 0
    assert "not determined" not in ran.out
