"""Photos with more pixels than detail, as phones and enlargements give them."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.viewpoint import ErrorSource, Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import retaken
from cadcam.locate.refine.retaken import at_their_sharpness

from .scene import CAMERA, block, off, photo_of, pose_of

TIMES = 4


def enlarged(photo: Photo, rng: np.random.Generator) -> Photo:
    """Return a photo with grain of two pixels, enlarged: no step is sharper than some pixels, nor is its grain."""
    from scipy.ndimage import zoom

    grainy = np.clip(photo.gray + 9 / 255 * rng.standard_normal(photo.gray.shape), 0, 1)
    large = np.clip(zoom(grainy, TIMES, order=3, grid_mode=True, mode="nearest"), 0, 1)
    width, height = photo.camera.size
    return Photo.of(np.asarray(large, np.float32), photo.camera.resize((TIMES * width, TIMES * height)))


def test_a_part_is_found_in_an_enlarged_photo_and_told_in_its_pixels(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose = pose_of(rng)
    photo = enlarged(photo_of(pose, rng), rng)
    start = off(pose, rng, degrees=2, px=4)
    found = locate_part(block(), [photo], start)
    assert found.found, found.reason
    assert "reduced 4 times" in found.reason
    places = photo.camera.project(found.pose.world_from_part @ found.matches.p)
    assert np.abs(places - found.matches.q).max() < TIMES * 0.5  # of a pixel that it was measured in
    monkeypatch.setattr(retaken, "_SHARP_PX", np.inf)  # never reduced
    assert not locate_part(block(), [photo], start).found


def test_a_sharp_photo_is_not_reduced(rng: np.random.Generator) -> None:
    """An answer that is not found is given of the photos as they are."""
    pose = pose_of(rng)
    photo = photo_of(pose, rng)
    asked: list[tuple[int, int]] = []

    def refused(photos: list[Photo]) -> object:
        asked.extend(one.camera.size for one in photos)
        location = locate_part(block(), photos, pose)
        return location.uncertain("for this test")

    at_their_sharpness([photo], refused)  # type: ignore[arg-type]
    assert set(asked) == {CAMERA.size}


def test_a_reduced_viewpoint_sees_the_same_and_errs_by_the_same() -> None:
    """Places, and what errors do to them, are those of the picture over the times that it is reduced."""
    camera = Camera.from_focal((641, 482), 900.0, fy=903.0, cx=310.2, cy=251.7, lens=BrownConrady(-0.2, 0.1, 1e-3, 0.0))
    n = 11 + len(camera.lens.parameters)
    source = ErrorSource("all", np.eye(n), object())
    view = Viewpoint("camera", camera, Rigid(translation=np.array([5.0, -3.0, 400.0])), 0.3, ((source, np.eye(n)),))
    p = np.random.default_rng(0).uniform(-60, 60, (20, 3))
    q, by_point, (by_error,) = view.project(p)
    less_q, less_by_point, (less_by_error,) = view.reduced(3).project(p)
    assert view.reduced(3).camera.size == (213, 160)
    np.testing.assert_allclose(less_q, (q - 1) / 3, atol=1e-9)
    np.testing.assert_allclose(less_by_point, by_point / 3, atol=1e-9)
    np.testing.assert_allclose(less_by_error, by_error / 3, rtol=1e-9, atol=1e-7)


def test_a_reduced_photo_keeps_its_colour_and_the_mean_of_its_pixels(rng: np.random.Generator) -> None:
    picture = rng.random((CAMERA.height, CAMERA.width, 3)).astype(np.float32)
    photo = Photo.of(picture, CAMERA)
    less = photo.reduced(2)
    assert less.chroma is not None
    assert photo.chroma is not None
    cell = np.s_[10:12, 20:22]
    assert less.gray[5, 10] == pytest.approx(photo.gray[cell].mean(), abs=1e-6)
    np.testing.assert_allclose(less.chroma[5, 10], photo.chroma[cell].mean(axis=(0, 1)), atol=1e-6)
    assert photo.reduced(1) is photo
