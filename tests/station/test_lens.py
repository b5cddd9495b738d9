"""A station whose camera has a distorting lens: known, it is taken off; unknown, the plate tells that something is."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.station.document import read_station, write_station
from cadcam.station.gantry import Sighting, calibrate_gantry
from cadcam.station.hall import Visit, make_hall
from cadcam.station.hall_picture import hall_picture
from cadcam.station.marks import MarkLook, find_plate
from cadcam.station.measure import measure_marks
from cadcam.station.plane import calibrate_position, refuse_misfit
from cadcam.station.plate import place_plate
from cadcam.station.simulate import calibrate_robot, day
from cadcam.target.marks.mark import parse_mark

BENT = BrownConrady(k1=-8.0, k2=20.0)  # as bad as lenses get: 37 px in the corners of the picture
CAMERA = Camera.from_focal((768, 576), 4650.0, fy=5070.0, lens=BENT)


def bent_hall(rng, **kwargs):
    return make_hall(rng, robots=("6",), camera=CAMERA, **kwargs)


def test_errors_are_those_of_the_covariance_through_a_lens():
    """Twelve stiff halls, one mark each: 24 errors, an rms of 1 +- 0.14."""
    z = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        hall = bent_hall(rng, deflection_mm=1e-6)
        station = calibrate_robot(hall, "6", rng, columns=2, rows=2).station
        work = day(hall, rng, marks=1)
        found = measure_marks(station, work.sightings)
        z.append((found.points[:, :2] - work.points) / found.sigma[:, :2])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.45)


@pytest.fixture(scope="module")
def position():
    """A plate laid at a position: hall, position, true places of the marks, and where the survey puts the plate."""
    rng = np.random.default_rng(3)
    hall = bent_hall(rng)
    at = np.array([8700.0, 17500.0])
    marks, reflectors = hall.survey(*hall.lay_plate("6", at, rng), rng)
    return hall, at, marks, place_plate(hall.plate, reflectors, sigma_mm=hall.survey_mm)


@pytest.fixture(scope="module")
def pixels(position):
    hall, at, marks, _ = position
    return hall.seen("6", at, marks, Visit(), np.random.default_rng(1))


def test_a_lens_that_is_not_told_is_a_misfit(position, pixels):
    _, at, _, placement = position
    refuse_misfit(calibrate_position("p", at, pixels, placement, lens=CAMERA), limit_px=0.3)
    with pytest.raises(DegenerateGeometry, match="do not fit the plate"):
        refuse_misfit(calibrate_position("p", at, pixels, placement), limit_px=0.3)


def test_marks_are_put_into_order_through_the_lens(position):
    """0.05 px: as without a lens."""
    hall, at, marks, _ = position
    gray = hall_picture(hall, "6", at, marks, Visit(), np.random.default_rng(1))
    found = find_plate(gray, hall.plate, MarkLook(parse_mark(hall.plate.mark)), lens=CAMERA)
    assert np.abs(found.q - hall.project("6", at, marks, Visit())).max() < 0.05


def test_a_station_file_keeps_the_lens_and_the_pixels_as_found(tmp_path, position, pixels):
    """To 1e-9 px: an inverse of the lens lies between."""
    _, at, _, placement = position
    one = calibrate_position("p", at, pixels, placement, sigma_px=0.03, lens=CAMERA)
    write_station(tmp_path / "s.json", calibrate_gantry("6", [one]))
    back = read_station(tmp_path / "s.json")
    assert back.lens is not None
    assert back.lens.lens == BENT
    assert np.abs(back.positions[0].pixels - pixels).max() < 1e-9
    assert back.positions[0].camera.matrix == pytest.approx(one.camera.matrix, rel=1e-6)
    assert back.positions[0].sigma_px == one.sigma_px == 0.03
    assert back.sigma_px == pytest.approx(0.03, rel=1e-12)


@pytest.mark.parametrize("q", [(384.0, 288.0), (20.0, 15.0), (740.0, 560.0)], ids=["middle", "corner", "other corner"])
def test_pixels_that_the_lens_stretches_are_as_uncertain_as_they_move_the_point(position, pixels, q):
    """In the corners of this lens a pixel as found is 1.3 pixels without distortion; to 1e-6, of differences."""
    _, at, _, placement = position
    station = calibrate_gantry("6", [calibrate_position("p", at, pixels, placement, sigma_px=0.03, lens=CAMERA)])

    def seen(dx, dy):
        return measure_marks(station, [Sighting.of("m", "6", at, np.add(q, (dx, dy)), sigma_px=0.1)])

    h = 1e-3
    by_pixel = [(seen(*d).points - seen(*(-d)).points)[0, :2] / (2 * h) for d in h * np.eye(2)]
    moved = 0.1**2 * np.transpose(by_pixel) @ by_pixel
    assert seen(0, 0).from_pixels[0, :2, :2] == pytest.approx(moved, rel=1e-5, abs=1e-9)


def test_positions_of_two_lenses_are_refused(position, pixels):
    _, at, _, placement = position
    one = calibrate_position("p", at, pixels, placement, lens=CAMERA)
    other = calibrate_position("q", at + 3000.0, pixels, placement)
    with pytest.raises(BadValue, match="lens of q"):
        calibrate_gantry("6", [one, other])
