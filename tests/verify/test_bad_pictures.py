"""What is no photo of this part by this camera: not found, or not decided; never a PASS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from .scene import CAMERA, POSE, part, photographed, plate

LIMITS = (Limit(Quantity.POSITION, 0.5), Limit(Quantity.PRESENCE, 0.0))
ASKED = Tolerances((Feature("rib", Selection("rib 1"), LIMITS), Feature("block", Selection("block"), LIMITS)))


def verified(gray: Picture, *, camera: Camera = CAMERA, pose: Rigid = POSE, of: Part | None = None) -> Verification:
    """Return the verification of a picture, the part being looked for where the plate stood."""
    of, photo = of or part(), Photo.of(gray, camera, pose)
    return verify_part(of, [photo], refine_pose(of, [photo], Rigid()), ASKED)


def other_parts() -> Mesh:
    color = (0.55, 0.55, 0.6)
    return merge(
        [
            box((-140, -30, 0), (20, 90, 70), name="crate", color=color),
            box((60, -90, 0), (140, 10, 25), name="brick", color=color),
        ]
    )


PICTURES: dict[str, Callable[[np.random.Generator], Picture]] = {
    "even": lambda rng: np.full((360, 480), 0.5, np.float32),
    "noise": lambda rng: np.asarray(rng.uniform(size=(360, 480)), np.float32),
    "black": lambda rng: np.zeros((360, 480), np.float32),
    "saturated": lambda rng: np.asarray(np.clip(photographed(plate(), rng) * 8, 0, 1), np.float32),
    "blurred": lambda rng: np.asarray(gaussian_filter(photographed(plate(), rng), 12), np.float32),
    "mirrored": lambda rng: np.asarray(photographed(plate(), rng)[:, ::-1], np.float32),
    "upside down": lambda rng: np.asarray(photographed(plate(), rng)[::-1, ::-1], np.float32),
    "of other parts": lambda rng: photographed(other_parts(), rng),
}


@pytest.mark.parametrize("name", PICTURES)
def test_what_does_not_show_the_part_is_not_found(rng: np.random.Generator, name: str) -> None:
    found = verified(PICTURES[name](rng))
    assert found.verdict is Verdict.NOT_FOUND, found.reason
    assert found.verdict.exit_code == 3
    assert {j.verdict for j in found.judgements} == {Verdict.NOT_FOUND}
    assert found.reason


def test_the_plate_itself_passes(rng: np.random.Generator) -> None:
    """The control: with none of these wrong, the same call passes."""
    assert verified(photographed(plate(), rng)).verdict is Verdict.PASS


@pytest.mark.parametrize(
    "stretch", [pytest.param((1.15, 1.0, 1.0), marks=pytest.mark.slow), (1.0, 0.85, 1.0), (1.0, 1.0, 1.6)]
)
def test_a_part_of_other_proportions_does_not_pass(rng: np.random.Generator, stretch: tuple[float, ...]) -> None:
    wrong = Part.of(replace(plate(), vertices=plate().vertices * np.array(stretch)))
    found = verified(photographed(plate(), rng), of=wrong)
    assert found.verdict is not Verdict.PASS, found.reason


def test_a_camera_of_another_focal_length_does_not_pass(rng: np.random.Generator) -> None:
    """Half as long again: the pose may take up the size of the picture, but not the perspective."""
    found = verified(photographed(plate(), rng), camera=Camera.from_focal(CAMERA.size, 1.5 * 740.0))
    assert found.verdict is not Verdict.PASS, found.reason


@pytest.mark.parametrize(("times", "asked"), [(1.0, False), (1.2, True)])
def test_a_focal_length_that_was_told_wrong_is_asked_for(rng: np.random.Generator, times: float, asked: bool) -> None:
    found = verified(photographed(plate(), rng), camera=Camera.from_focal(CAMERA.size, times * 740.0))
    assert (found.verdict is Verdict.PASS) != asked
    assert ("are model, focal length and lens as told?" in found.reason) == asked


def test_a_camera_too_near_to_see_an_outline_does_not_pass(rng: np.random.Generator) -> None:
    """All that it sees is the inside of one face."""
    near = Rigid.look_at((-40.0, 0.0, 80.0), (-40.0, 1.0, 12.0))
    found = verified(photographed(plate(), rng, near), pose=near)
    assert found.verdict is Verdict.NOT_FOUND
