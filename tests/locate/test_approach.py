"""Approaching a part from a rough start: closed loops over renders, and the clean ship block's own starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import merge
from cadcam.cad.parts import machined_bracket, shape
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Division
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture
from cadcam.locate import in_photos
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search.approach import REACH, Reach, approach
from cadcam.locate.search.hypothesis import Hypothesis

from ..cad.solids import box
from .photos import CAMERA, error_px, photo, view

BRACKET = Part.of(machined_bracket())
POSE = view(BRACKET, (1.0, 0.7, 0.9))
# A pose is right if no vertex is off by more: edge refinement takes up what is up to 8 px off.
RIGHT_PX = 4.0


def off(part: Part, pose: Rigid, turn_deg: tuple[float, float, float], shift: float, depth: float) -> Rigid:
    """Return a pose turned about the part's middle, then shifted (mm along x) and set back (share of its depth)."""
    middle = pose @ part.aspects.centre
    R = so3.exp(np.radians(turn_deg)) @ pose.rotation
    return Rigid(R, middle * (1 + depth) + [shift, 0, 0] - R @ part.aspects.centre)


@pytest.mark.parametrize(
    ("turn", "shift", "depth"),
    [((18, 0, 0), 0, 0), ((0, -18, 0), 0, 0), ((0, 0, 18), 0, 0), ((0, 0, 0), 15, 0.09), ((-8, 9, 7), -12, -0.08)],
)
def test_a_start_within_reach_ends_at_the_part(
    turn: tuple[float, float, float], shift: float, depth: float, rng: np.random.Generator
) -> None:
    found = approach(BRACKET, [photo(BRACKET, POSE, rng)], off(BRACKET, POSE, turn, shift, depth))
    assert error_px(BRACKET, CAMERA, found[0].world_from_part, POSE) < RIGHT_PX


def test_skew_and_a_strong_lens_change_nothing(rng: np.random.Generator) -> None:
    camera = Camera.from_focal((640, 480), 800.0, fy=850.0, skew=15.0, lens=Division(-0.3))
    shown = photo(BRACKET, POSE, rng, camera=camera)
    found = approach(BRACKET, [shown], off(BRACKET, POSE, (6, -7, 5), 10, 0.05))
    assert error_px(BRACKET, camera, found[0].world_from_part, POSE) < RIGHT_PX


@pytest.mark.parametrize(("away", "aside"), [(130.0, 0.0), (4.2, 1e5)])
def test_a_part_far_from_the_camera_or_from_its_origin_is_approached_as_well(
    away: float, aside: float, rng: np.random.Generator
) -> None:
    """A long lens tells depth by size alone; a part drawn in a ship's frame turns about a place far outside of it."""
    part = Part.of(machined_bracket().transformed(Rigid(translation=np.array([aside, -0.4 * aside, 0.3 * aside]))))
    camera, pose = Camera.from_focal((640, 480), 900.0 * away / 4.2), view(part, (1.0, 0.7, 0.9), away=away)
    found = approach(part, [photo(part, pose, rng, camera=camera)], off(part, pose, (-8, 9, 7), 12, -0.06))
    assert error_px(part, camera, found[0].world_from_part, pose) < RIGHT_PX


def test_two_cameras_approach_together(rng: np.random.Generator) -> None:
    world_from_part = Rigid(so3.exp([0.2, -0.3, 0.1]), np.array([30.0, -20.0, 15.0]))
    poses = [POSE, view(BRACKET, (0.2, 1.0, 0.8))]
    photos = [
        Photo.of(photo(BRACKET, pose, rng).gray, CAMERA, pose @ world_from_part.inv, name=f"camera {k}")
        for k, pose in enumerate(poses)
    ]
    found = approach(BRACKET, photos, off(BRACKET, world_from_part, (6, -6, 5), 6, 0.0))[0].world_from_part
    for shown, pose in zip(photos, poses, strict=True):
        assert error_px(BRACKET, CAMERA, shown.camera_from_world @ found, pose) < RIGHT_PX


def test_a_part_on_a_floor_stays_on_it(rng: np.random.Generator) -> None:
    world_from_part = POSE  # the world is the camera's frame; the floor is the part's own
    floor = Freedom.planar([0, 0, 1], frame="part")
    start = world_from_part @ Rigid(so3.exp([0, 0, np.radians(12)]), np.array([9.0, -7.0, 0.0]))
    found = approach(BRACKET, [photo(BRACKET, POSE, rng)], start, freedom=floor)[0].world_from_part
    moved = world_from_part.inv @ found
    assert error_px(BRACKET, CAMERA, found, POSE) < RIGHT_PX
    assert abs(moved.translation[2]) < 1e-9 * 500  # rounding of a few hundred mm
    assert np.allclose(moved.rotation[2], [0, 0, 1], atol=1e-9)


def test_hypotheses_are_ranked_and_apart(rng: np.random.Generator) -> None:
    found = approach(BRACKET, [photo(BRACKET, POSE, rng)], off(BRACKET, POSE, (5, 5, 0), 5, 0.02))
    scores = [h.score for h in found]
    assert scores == sorted(scores, reverse=True)
    middles = np.array([h.world_from_part.matrix for h in found])
    assert all(np.abs(middles[0] - other).max() > 1e-4 for other in middles[1:])


def test_a_start_outside_the_photo_is_refused(rng: np.random.Generator) -> None:
    aside = Rigid(translation=[5000.0, 0, 0]) @ POSE
    behind = Rigid(translation=[0, 0, -3000.0]) @ POSE
    for start in (aside, behind):
        with pytest.raises(NothingInView, match="outside of every photo"):
            approach(BRACKET, [photo(BRACKET, POSE, rng)], start)


def test_a_start_from_which_one_face_fills_the_picture_is_told_so(rng: np.random.Generator) -> None:
    """Its middle is in view: it was said to be outside of every photo."""
    plate = Part.of(shape.box((-500, -500, 0), (500, 500, 10), name="plate"))
    start = Rigid.look_at((0.0, 0.0, 100.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0))
    tele = Photo.of(rng.normal(0.5, 0.1, (480, 640)).clip(0, 1), Camera.from_focal((640, 480), 4000.0))
    with pytest.raises(NothingInView, match=r"none of the part's edges into a photo, its middle at \(0, 0, 95\) mm"):
        approach(plate, [tele], start)


@pytest.mark.parametrize("wrong", [{"rotation_deg": -1.0}, {"depth": 0.9}, {"shift_px": float("nan")}])
def test_a_reach_that_is_none_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadValue, match=next(iter(wrong))):
        replace(Reach(), **wrong)


def clean_block(shared: Callable[[str], Path], level: str, every: int) -> list[float]:
    """Return the error (px) of the first hypothesis for some of the clean ship block's starts."""
    folder = shared("data/shipblock_clean")
    part, camera = Part.of(read_model(folder / "model.obj", unit="m")), Camera((768, 576), np.loadtxt(folder / "K.txt"))
    true = {int(r[0]): pose_of(r[1:]) for r in np.loadtxt(folder / "gt.csv", delimiter=",", skiprows=1)}
    starts = np.loadtxt(folder / "starts.txt")[::every]
    photos = {
        f: Photo.of(read_picture(folder / level / "images" / f"{f:04d}.png"), camera)
        for f in {int(s[0]) for s in starts}
    }
    return [
        error_px(part, camera, approach(part, [photos[int(s[0])]], pose_of(s[1:]))[0].world_from_part, true[int(s[0])])
        for s in starts
    ]


def pose_of(row: np.ndarray) -> Rigid:
    return Rigid(so3.nearest(row[:9].reshape(3, 3)), 1000 * row[9:])


def test_starts_of_the_clean_ship_block_end_where_refinement_takes_over(shared: Callable[[str], Path]) -> None:
    errors = clean_block(shared, "n3", 12)
    assert np.mean(np.array(errors) < 8.0) == 1.0
    assert np.mean(np.array(errors) < RIGHT_PX) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("level", ["n0", "n3", "n8"])
def test_97_percent_of_all_starts_end_where_refinement_takes_over(shared: Callable[[str], Path], level: str) -> None:
    assert np.mean(np.array(clean_block(shared, level, 1)) < 5.0) >= 0.97


def test_the_mirror_pose_of_a_flat_view_is_tried(rng: np.random.Generator) -> None:
    """From afar a plate looks nearly the same tilted the other way, 50 degrees from the start: out of its reach."""
    plate = Part.of(box([0, 0, 0], [120, 70, 2]))
    pose = view(plate, (0.35, -0.3, 1.0), away=7.0)
    middle = np.array([60.0, 35, 1])
    sight = (pose @ middle) / np.linalg.norm(pose @ middle)
    mirrored = (np.eye(3) - 2 * np.outer(sight, sight)) @ pose.rotation @ np.diag([1.0, 1, -1])
    start = Rigid(mirrored, pose @ middle - mirrored @ middle)
    found = approach(plate, [photo(plate, pose, rng)], start, reach=Reach(rotation_deg=3.0))
    off = [np.linalg.norm(CAMERA.project(h.world_from_part @ middle) - CAMERA.project(pose @ middle)) for h in found]
    turned = [np.degrees(np.linalg.norm((h.world_from_part.inv @ pose).log()[3:])) for h in found]
    assert min(t for t, px in zip(turned, off, strict=True) if px < 5) < 8


@pytest.mark.parametrize(
    ("start", "why"),
    [
        (Rigid(translation=[0, 0, -400]) @ POSE, "in one unit"),
        (Rigid(translation=[0, 0, -2000]) @ POSE, "behind it"),
        (Rigid(translation=[4000, 0, 0]) @ POSE, "beside its picture"),
    ],
)
def test_a_start_outside_says_where_it_is_and_what_may_be_wrong(
    start: Rigid, why: str, rng: np.random.Generator
) -> None:
    x, y, z = start @ BRACKET.aspects.centre
    with pytest.raises(NothingInView, match=why) as caught:
        approach(BRACKET, [photo(BRACKET, POSE, rng)], start)
    assert f"({x:.4g}, {y:.4g}, {z:.4g}) mm" in str(caught.value)


BAY = 100.0  # mm
LADDER = merge(
    [
        shape.box((-600, -60, -10), (600, 60, 0), name="plate"),
        *(shape.box((x - 6, -40, 0), (x + 6, 40, 50), name=f"rib {k}") for k, x in enumerate(np.arange(-5, 6) * BAY)),
    ]
)


def test_of_equal_bays_the_one_within_reach_of_the_start_is_found(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """What a hypothesis leads to one bay on fits as well; it is an alternative."""
    part = Part.of(LADDER)
    pose = Rigid.look_at(np.array([60.0, -260.0, 320.0]), np.array([0.0, 0.0, 10.0]))
    on = Rigid(np.eye(3), np.array([BAY, 0.0, 0.0]))
    monkeypatch.setattr(in_photos, "approach", lambda *_, **__: [Hypothesis(pose @ on, 10.0, 4.0)])
    shown = photo(part, pose, rng)
    found = in_photos.locate_part(part, [shown], pose @ Rigid.exp(np.array([1.0, -1.0, 1.0, 2e-3, 0, 1e-3])))
    assert found.found
    assert error_px(part, CAMERA, found.pose.world_from_part, pose) < RIGHT_PX
    bays = [(pose.inv @ other.pose.world_from_part).translation[0] / BAY for other in found.alternatives]
    assert bays == pytest.approx([1.0], abs=0.02)


def test_a_start_holds_what_is_twice_as_far_off_as_it_may_be() -> None:
    middle, focal = POSE @ BRACKET.aspects.centre, float(CAMERA.K[0, 0])
    away = float(np.linalg.norm(middle))
    side = np.cross(middle, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(middle, [0.0, 1.0, 0.0]))
    reach, shown = Reach(rotation_deg=10.0, shift_px=20.0, depth=0.1), Photo.of(np.zeros((480, 640)), CAMERA)
    for share, holds in ((1.99, True), (2.01, False)):
        others = (
            off(BRACKET, POSE, (0, 10.0 * share, 0), 0, 0),
            off(BRACKET, POSE, (0, 0, 0), 0, -0.1 * share),
            Rigid(POSE.rotation, POSE.translation + 20.0 * share * away / focal * side),
        )
        assert [reach.holds(BRACKET.aspects.centre, [shown], POSE, other) for other in others] == [holds] * 3


def test_a_start_at_the_camera_itself_holds_nothing_but_itself() -> None:
    """As of a hollow part with the camera in its middle, told to be there: no distance to be a share of."""
    shown, middle = Photo.of(np.zeros((480, 640)), CAMERA), Rigid(translation=-BRACKET.aspects.centre)
    assert REACH.holds(BRACKET.aspects.centre, [shown], middle, middle)
    assert not REACH.holds(BRACKET.aspects.centre, [shown], middle, Rigid(translation=[0.0, 0.0, 1.0]) @ middle)
