"""What stands before a part: regions with borders that the photo shows, and that go on beyond the part."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Mask
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.occluder import covered, side_words
from cadcam.locate.refine.refinement import refine_pose
from cadcam.report.locate import evidence_table, location_as_json

from ..cad.solids import box
from .photos import CAMERA, noisy, shot, view

BENT = Camera.from_focal((640, 480), 900.0, lens=BrownConrady(-0.35, 0.1))
PAPER = 0.3  # grey of what stands before the part


def behind(camera: Camera, along: float, level: float, wide: float = np.inf) -> Mask:
    """Return the pixels (H, W) at level to level + wide px in the direction `along` (rad), as seen without a lens."""
    x, y = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    ray = camera.unproject(np.column_stack([x.ravel(), y.ravel()]))
    d = camera.fx * (ray[:, :2] / ray[:, 2:]) @ np.array([np.cos(along), np.sin(along)]) - level
    return np.asarray(((d > 0) & (d < wide)).reshape(y.shape))


def photo_behind(part: Part, pose: Rigid, hidden: Mask, rng: np.random.Generator, camera: Camera = CAMERA) -> Photo:
    """Return the photo of a part with paper before it."""
    cover = gaussian_filter(hidden.astype(float), 0.7)
    return Photo.of(noisy((1 - cover) * shot(part, pose, camera) + cover * PAPER, 0.01, rng), camera)


def samples_left(part: Part, photo: Photo, pose: Rigid) -> tuple[Array, Array, int]:
    """Return the places (n, 2) px of all samples and of those that are left, and how many borders there are."""
    sight = Sight.of(part, photo, pose, step_px=3.0, reach_px=6.0)
    (behind,), borders = covered([sight], pose, 0.05)
    return sight.project(pose).q, sight.select(~behind).project(pose).q, borders


def share_of(q: Array, hidden: Mask) -> float:
    """Return the share of places (n, 2) px that lie in a part of the picture."""
    x, y = np.rint(q).astype(int).T
    return float(hidden[y, x].mean())


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize(("along", "level"), [(0.3, 25.0), (2.0, 25.0), (4.4, -10.0)])
def test_a_part_half_behind_something_is_found(
    part: Part, pose: Rigid, along: float, level: float, camera: Camera, rng: np.random.Generator
) -> None:
    photo = photo_behind(part, pose, behind(camera, along, level), rng, camera)
    found = refine_pose(part, [photo], pose)
    assert found.found, found.reason
    assert found.covered is not None
    assert found.covered.share > 0.2
    assert f"left out: they are behind something before the part, at its {found.covered.side}" in found.reason
    row = dict(row[:2] for row in evidence_table(found).rows)["hidden"]
    assert row.startswith(f"something stands before the part at its {found.covered.side} and hides ")
    told = location_as_json(found, [photo])["covered"]
    assert told == {"share": found.covered.share, "side": found.covered.side}


def test_the_side_is_that_of_the_picture(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    photo = photo_behind(part, pose, np.zeros((480, 640), bool), rng)
    sight = Sight.of(part, photo, pose, step_px=3.0, reach_px=6.0)
    q = sight.project(pose).q
    middle = (q.min(axis=0) + q.max(axis=0)) / 2
    sides = {"right": (1, 0), "left": (-1, 0), "bottom": (0, 1), "top": (0, -1), "lower left": (-1, 1)}
    for said, way in sides.items():
        towards = (q - middle) @ np.array(way) / np.linalg.norm(way) / np.linalg.norm(q - middle, axis=1)
        assert side_words([sight], pose, [towards > np.cos(np.radians(20))]) == said
    some, none = q[:, 0] < middle[0] - 40, np.zeros(len(q), bool)
    assert side_words([sight, sight], pose, [some, none]) == f"{side_words([sight], pose, [some])} (photo 'photo')"
    assert side_words([sight], pose, [~none]) == ""  # all of it: on no side


def test_where_nothing_is_before_it_nothing_is_said(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    photo = photo_behind(part, pose, np.zeros((480, 640), bool), rng)
    found = refine_pose(part, [photo], pose)
    assert found.covered is None
    assert location_as_json(found, [photo])["covered"] is None
    assert "hidden" not in {row[0] for row in evidence_table(found).rows}


def test_exactly_what_is_behind_it_is_left_out(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    hidden = behind(CAMERA, 2.0, 25.0)
    everything, left, borders = samples_left(part, photo_behind(part, pose, hidden, rng), pose)
    assert borders == 1
    assert share_of(everything, hidden) > 0.3
    assert share_of(left, hidden) < 0.03  # those within 1.5 px of the border stay


def test_a_border_is_straight_in_space_not_in_the_picture_of_a_lens(part: Part, rng: np.random.Generator) -> None:
    wide = Camera.from_focal((640, 480), 330.0, lens=BrownConrady(-0.25, 0.05))
    pose = view(part, (0.7, -0.9, 0.8), away=1.9, aim=0.35)
    for along, level in ((3.44, 110.0), (5.14, -90.0), (4.24, 40.0)):
        hidden = behind(wide, along, level)
        everything, left, borders = samples_left(part, photo_behind(part, pose, hidden, rng, wide), pose)
        assert borders == 1, (along, level)
        assert share_of(everything, hidden) > 0.2
        assert share_of(left, hidden) < 0.03  # those within 1.5 px of the border stay


def test_a_border_that_is_not_seen_before_the_part_is_none(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    """Half of the part fades into its ground, and beside it two strokes lie on one line."""
    clean = shot(part, pose)
    ground = float(np.median(clean[:20, :20]))
    fade = gaussian_filter(behind(CAMERA, 2.0, 25.0).astype(float), 12.0)
    q = CAMERA.project(pose @ part.scene.mesh.vertices)
    x = np.arange(640)
    beside = (x < q[:, 0].min() - 4) | (x > q[:, 0].max() + 4)
    strokes = gaussian_filter((beside & behind(CAMERA, 2.0, 25.0)).astype(float), 0.7)
    picture = (1 - strokes) * ((1 - fade) * clean + fade * ground) + strokes * PAPER
    assert samples_left(part, Photo.of(noisy(picture, 0.01, rng), CAMERA), pose)[2] == 0


def test_an_arm_across_the_part_has_two_borders(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    hidden = behind(CAMERA, 2.0, -30.0, 70.0)
    _, left, borders = samples_left(part, photo_behind(part, pose, hidden, rng), pose)
    assert borders == 2
    assert share_of(left, hidden) < 0.06


def test_where_the_part_ends_before_its_model_nothing_is_left_out(rng: np.random.Generator) -> None:
    """Its end is a straight border as well, behind which nothing is, but goes no farther than the part."""
    true, model = (Part.of(box([0, 0, 0], [length, 60, 40])) for length in (100, 160))
    for direction in ((0.5, 0.7, 1.0), (-0.4, 0.6, 0.9), (0.1, -0.8, 0.7)):
        pose = view(model, direction, away=5.0)
        everything, left, borders = samples_left(model, Photo.of(noisy(shot(true, pose), 0.01, rng), CAMERA), pose)
        assert borders == 0
        assert len(left) == len(everything)


def test_a_hole_in_what_is_shown_is_nothing_before_the_part(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    """A border that ends with what it hides is as likely that of another part."""
    x, y = np.meshgrid(np.arange(640), np.arange(480))
    q = CAMERA.project(pose @ part.scene.mesh.vertices)
    low, high = q.min(axis=0), q.max(axis=0)
    inside = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    picture = photo_behind(part, pose, behind(CAMERA, 2.0, 25.0) & inside, rng)
    assert samples_left(part, picture, pose)[2] == 0


def test_a_part_in_full_view_loses_nothing(part: Part, pose: Rigid, rng: np.random.Generator) -> None:
    everything, left, borders = samples_left(part, photo_behind(part, pose, np.zeros((480, 640), bool), rng), pose)
    assert borders == 0
    assert len(left) == len(everything)
