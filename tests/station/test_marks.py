"""The plate and the daily mark in pictures of the hall; pictures that show something else are refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, DegenerateGeometry, NoOrder, TooFewMarks
from cadcam.image.sensor.light import PixelAspect
from cadcam.image.sensor.presets import PRESETS, preset
from cadcam.image.sensor.sensor import Sensor
from cadcam.station.hall import Visit, make_hall
from cadcam.station.hall_picture import hall_picture
from cadcam.station.marks import MarkLook, find_mark, find_plate
from cadcam.station.plate import Plate, turn
from cadcam.target.marks.mark import parse_mark

AT = np.array([8700.0, 17500.0])
LOOK = MarkLook(parse_mark(Plate.b4().mark), 25.0)


@pytest.fixture(scope="module")
def small():
    """A hall whose camera has half as many pixels each way."""
    camera = Camera.from_focal((384, 288), 2325.0, fy=2535.0)
    return make_hall(np.random.default_rng(2), robots=("6",), camera=camera)


@pytest.fixture(scope="module")
def marks(small):
    angle = 0.03
    middle = small.plate.marks.mean(axis=0)
    return small.plate.marks @ turn(angle).T + small.view_centre("6", AT) - turn(angle) @ middle


def shown(small, marks, seed=0):
    return hall_picture(small, "6", AT, marks, Visit(), np.random.default_rng(seed))


@pytest.fixture(scope="module")
def picture(small, marks):
    return shown(small, marks)


def test_all_marks_of_the_plate_are_found_in_their_order(small, marks, picture):
    """A hundredth of a pixel is how far the middle of a mark's picture lies from its centre at this tilt."""
    found = find_plate(picture, small.plate, LOOK)
    true = small.project("6", AT, marks, Visit())
    assert np.abs(found.q - true).max() < 0.05
    assert found.false == 0
    assert found.radius_px == pytest.approx(60 / np.sqrt(2.58 * 2.37), rel=0.02)
    assert 0.001 < found.sigma_px < 0.03


def test_without_its_size_the_plate_is_found_too(small, marks, picture):
    found = find_plate(picture, small.plate, MarkLook(LOOK.mark))
    assert np.abs(found.q - small.project("6", AT, marks, Visit())).max() < 0.05


def test_a_hidden_mark_is_left_out(small, marks):
    found = find_plate(shown(small, np.delete(marks, 2, axis=0)), small.plate, LOOK)
    assert np.flatnonzero(np.isnan(found.q[:, 0])).tolist() == [2]


def test_the_daily_mark_is_found(small, marks):
    q, covariance = find_mark(shown(small, marks[5:6]), LOOK)
    assert q == pytest.approx(small.project("6", AT, marks[5:6], Visit())[0], abs=0.05)
    assert np.sqrt(np.diag(covariance)).max() < 0.05


def test_an_empty_picture_has_no_marks(small):
    empty = np.random.default_rng(1).normal(0.5, 0.02, (288, 384)).astype(np.float32)
    with pytest.raises(TooFewMarks, match="none was found of 8"):
        find_plate(empty, small.plate, LOOK)
    with pytest.raises(TooFewMarks, match="none was found of 1"):
        find_mark(empty, LOOK)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "global-shutter")) for name in PRESETS]
)
def test_marks_are_found_through_every_sensor(small, marks, name):
    """0.05 px: a gamma moves the two borders of a ring apart, and its centre only by what tilt and noise make of it."""
    seen = hall_picture(replace(small, sensor=preset(name)), "6", AT, marks, Visit(), np.random.default_rng(1))
    found = find_plate(seen, small.plate, LOOK)
    assert np.abs(found.q - small.project("6", AT, marks, Visit())).max() < 0.05


def test_a_sensor_that_changes_the_pictures_size_is_refused():
    with pytest.raises(BadValue, match="pixel_aspect of the hall's sensor"):
        make_hall(np.random.default_rng(0), sensor=Sensor(pixel_aspect=PixelAspect(1.1)))


def test_three_marks_are_too_few(small, marks):
    with pytest.raises(TooFewMarks, match="only 3 were found of 8"):
        find_plate(shown(small, marks[:3]), small.plate, LOOK)


def test_another_plate_is_refused(small, marks):
    other = Plate(np.array([[0, 0], [300, 20], [410, 250], [40, 230], [180, 90], [90, 130]]), small.plate.reflectors)
    with pytest.raises((NoOrder, DegenerateGeometry)):
        find_plate(shown(small, marks), other, LOOK)


def test_two_plates_in_view_are_refused(small):
    plate = Plate(0.55 * small.plate.marks, small.plate.reflectors, mark="dot:50mm")
    centre = small.view_centre("6", AT)
    both = np.concatenate([plate.marks + centre + off for off in ([-330, -80], [60, -80])])
    picture = shown(replace(small, plate=plate), both)
    with pytest.raises(DegenerateGeometry, match="two plates in view"):
        find_plate(picture, plate, MarkLook(parse_mark(plate.mark), 10.5))


def test_several_marks_are_too_many_for_daily_work(picture):
    with pytest.raises(BadValue, match="number of marks in the picture is 8"):
        find_mark(picture, LOOK)


def test_burnt_out_marks_are_refused(small, picture, marks):
    burnt = np.clip(3.0 * picture - 0.9, 0.0, 1.0).astype(np.float32)
    with pytest.raises(BadValue, match="saturated"):
        find_plate(burnt, small.plate, LOOK)
    with pytest.raises(BadValue, match="saturated"):
        find_mark(np.clip(3 * shown(small, marks[5:6]) - 0.9, 0, 1).astype(np.float32), LOOK)
