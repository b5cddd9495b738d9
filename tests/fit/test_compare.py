"""Two cameras compared, and one refitted with another lens."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import LENSES, BrownConrady, Fisheye, InverseBrownConrady
from cadcam.errors import SizeMismatch
from cadcam.fit.compare import compare_cameras
from cadcam.fit.lens import refitted
from cadcam.geometry import rotation as so3

CAMERA = Camera.from_focal((640, 480), 535.9, cx=342.3, cy=235.6, skew=0.5, lens=BrownConrady(-0.26, 0.1, 1e-3, -3e-4))


def test_a_camera_does_not_differ_from_itself() -> None:
    for rotate in (False, True):
        difference = compare_cameras(CAMERA, CAMERA, rotate=rotate)
        assert difference.max_px < 1e-11
        assert difference.unseen == 0
        assert difference.rotation_deg < 1e-12


def test_a_shifted_principal_point_is_the_shift_and_nearly_a_rotation() -> None:
    a, b = Camera.from_focal((640, 480), 2000.0), Camera.from_focal((640, 480), 2000.0, cx=319.5 + 3, cy=239.5 - 4)
    plain = compare_cameras(a, b)
    assert np.abs(plain.delta - [3, -4]).max() < 1e-10
    assert plain.rms_px == pytest.approx(5)
    assert set(plain.places()) == {"centre", "top left", "top right", "bottom left", "bottom right"}
    turned = compare_cameras(a, b, rotate=True)
    # a turn by d moves pixels by f d (1 + (r/f)^2): 5 px by (0.2)^2 at the corners, less what the best turn takes
    assert turned.max_px < 5 * 0.2**2
    assert turned.rotation_deg == pytest.approx(np.degrees(5 / 2000), rel=0.02)


def test_no_rotation_is_better_than_the_one_found(rng: np.random.Generator) -> None:
    other = Camera.from_focal((640, 480), 540.0, cx=350, cy=230, lens=CAMERA.lens)
    best = compare_cameras(CAMERA, other, rotate=True)
    q = best.q.reshape(-1, 2)
    d = CAMERA.unproject(q)

    def rms(rotation: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(np.sum((other.project(d @ rotation.T) - q) ** 2, axis=1))))

    assert rms(best.b_from_a) == pytest.approx(best.rms_px, rel=1e-9)
    for w in rng.normal(scale=1e-4, size=(20, 3)):
        assert rms(best.b_from_a @ so3.exp(w)) > best.rms_px


def test_pixels_that_one_camera_does_not_see_are_counted_not_compared() -> None:
    wide = Camera.from_focal((640, 480), 300.0)
    folds = Camera.from_focal((640, 480), 300.0, lens=BrownConrady(-0.35, 0.05))
    difference = compare_cameras(wide, folds)
    assert 0 < difference.unseen < difference.distance.size
    assert np.isfinite(difference.max_px)


def test_pictures_of_different_sizes_are_refused() -> None:
    with pytest.raises(SizeMismatch, match="320 x 240 px but the camera is 640 x 480"):
        compare_cameras(CAMERA, CAMERA.resize((320, 240)))


def test_a_refit_with_its_own_lens_finds_it_again() -> None:
    for model, lens in (
        ("brown-conrady", BrownConrady(-0.2, 0.05, 1e-3, -2e-3, 0.01)),
        ("inverse-brown-conrady", InverseBrownConrady(0.2, -0.05, 1e-3, -2e-3, 0.01)),
        ("fisheye", Fisheye(0.02, -0.01, 0.001)),
        ("double-sphere", LENSES["double-sphere"](xi=-0.1, alpha=0.5)),
    ):
        camera = Camera.from_focal((640, 480), 700.0, fy=690.0, cx=330, lens=lens)
        terms = [name for name, value in lens.parameters.items() if value]
        found = refitted(camera, model, terms)
        assert found.max_px < 1e-6
        # not the coefficients: those of a polynomial trade with each other at this level
        assert found.camera.lens.name == model


def test_no_other_coefficients_come_nearer() -> None:
    camera = Camera.from_focal((640, 480), 700.0, lens=BrownConrady(-0.2, 0.05))
    best = refitted(camera, "division", ("k",))
    for k in (-1e-3, 1e-3):
        lens = LENSES["division"](k=best.camera.lens.parameters["k"] + k)
        worse = compare_cameras(camera, Camera(camera.size, best.camera.K, lens))
        assert worse.rms_px > compare_cameras(camera, best.camera).rms_px
    assert best.rms_px < best.max_px < 1
