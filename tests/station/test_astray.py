"""A mark that is not where the others have it is named with its size; noise and a plate not quite as drawn are not."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.plane_camera import PlaneCamera
from cadcam.station.astray import marks_astray
from cadcam.station.plane import PlaneCalibration, calibrate_position
from cadcam.station.plate import Plate, place_plate

AT = np.array([5000.0, 8000.0])
PLATE = Plate.b4(sigma_mm=0.1)
CAMERA = PlaneCamera.from_uv_matrix([[0.02, 0.843, 250.0], [-0.773, 0.01, 380.0], [2e-5, -3e-5, 1.0]])
NOISE = 0.05


def seen(rng: np.random.Generator, off: float = 0.0, marks: int = 8, stated: bool = True) -> PlaneCalibration:
    """Return a position whose plate was made with its sigma, photographed with noise, mark 2 being off along x."""
    place = AT - np.array([230.0, 140.0])
    made = PLATE.points + PLATE.sigma_mm * rng.normal(size=PLATE.points.shape)
    q = CAMERA.project(made[:8] + place - AT) + NOISE * rng.normal(size=(8, 2))
    q[1, 0] += off
    q[marks:] = np.nan
    placed = place_plate(PLATE, made[8:] + place, sigma_mm=0.1)
    return calibrate_position("p", AT, q, placed, sigma_px=NOISE if stated else None)


def test_noise_and_the_plate_s_making_are_not_astray(rng: np.random.Generator) -> None:
    """Of 300 positions none: each of 2400 marks by chance once in three million."""
    assert marks_astray([seen(rng) for _ in range(300)]) == ()


def test_a_mark_that_is_off_is_named_and_its_size_scatters_as_stated(rng: np.random.Generator) -> None:
    """300 positions: a standard deviation is known to 4 %, so 15 % is more than three sigma of it."""
    found = marks_astray([seen(rng, 3.0) for _ in range(300)])
    assert [one.mark for one in found] == ["2"] * 300
    off, expected = np.array([one.off_px for one in found]), found[0].expected_px
    assert off.mean() == pytest.approx(3.0, abs=4 * expected / np.sqrt(300) + expected**2 / 6)
    assert off.std() == pytest.approx(expected, rel=0.15)


def test_noise_that_is_not_stated_is_that_of_the_other_positions(rng: np.random.Generator) -> None:
    """Alone, a mark that is off raises the noise that it is compared with."""
    bad, good = seen(rng, 3.0, stated=False), [seen(rng, stated=False) for _ in range(4)]
    assert [one.mark for one in marks_astray([*good, bad])] == ["2"]
    assert marks_astray([bad]) == ()


def test_what_cannot_be_told_is_not_told(rng: np.random.Generator) -> None:
    """Four marks fit any four pixels; of five, three of them in line, so do the two beside it."""
    assert marks_astray([seen(rng, 30.0, marks=4)]) == ()
    assert marks_astray([seen(rng, 30.0, marks=5)]) == ()
    assert [one.mark for one in marks_astray([seen(rng, 30.0, marks=6)])] == ["2"]
