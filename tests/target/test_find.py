"""Marks are found wherever they are, nothing else is, and faults of a picture are reported."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import ExtendedPinhole
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, TooFewMarks, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.target.marks.find import FoundMark, MarkOptions, find_marks
from cadcam.target.marks.ideal import board_picture, marks_picture
from cadcam.target.marks.mark import (
    Mark,
    MarkSheet,
    angle_mark,
    chess_mark,
    coded_ring,
    dot,
    dot_and_ring,
    inverted,
    ring,
)
from cadcam.target.marks.subpixel import centroid, parabola

CAMERA = Camera.from_focal((320, 240), 500.0)
RADIUS = 12.5  # px of the marks below, if upright


@cache
def _plate(mark: Mark, tilt: float = 0.0, **how: float) -> tuple[Picture, Array]:
    """Return a picture of 3 x 2 marks and where their centres are seen."""
    plate = MarkSheet.grid((mark,), 3, 2, 4.5 * mark.radius)
    middle = Rigid(np.eye(3), np.append(-plate.places.mean(axis=0), 0.0))
    turned = Rigid.exp([0, 0, 0, 0, 0, 0.3]) @ Rigid.exp([0, 0, 0, np.radians(tilt), 0, 0])
    pose = Rigid(np.eye(3), [1.0, 2.0, 500.0 * mark.radius / RADIUS]) @ turned @ middle
    rng = np.random.default_rng(5)
    picture = board_picture(plate, CAMERA, pose, blur_px=0.8, noise=0.01, rng=rng, **how)
    truth = CAMERA.project(pose @ plate.points)
    for array in (picture, truth):  # of all tests that ask for it
        array.setflags(write=False)
    return picture, truth


def _errors(found: list[FoundMark], truth: Array) -> Array:
    q = np.array([one.pixel for one in found])
    away = np.linalg.norm(q[:, None] - truth, axis=2)
    assert sorted(away.argmin(axis=1)) == list(range(len(truth)))
    return q - truth[away.argmin(axis=1)]


KINDS = [dot(20.0), ring(10.0, 20.0), dot_and_ring(8.0, 16.0, 24.0), angle_mark(8.0, 16.0, 24.0), inverted(dot(20.0))]


@pytest.mark.parametrize(
    ("radius", "count", "mark"),
    [
        *((None, None, mark) for mark in KINDS),
        *((12.0, 6, mark) for mark in KINDS),
        *(pytest.param(12.0, None, mark, marks=[pytest.mark.slow] * (k > 1)) for k, mark in enumerate(KINDS)),
    ],
    ids=str,
)
def test_every_mark_is_found_and_nothing_else(mark: Mark, radius: float | None, count: int | None) -> None:
    """Upright: within five of the standard deviations told and 0.004 px of drawing."""
    picture, truth = _plate(mark)
    found = find_marks(picture, mark, radius_px=radius, count=count)
    assert len(found) == 6
    sigma = np.array([one.sigma for one in found])
    assert (np.abs(_errors(found, truth)) < 5 * sigma + 0.004).all()
    assert sigma.max() < 0.02
    assert np.allclose([one.size for one in found], RADIUS, rtol=0.02)
    assert not any(one.flags for one in found)


def test_tilted_marks_are_found_and_a_camera_takes_their_shift_off() -> None:
    mark = dot_and_ring(8.0, 16.0, 24.0)
    picture, truth = _plate(mark, 45.0)
    plain, through = find_marks(picture, mark), find_marks(picture, mark, camera=CAMERA)
    assert len(plain) == len(through) == 6
    assert np.sqrt(np.mean(_errors(plain, truth) ** 2)) > 0.04
    sigma = np.array([one.sigma for one in through])
    assert (np.abs(_errors(through, truth)) < 5 * sigma + 0.004).all()
    assert all(one.pose is not None for one in through)


def test_corners_need_their_size() -> None:
    mark = chess_mark(24.0)
    picture, truth = _plate(mark)
    with pytest.raises(BadValue, match="radius"):
        find_marks(picture, mark)
    found = find_marks(picture, mark, radius_px=12.0)
    assert np.abs(_errors(found, truth)).max() < 0.03


def test_marks_with_a_direction_tell_it() -> None:
    picture, _ = _plate(angle_mark(8.0, 16.0, 24.0))
    angles = [one.angle for one in find_marks(picture, angle_mark(8.0, 16.0, 24.0))]
    assert np.allclose(angles, 0.3, atol=0.003)  # rad: the plate's turn; four to five times their scatter


def test_coded_marks_tell_their_numbers() -> None:
    numbers = (5, 37, 83, 91)
    like = coded_ring(37, 16.0, 20.0, 30.0)
    plate = MarkSheet.grid(tuple(coded_ring(n, 16.0, 20.0, 30.0) for n in numbers), 4, 1, 45.0)
    pose = Rigid(np.eye(3), [-67.0, 0.0, 400.0]) @ Rigid.exp([0, 0, 0, 0.4, 0, 0.1])
    picture = board_picture(plate, CAMERA, pose, blur_px=0.7)
    found = {one.number: one.pixel for one in find_marks(picture, like, options=MarkOptions(any_number=True))}
    assert set(found) == set(numbers)
    truth = CAMERA.project(pose @ plate.points)
    assert all(np.abs(found[n] - q).max() < 0.15 for n, q in zip(numbers, truth, strict=True))
    assert [one.number for one in find_marks(picture, like)] == [37]


@pytest.mark.parametrize(
    ("radius", "count"), [(None, None), (12.0, 6), pytest.param(12.0, None, marks=pytest.mark.slow)]
)
def test_light_that_falls_threefold_loses_no_mark(radius: float | None, count: int | None) -> None:
    mark = dot_and_ring(8.0, 16.0, 24.0)
    picture, truth = _plate(mark)
    shaded = (picture / (1 + 2 * np.linspace(0, 1, 320))).astype(np.float32)
    found = find_marks(shaded, mark, radius_px=radius, count=count)
    assert np.abs(_errors(found, truth)).max() < 0.05


@pytest.mark.parametrize("rule", ["parabola", "centroid", "autocorrelation", "autocorrelation-grid"])
def test_the_other_rules_are_near_on_upright_marks(rule: str) -> None:
    """To 0.1 px, which is what the dissertation expects of its method."""
    picture, truth = _plate(KINDS[2])
    found = find_marks(picture, KINDS[2], options=MarkOptions(subpixel=rule))
    assert np.abs(_errors(found, truth)).max() < 0.1
    assert all(np.isnan(one.covariance).all() for one in found)


def test_what_is_wrong_with_a_mark_is_flagged() -> None:
    mark = dot_and_ring(8.0, 16.0, 24.0)
    picture, truth = _plate(mark)
    x, y = np.rint(truth[0]).astype(int)
    covered = picture.copy()
    covered[y - 15 : y + 15, x + 6 : x + 14] = 0.5
    flags = [one.flags for one in find_marks(covered, mark) if np.hypot(*(one.pixel - truth[0])) < 2]
    assert flags == [("covered",)]
    bright = np.clip(picture * 1.4, 0, 1)
    assert all("saturated" in one.flags for one in find_marks(bright, mark))
    cut = picture[:, int(truth[:, 0].min()) - 11 :]
    assert any("cut" in one.flags for one in find_marks(cut, mark))


def test_bad_pictures_and_wishes_are_refused_with_a_reason(rng: np.random.Generator) -> None:
    mark = dot(20.0)
    with pytest.raises(BadValue, match="one grey value"):
        find_marks(np.full((50, 50), 0.5), mark)
    noise = rng.normal(0.5, 0.05, (120, 160)).astype(np.float32)
    assert find_marks(noise, mark) == []
    assert find_marks(noise, mark, radius_px=8.0) == []
    with pytest.raises(TooFewMarks, match="none was found of 3 marks dot:20mm"):
        find_marks(noise, mark, count=3)
    with pytest.raises(UnknownName, match="spots"):
        MarkOptions(method="magic")
    with pytest.raises(UnknownName, match="parabola"):
        MarkOptions(subpixel="magic")
    with pytest.raises(BadValue, match="no number"):
        find_marks(noise, mark, options=MarkOptions(any_number=True))
    with pytest.raises(BadValue, match="one ellipse of dot:20mm does not show where its centre is"):
        find_marks(noise, mark, options=MarkOptions(perspective=True))
    with pytest.raises(BadValue, match="not a crossing of edges"):
        find_marks(noise, mark, radius_px=8.0, options=MarkOptions(method="saddles"))
    with pytest.raises(BadValue, match="least, largest"):
        find_marks(noise, mark, radius_px=0.2)
    for radius in (161.0, np.nan, (5.0, np.inf)):
        with pytest.raises(BadValue, match="longer side of 160 px"):
            find_marks(noise, mark, radius_px=radius)
    with pytest.raises(BadValue, match="count"):
        find_marks(noise, mark, count=0)
    for wish in ({"least_score": np.nan}, {"margin": np.nan}, {"margin": -1.0}):
        with pytest.raises(BadValue, match=next(iter(wish))):
            MarkOptions(**wish)


def test_the_best_are_returned_where_there_are_more() -> None:
    picture, _ = _plate(KINDS[2])
    assert len(find_marks(picture, KINDS[2], radius_px=12.0, count=2)) == 2


def test_a_parabola_finds_the_summit_of_one() -> None:
    y, x = np.mgrid[-1:2, -1:2]
    z = 1 - 0.2 * (x - 0.3) ** 2 - 0.3 * (y + 0.1) ** 2 + 0.05 * (x - 0.3) * (y + 0.1)
    assert np.allclose(parabola(z), [0.3, -0.1], atol=1e-12)
    assert np.isnan(parabola(-z)).all()


def test_a_centroid_has_no_preferred_place_in_the_pixel() -> None:
    """Over 25 places within a pixel its error's mean and spread stay below 0.005 px."""
    errors = []
    for shift in (np.mgrid[0:5, 0:5].reshape(2, -1).T + 0.1) / 5:
        camera = Camera.from_focal((48, 48), 500.0, cx=23 + shift[0], cy=23 + shift[1])
        picture = marks_picture([dot(20.0)], camera, [Rigid(np.eye(3), [0, 0, 500.0])], blur_px=0.8, background=0.9)
        errors.append(centroid(picture, np.array([23.0, 24.0]), 10.0) - 23 - shift)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.005
    assert np.std(errors, axis=0).max() < 0.005


BENCH = np.array(
    [[0, 80], [10, 220], [10, 400], [100, 140], [110, 300], [220, 230], [250, 80], [290, 400]], float
)  # X, Y of Table 2.3, mm, in the planes Z = -1040 and Z = -1410
BENCH_CAMERA = (7.7, 416.3, -210.4, *np.radians([-9.04, -9.44, -2.36]), 1.007, 805.9, np.radians(0.01), 319.7, 354.7)


@pytest.mark.slow
def test_the_dissertation_s_bench_is_calibrated_from_pictures_of_its_targets() -> None:
    """Table 2.3's targets drawn with Table 2.9's camera, noise 3 of 255, found and calibrated: the camera comes back.

    Chi-square of the 11 parameters by their covariance: below its 95 % quantile 19.7. The first calibration takes the
    centres of the ellipses, the second those that the first camera gives.
    """
    from cadcam.calibrate.points.camera import calibrate_camera

    truth = ExtendedPinhole.from_vector(BENCH_CAMERA)
    camera, view = truth.camera((768, 576)), truth.camera_from_world
    mark, rng = dot_and_ring(10.0, 20.0, 30.0), np.random.default_rng(23)
    world_from_mark = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # x right is Y, y down is X
    pictures, points = [], []
    for z in (-1040.0, -1410.0):
        places = np.column_stack([BENCH, np.full(8, z)])
        poses = [view @ Rigid(world_from_mark, p) for p in places]
        pictures.append(marks_picture([mark] * 8, camera, poses, blur_px=0.8, noise=3 / 255, rng=rng))
        points.append(places)
    estimate = None
    for _ in range(2):
        seen = []
        for picture, places in zip(pictures, points, strict=True):
            known = None if estimate is None else estimate.camera
            normal = None if estimate is None else estimate.camera_from_world.rotation @ [0.0, 0.0, 1.0]
            found = find_marks(picture, mark, radius_px=(8.0, 18.0), count=8, camera=known, normal=normal)
            q, expected = np.array([one.pixel for one in found]), camera.project(view @ places)
            seen.append(q[np.linalg.norm(q - expected[:, None], axis=2).argmin(axis=1)])
        estimate = calibrate_camera(Observations(np.concatenate(points), np.concatenate(seen)), (768, 576))
    assert estimate is not None
    assert estimate.rms_px < 0.03
    error = estimate.values - np.array(BENCH_CAMERA)
    assert error @ np.linalg.solve(estimate.covariance, error) < 19.7


@pytest.mark.parametrize("method", ["auto", "spots", "correlation", "blobs"])
def test_a_mark_larger_than_the_picture_is_not_in_it(method: str, rng: np.random.Generator) -> None:
    for shape in ((3, 40), (7, 9), (40, 90)):
        assert (
            find_marks(
                rng.random(shape),
                dot_and_ring(8.0, 16.0, 24.0),
                radius_px=shape[1] / 2,
                options=MarkOptions(method=method),
            )
            == []
        )
