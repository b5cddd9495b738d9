"""Parts so bright that the photo shows them white are found where they are, and as surely as is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.render import open_renderer
from cadcam.render.view import Channel

from .photos import CAMERA, LOOK, error_px, noisy

BEFORE_DARK = replace(LOOK, background=(0.2, 0.2, 0.2))
SIGMA = 0.01
EACH = 6  # pictures


@pytest.fixture(scope="module")
def light(part: Part, pose: Rigid) -> np.ndarray:
    """Return the light in the picture, at most 0.64: before a dark ground."""
    shaded = open_renderer(part.scene).render(CAMERA, pose, look=BEFORE_DARK, channels=Channel.IMAGE)
    return np.asarray(gaussian_filter(shaded.gray, 0.6))


@pytest.mark.parametrize("exposure", [1.8, 2.1])
def test_an_overexposed_part_is_found_where_it_is(
    part: Part, pose: Rigid, light: np.ndarray, rng: np.random.Generator, exposure: float
) -> None:
    """xi C^-1 xi of 6 parameters, mean of 6 photos: 6 +- 1.4; 30 where white was taken for the light that it hides."""
    squared, off = [], []
    for _ in range(EACH):
        shown = noisy(exposure * light, SIGMA, rng)
        assert np.mean(shown == 1) > 0.1
        found = refine_pose(part, [Photo.of(shown, CAMERA)], pose)
        assert found.found
        xi = (pose.inv @ found.pose.world_from_part).log()
        squared.append(float(xi @ np.linalg.solve(found.pose.covariance, xi)))
        off.append(error_px(part, CAMERA, pose, found.pose.world_from_part))
    assert np.mean(squared) < 6 + 4 * 1.4
    assert np.mean(off) < 0.1  # 0.22 and 0.27 so taken


@pytest.mark.parametrize(("white", "sigma"), [(0.97, 0.02), (1.0, 0.01), (1.05, 0.01)])
def test_before_a_white_ground_a_part_is_found_as_surely_as_is_said(
    part: Part, pose: Rigid, rng: np.random.Generator, white: float, sigma: float
) -> None:
    """16 at the first, where of the ground those pixels were left out that noise made white."""
    look = replace(LOOK, background=(1.0, 1.0, 1.0))
    shaded = open_renderer(part.scene).render(CAMERA, pose, look=look, channels=Channel.IMAGE)
    light = white * gaussian_filter(shaded.gray, 0.6)
    squared = []
    for _ in range(EACH):
        found = refine_pose(part, [Photo.of(noisy(light, sigma, rng), CAMERA)], pose)
        assert found.found
        xi = (pose.inv @ found.pose.world_from_part).log()
        squared.append(float(xi @ np.linalg.solve(found.pose.covariance, xi)))
    assert np.mean(squared) < 6 + 4 * 1.4


def test_one_of_which_white_leaves_too_little_is_not_found_and_less_light_is_advised(
    part: Part, pose: Rigid, light: np.ndarray, rng: np.random.Generator
) -> None:
    found = refine_pose(part, [Photo.of(noisy(6 * light, SIGMA, rng), CAMERA)], pose)
    assert not found.found
    assert "the photo is white: with less light more would show" in found.reason
    dark = refine_pose(part, [Photo.of(noisy(0.02 * light, SIGMA, rng), CAMERA)], pose)
    assert not dark.found
    assert "white" not in dark.reason
