"""Lines that noise hides: pictures are smoothed as far as that takes, and right poses are believed again."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import calming, step_candidates
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo

from .scene import CAMERA, block, largest_miss, off, photo_of, pose_of


@pytest.mark.parametrize("spread", [0.0, 0.7, 1.7])
def test_noise_alone_seldom_makes_a_step(spread: float, rng: np.random.Generator) -> None:
    """Four standard deviations are as rare in a smoothed picture as in one as it is, two are not: the sd is right."""
    from scipy.ndimage import gaussian_filter

    noise = 0.03
    gray = (0.5 + noise * rng.standard_normal((400, 400))).astype(np.float32)
    gray = gaussian_filter(gray, spread) if spread else gray
    q, angle = rng.uniform(40, 360, (4000, 2)), rng.uniform(0, 2 * np.pi, 4000)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    share = {}
    for clear in (2.0, 4.0):
        found = step_candidates(gray, q, normal, half_length=2.0, reach=6, noise=noise, spread=spread, clear=clear)
        share[clear] = np.isfinite(found.slope[:, 0]).mean()
    assert share[4.0] < 0.01
    assert share[2.0] > 0.05


def test_pictures_are_smoothed_the_more_the_noisier_and_clean_ones_not_at_all(rng: np.random.Generator) -> None:
    assert calming(0.0) == 0.0
    assert np.all(np.diff([calming(noise) for noise in np.linspace(0, 0.1, 50)]) >= 0)
    clean = Photo.of(np.full((480, 640), 0.5, np.float32), CAMERA.resize((640, 480)))
    assert clean.calmed() is clean
    assert clean.lines is clean.gray


def test_a_part_is_found_where_noise_hides_most_of_its_lines(rng: np.random.Generator) -> None:
    """Noise of 20 grey levels; looked at as it is the picture shows too few lines."""
    pose = pose_of(rng)
    gray = photo_of(pose, rng).gray + 20 / 255 * rng.standard_normal((CAMERA.height, CAMERA.width))
    photo = Photo.of(np.clip(gray, 0, 1).astype(np.float32), CAMERA)
    found = locate_part(block(), [photo], off(pose, rng, degrees=3, px=6))
    assert found.found, found.reason
    assert largest_miss(found.pose.world_from_part, pose) < 1.5
    away = locate_part(block(), [photo], Rigid(translation=pose @ block().aspects.centre * [0.3, 0.3, 0]) @ pose)
    assert not away.found or largest_miss(away.pose.world_from_part, pose) < 1.5
