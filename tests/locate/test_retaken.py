"""Photos with more pixels than detail, as phones and enlargements give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.locate.refine import retaken
from cadcam.locate.refine.retaken import _in_pixels_of_photos, at_their_sharpness

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

    def refused(photos: Sequence[Photo], times: Sequence[int]) -> list[Location]:
        asked.extend(one.camera.size for one in photos)
        location = locate_part(block(), photos, pose)
        return [location.uncertain("for this test")]

    at_their_sharpness([photo], refused)
    assert set(asked) == {CAMERA.size}


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
    with pytest.raises(BadValue, match="binning"):
        photo.reduced(CAMERA.width + 1)


def test_by_how_much_edges_are_off_is_told_in_pixels_of_the_photos(rng: np.random.Generator) -> None:
    pose = pose_of(rng)
    found = locate_part(block(), [photo_of(pose, rng)], pose)
    told = _in_pixels_of_photos(replace(found, off_px=0.5), np.array([TIMES]))
    assert told.off_px == TIMES * 0.5
    assert "off by 2.00 px" in told.amiss
