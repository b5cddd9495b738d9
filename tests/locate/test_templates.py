"""Windows of the drawing are found in photos that are lit otherwise, hidden ones do no harm, and absence is said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, MissingCore, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.locate.match.salient import SalientOptions
from cadcam.locate.match.templates import TemplateOptions, match_templates
from cadcam.locate.photo import Photo
from cadcam.native import core
from cadcam.report.match import matches_as_json
from cadcam.report.match_picture import with_features

from .scene import CAMERA, NOISE, block, largest_miss, off, photo_of, pose_of

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)


FEW = TemplateOptions(salient=SalientOptions(count=16))  # enough here, and quicker


@pytest.mark.parametrize("poses", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_a_rough_pose_becomes_a_good_one(poses: int, rng: np.random.Generator) -> None:
    """2 px: half the width of a drawn line with its blur; a match of the wrong corner is off by 10 px and more."""
    for _ in range(poses):
        truth = pose_of(rng)
        start = off(truth, rng, degrees=5, px=15)
        matches = match_templates(block(), [photo_of(truth, rng)], start, options=FEW)
        assert largest_miss(start, truth) > 15
        assert matches.found
        assert matches.pose is not None
        assert largest_miss(matches.pose.world_from_part, truth) < 2
        assert len(matches.q) >= 8


def test_matches_are_where_their_points_are(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    matches = match_templates(block(), [photo_of(truth, rng)], off(truth, rng, degrees=4, px=10), options=FEW)
    miss = np.linalg.norm(CAMERA.project(truth @ matches.p_part) - matches.q, axis=1)
    assert np.median(miss) < 0.7  # a CAD edge is drawn as a line, seen as a step beside another: half a pixel or so
    assert len(matches.p_part) == len(matches.q) == len(matches.sigma) == len(matches.photo)
    assert (matches.sigma < 1).all()


def test_a_cable_over_the_part_does_no_harm(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    photo = photo_of(truth, rng)
    gray = photo.gray.copy()
    gray[:, 250:330] = 0.1 + rng.normal(scale=NOISE, size=(480, 80))
    covered = Photo.of(np.clip(gray, 0, 1), CAMERA)
    matches = match_templates(block(), [covered], off(truth, rng, degrees=4, px=12))
    assert matches.found
    assert matches.pose is not None
    assert largest_miss(matches.pose.world_from_part, truth) < 3
    hidden = (matches.q[:, 0] > 255) & (matches.q[:, 0] < 325)
    assert not hidden.any()


def test_a_part_that_is_not_there_is_not_found(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    empty = Photo.of(np.clip(0.5 + rng.normal(scale=NOISE, size=(480, 640)), 0, 1), CAMERA)
    assert not match_templates(block(), [empty], truth, options=FEW).found
    blobs = Photo.of(rng.uniform(size=(60, 80)).repeat(8, axis=0).repeat(8, axis=1), CAMERA)
    assert not match_templates(block(), [blobs], truth, options=FEW).found
    mirrored = Photo.of(photo_of(truth, rng).gray[:, ::-1], CAMERA)
    assert not match_templates(block(), [mirrored], truth, options=FEW).found


def test_a_start_far_off_is_not_found_rather_than_wrong(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    matches = match_templates(block(), [photo_of(truth, rng)], off(truth, rng, degrees=60, px=100), options=FEW)
    if matches.found and matches.pose is not None:
        assert largest_miss(matches.pose.world_from_part, truth) < 2


def test_two_photos_know_more_than_one(rng: np.random.Generator) -> None:
    """The covariance of a pair seen from two sides is smaller in depth by far more than the sqrt(2) of more matches."""
    truth = pose_of(rng)
    beside = Rigid.exp([0, 0, 0, 0, 0.6, 0])
    distance = float(np.linalg.norm(truth @ block().scene.mesh.vertices.mean(axis=0)))
    camera2_from_world = Rigid(translation=[0, 0, distance]) @ beside @ Rigid(translation=[0, 0, -distance])
    first, second = photo_of(truth, rng), photo_of(camera2_from_world @ truth, rng)
    pair = [first, Photo.of(second.gray, CAMERA, camera2_from_world, name="second")]
    start = off(truth, rng, degrees=3, px=8)
    one, two = (match_templates(block(), photos, start, options=FEW) for photos in (pair[:1], pair))
    assert one.pose is not None
    assert two.pose is not None
    assert {0, 1} == set(two.photo.tolist())
    assert largest_miss(two.pose.world_from_part, truth) < 2
    sight = truth.rotation[2]  # of the first camera, in part axes
    depth_one, depth_two = (math.sqrt(sight @ m.pose.covariance[:3, :3] @ sight) for m in (one, two) if m.pose)
    assert depth_two < depth_one / 2


def test_gradients_of_the_shaded_part_match_too(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    options = replace(FEW, appearance="gradient")
    matches = match_templates(block(), [photo_of(truth, rng)], off(truth, rng, degrees=3, px=8), options=options)
    assert matches.found
    assert matches.pose is not None
    assert largest_miss(matches.pose.world_from_part, truth) < 2


def test_every_feature_has_its_peak_table(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    options = TemplateOptions(rounds=1)
    features = match_templates(
        block(), [photo_of(truth, rng)], off(truth, rng, degrees=3, px=8), options=options
    ).features
    assert len(features) >= 10
    for peaks, chosen in zip(features.peaks, features.chosen, strict=True):
        assert len(peaks) <= options.peaks
        assert chosen < len(peaks)
        assert (np.diff(peaks.score) <= 0).all()
    assert max(int(c) for c in features.chosen) >= 0


def test_a_model_out_of_view_is_not_found(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    behind = Rigid(translation=[0, 0, -5000]) @ truth
    assert not match_templates(block(), [photo_of(truth, rng)], behind).found


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reach", 0),
        ("turn", 4.0),
        ("peaks", 0),
        ("rounds", 0),
        ("least_score", 1.5),
        ("tolerance", np.nan),
        ("tolerance", np.inf),
    ],
)
def test_a_wrong_option_is_refused_by_its_name_and_value(name: str, value: float) -> None:
    with pytest.raises(BadValue, match=f"^{name} is {value}"):
        TemplateOptions(**{name: value})  # type: ignore[arg-type]  # the mistake that is tested


def test_an_appearance_that_there_is_not_is_refused() -> None:
    with pytest.raises(UnknownName, match="did you mean 'lines'"):
        TemplateOptions(appearance="line")  # type: ignore[arg-type]  # the mistake that is tested


def test_a_camera_with_a_lens_is_matched_as_well(rng: np.random.Generator) -> None:
    """The drawing bends its lines as the lens does."""
    from cadcam.camera.lens import BrownConrady
    from cadcam.render import open_renderer
    from cadcam.render.view import Channel, Look

    camera = Camera.from_focal((640, 480), 900.0, lens=BrownConrady(k1=-0.25))
    truth = pose_of(rng)
    view = open_renderer(block().scene, threads=1).render(
        camera, truth, channels=Channel.IMAGE, look=Look(background=(0.3, 0.3, 0.3), supersampling=3)
    )
    photo = Photo.of(np.clip(view.gray + rng.normal(scale=NOISE, size=view.gray.shape), 0, 1), camera)
    matches = match_templates(block(), [photo], off(truth, rng, degrees=3, px=8), options=FEW)
    assert matches.found
    assert matches.pose is not None
    assert largest_miss(matches.pose.world_from_part, truth) < 2


def test_pose_and_features_are_told_of_each_of_several_cameras(rng: np.random.Generator) -> None:
    """The world is no camera's: the lines, and the pose of the JSON, were those of the part seen from the world."""
    truth, world = pose_of(rng), Rigid.exp([300, -200, 100, 0.4, -0.7, 0.2])
    gray = photo_of(truth, rng).gray
    pair = [Photo.of(gray, CAMERA, world.inv, name=name) for name in ("left", "right")]
    found = match_templates(block(), pair, world @ off(truth, rng, degrees=3, px=8), options=FEW)
    assert found.found
    v, here = block().scene.mesh.vertices, Photo.of(gray, CAMERA)
    alone = with_features(here, block(), match_templates(block(), [here], truth, options=FEW))
    for number, taken in enumerate(pair):
        told = matches_as_json(found, taken, number)
        assert len(told["features"]) == np.count_nonzero(found.features.photo == number)
        R, t = np.array(told["camera_from_part"]["rotation"]), np.array(told["camera_from_part"]["translation_mm"])
        assert np.abs(CAMERA.project(v @ R.T + t) - CAMERA.project(truth @ v)).max() < 2.0
        assert np.mean(with_features(taken, block(), found, number) != alone) < 0.1
