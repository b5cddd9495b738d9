"""A model of wrong proportions is told as that; one of right proportions never is."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.bands import FARTHEST_PX
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.proportions import Stretched, _Stretchable, stretched
from cadcam.locate.quality.support import judged_support
from cadcam.locate.refine.refinement import refine_pose
from cadcam.native.profiles import met

from ..cad.solids import box
from .photos import photo, view

SIZE = np.array([100.0, 60.0, 40.0])
BOX = Part.of(box([0, 0, 0], SIZE))
CORNER = view(BOX, (0.5, 0.7, 1.0), away=5.0)


def sights(part: Part, shots: Photo, pose: Rigid) -> list[Sight]:
    return [Sight.of(part, shots, pose, step_px=4.0, reach_px=14.0)]


def fitted(size: np.ndarray, rng: np.random.Generator) -> tuple[Part, Photo, Rigid, str]:
    """Return a box of another size, the true one's photo, the pose in which it fits best, and what is said of that."""
    part, shots = Part.of(box([0, 0, 0], size)), photo(BOX, CORNER, rng)
    found = refine_pose(part, [shots], CORNER)
    return part, shots, found.pose.world_from_part, found.reason


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("factor", [0.84, 1.17])
def test_the_lengths_that_the_photo_shows_are_found(axis: int, factor: float, rng: np.random.Generator) -> None:
    size = SIZE * np.where(np.arange(3) == axis, factor, 1.0)
    part, shots = Part.of(box([0, 0, 0], size)), photo(BOX, CORNER, rng)
    lengths = stretched(sights(part, shots, CORNER), CORNER, np.eye(6)).lengths
    ratio = lengths[axis] / np.sqrt(np.prod(np.delete(lengths, axis)))
    assert ratio == pytest.approx(1 / factor, rel=0.03)  # a pixel or two on edges of 60 to 150 px


def test_a_model_of_right_proportions_fits_best_as_it_is(rng: np.random.Generator) -> None:
    part, shots, pose, said = fitted(SIZE, rng)
    assert stretched(sights(part, shots, pose), pose, np.eye(6)).by < 0.02
    assert "axis (" not in said


def test_a_model_that_a_try_moves_out_of_the_photo_stays_as_long_as_it_was(rng: np.random.Generator) -> None:
    """All of it is behind the camera: no line is left to pull."""
    behind, seen = Rigid(translation=[0, 0, -5000.0]) @ CORNER, sights(BOX, photo(BOX, CORNER, rng), CORNER)
    pose, lengths = _Stretchable(seen, np.eye(6), SIZE / 2).pulled(behind, np.zeros(3))
    assert pose is behind
    assert not lengths.any()


def test_a_camera_that_looks_away_says_nothing_of_lengths(rng: np.random.Generator) -> None:
    taken, away = photo(BOX, CORNER, rng), Rigid.exp(np.array([0, 0, 0, 0, np.pi, 0]))
    seen = sights(BOX, taken, CORNER)
    blind = sights(BOX, Photo.of(taken.gray, taken.camera, away), CORNER)
    assert not len(blind[0].samples)
    for both in ([*seen, *blind], [*blind, *seen]):
        assert stretched(both, CORNER, np.eye(6)).by == stretched(seen, CORNER, np.eye(6)).by


def test_a_model_of_wrong_proportions_is_not_found_and_the_reason_names_them(rng: np.random.Generator) -> None:
    _, _, _, said = fitted(SIZE * [1, 1.17, 1], rng)
    assert said.startswith("not found")


def test_lengths_are_told_in_words() -> None:
    assert str(Stretched([], Rigid(), np.array([0.95, 1.11, 0.95]))) == "17% longer along its y axis"
    assert str(Stretched([], Rigid(), np.array([1.06, 1.06, 0.89]))) == "16% shorter along its z axis"
    assert Stretched([], Rigid(), np.array([1.0, 1.1, 1.0])).by == pytest.approx(0.1)


def test_lines_meet_steps_of_one_sign_that_are_strong_and_close(rng: np.random.Generator) -> None:
    offset, slope = rng.uniform(-12, 12, (60, 5)), rng.normal(size=(60, 5))
    offset[rng.random((60, 5)) < 0.3] = slope[rng.random((60, 5)) < 0.1] = np.nan
    first, moved = np.array([0, 7, 30]), rng.normal(0, 4, (4, 60))
    found = met(offset, slope, first, moved, on=2.0, faint=0.4, around=6.0)
    for t, line in np.ndindex(4, 3):
        signs: list[set[float]] = []
        for i in range(first[line], [*first, 60][line + 1]):
            close = np.abs(offset[i] - offset[i][:, None]) < 6.0
            strongest = np.nan_to_num(np.where(close, np.abs(slope[i]), 0.0)).max(axis=1)
            on = (np.abs(slope[i]) > 0.4 * strongest) & (np.abs(offset[i] - moved[t, i]) < 2.0)
            signs.append(set(np.sign(slope[i][on])))
        share = max(np.mean([sign in some for some in signs]) for sign in (1.0, -1.0))
        assert found[t, line] == pytest.approx(share)


@pytest.mark.parametrize(("factor", "excused"), [(1.05, True), (1.17, False)])
def test_beside_bands_proportions_a_band_s_width_away_say_nothing(
    factor: float, excused: bool, rng: np.random.Generator
) -> None:
    """A twentieth of the box is 4 px, which lines may lie off on the other side of a band; a sixth is 12 px."""
    far, part = view(BOX, (0.5, 0.7, 1.0), away=8.0), Part.of(box([0, 0, 0], SIZE * [1, factor, 1]))
    shots = photo(BOX, far, rng)
    pose = refine_pose(part, [shots], far).pose.world_from_part
    drawn = sights(part, shots, pose)
    other = stretched(drawn, pose, np.eye(6))
    assert other.by == pytest.approx(factor - 1, abs=0.03)
    assert (other.moved_px(drawn, pose) < FARTHEST_PX) is excused
    plain, beside = (judged_support(drawn, pose, np.eye(6), chosen=3, scatter=0.05, bands=b) for b in (False, True))
    assert plain.gain > 0
    assert (beside.gain == 0) is excused
