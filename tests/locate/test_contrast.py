"""Lines between surfaces that the light makes equally bright are known to show nothing, and only those."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from cadcam.arrays import Picture
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.photo import Photo
from cadcam.locate.quality.contrast import showing
from cadcam.locate.refine.refinement import refine_pose
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look

from .scene import CAMERA, DIM, NOISE, block, largest_miss, off, photo_of, pose_of

EVEN = Look(head=0.0, fill=0.0, back=0.0, ambient=0.6, background=(0.2, 0.2, 0.2), supersampling=4)


def sight(shot: Photo, pose: Rigid) -> Sight:
    return Sight.of(block(), shot, pose, step_px=4.0, reach_px=9.0)


def gray_in(look: Look, pose: Rigid) -> Picture:
    return open_renderer(block().scene, threads=1).render(CAMERA, pose, channels=Channel.IMAGE, look=look).gray


def photo_in(look: Look, pose: Rigid, rng: np.random.Generator) -> Photo:
    gray = gray_in(look, pose)
    return Photo.of(np.clip(gray + rng.normal(0, NOISE, gray.shape), 0, 1).astype(np.float32), CAMERA)


def test_lines_left_out_have_no_contrast_in_the_photo_and_no_others_are(rng: np.random.Generator) -> None:
    """By the photo without its noise, beside lines that have room: told from 2 sigma of it, right to 3."""
    left_out = 0
    for _ in range(4):
        pose = pose_of(rng)
        whole = sight(photo_of(pose, rng), pose)
        at, samples = whole.project(pose), whole.samples
        kept = np.isin(
            samples.p @ [1.0, np.pi, np.e], showing(block(), [whole], pose)[0].samples.p @ [1.0, np.pi, np.e]
        )
        clean, room = gray_in(DIM, pose), np.minimum(samples.below, samples.above) > 4
        sides = [map_coordinates(clean, (at.q + t * at.normal).T[::-1], order=1, mode="nearest") for t in (-2, 2)]
        contrast = np.abs(sides[1] - sides[0])
        assert (contrast[~kept & room] < 3 * NOISE).mean() > 0.9
        assert (contrast[kept & room] > NOISE).mean() > 0.9
        left_out += int((~kept & room).sum())
    assert left_out > 20


def test_a_part_of_which_the_light_shows_the_outline_alone_is_found_by_it(rng: np.random.Generator) -> None:
    pose = pose_of(rng)
    shot = photo_in(EVEN, pose, rng)
    found = refine_pose(block(), [shot], off(pose, rng, degrees=0.5, px=3))
    assert found.found, found.reason
    assert "no contrast" in found.reason
    assert largest_miss(found.pose.world_from_part, pose) < 2
    assert not refine_pose(block(), [shot], off(pose, rng, degrees=12, px=60)).found


def test_light_excuses_missing_lines_also_where_those_that_show_prove_little(rng: np.random.Generator) -> None:
    """As after a search over the whole photo, which meets some lines anywhere: half of them is then as good as none."""
    for _ in range(2):
        pose = pose_of(rng)
        shot = photo_in(EVEN, pose, rng)
        found = refine_pose(block(), [shot], off(pose, rng, degrees=0.5, px=3), chosen=14)
        assert found.found, found.reason
        assert "no contrast" in found.reason
        assert largest_miss(found.pose.world_from_part, pose) < 2
