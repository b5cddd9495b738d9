"""Held values tested against the points: true ones are rejected no more often than stated, wrong ones always."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.calibrate.points.held import held_against
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
from cadcam.camera.observations import Observations

D = np.radians
TRUTH = ExtendedPinhole(120.0, 80.0, 300.0, D(20), D(-35), D(75), 1.03, 900.0, D(0.8), 270.0, 400.0)
VALUES = dict(zip(NAMES, TRUTH.vector.tolist(), strict=True))
SIZE, NOISE = (768, 576), 0.3


def seen(rng: np.random.Generator, *, stated: bool = False) -> Observations:
    in_camera = rng.uniform(-1, 1, (16, 3)) * [280, 200, 250] + [0, 0, 900]
    camera: Camera = TRUTH.camera(SIZE)
    q = camera.project(in_camera) + NOISE * rng.normal(size=(16, 2))
    return Observations(TRUTH.camera_from_world.inv @ in_camera, q, sigma_px=NOISE if stated else None)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [False, True])
def test_of_true_values_the_chance_is_even(rng: np.random.Generator, stated: bool) -> None:
    """Uniform from 0 to 1: mean and scatter of forty within 4.5 standard errors."""
    held = {name: VALUES[name] for name in ("skew", "aspect")}
    chances = []
    for _ in range(40):
        told = held_against(calibrate_camera(seen(rng, stated=stated), SIZE, fixed=held), tuple(held))
        assert told is not None
        chances.append(told.chance)
    assert abs(np.mean(chances) - 0.5) < 4.5 * np.sqrt(1 / 12 / 40)
    assert abs(np.mean(np.square(np.array(chances) - 0.5)) - 1 / 12) < 4.5 * np.sqrt(1 / 180 / 40)


def test_a_wrong_value_is_contradicted_and_the_right_one_told(rng: np.random.Generator) -> None:
    told = held_against(calibrate_camera(seen(rng), SIZE, fixed={"aspect": 1.0, "U0": 270.0}), ("aspect",))
    assert told is not None
    assert told.contradicted
    assert "U0" not in told.free.free, "what is not asked about stays held"
    assert abs(told.free.value("aspect") - 1.03) < 5 * told.free.sigma("aspect")


def test_exact_points_contradict_nothing_that_is_true(rng: np.random.Generator) -> None:
    exact = seen(np.random.default_rng(1))
    q = TRUTH.camera(SIZE).project(TRUTH.camera_from_world @ exact.p_world)
    told = held_against(
        calibrate_camera(Observations(exact.p_world, q), SIZE, fixed={"skew": VALUES["skew"]}), ("skew",)
    )
    assert told is not None
    assert not told.contradicted


def test_what_points_do_not_determine_is_not_asked(rng: np.random.Generator) -> None:
    few = seen(rng)
    some = Observations(few.p_world[:5], few.q[:5])
    held = {name: VALUES[name] for name in ("aspect", "focal", "skew", "U0", "V0")}
    assert held_against(calibrate_camera(some, SIZE, fixed=held), tuple(held)) is None
