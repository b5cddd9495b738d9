"""Where is the part, where its approach as a whole has nothing to say."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import NothingInView
from cadcam.geometry.rigid import Rigid
from cadcam.locate.locate import locate

from .scene import CAMERA, block, photo_of


@pytest.mark.parametrize(
    ("eye", "target"),
    [
        ((392, 165, 192), (193, 258, 23)),
        ((280, 195, 246), (472, 309, 30)),
        ((392, 77, 141), (399, 317, 48)),
        ((250, 240, 160), (220, 392, 60)),  # the part's middle lies behind the camera
    ],
)
def test_from_within_a_part_a_start_is_refined_though_no_approach_finds_it(
    eye: tuple[float, float, float], target: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """25 to 45 px off, among few lines of a part of which most is beside the picture or behind the camera."""
    part, pose = block(), Rigid.look_at(eye, target)
    p = part.lines.draw(CAMERA, pose).visible.p
    middle = pose @ p.mean(axis=0)
    about = Rigid(translation=middle)
    aside = Rigid(translation=middle[2] * np.array([14 / CAMERA.fx, -10 / CAMERA.fx, 0.02]))
    start = aside @ about @ Rigid.exp([0, 0, 0, 0.03, -0.02, 0.025]) @ about.inv @ pose
    found = locate(part, [photo_of(pose, rng)], start)
    assert found.found, found.reason
    q, truth = CAMERA.project(found.pose.world_from_part @ p), CAMERA.project(pose @ p)
    assert np.linalg.norm(q - truth, axis=1).max() < 1


def test_a_start_that_sees_nothing_of_the_part_is_refused(rng: np.random.Generator) -> None:
    pose = Rigid.look_at((392, 165, 192), (193, 258, 23))
    with pytest.raises(NothingInView, match="outside of every photo"):
        locate(block(), [photo_of(pose, rng)], Rigid.look_at((700, 500, 300), (1500, 900, 300)))
