"""Nearly symmetric parts, or parts nearly equal to their mirror image, are not mistaken for these."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import calibration_bench, machined_bracket
from cadcam.cad.parts.shape import circle, extruded, filled
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE
from cadcam.locate.in_photos import _AS_GOOD, Trial, _ranked, locate_part
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import FOUND
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality import support
from cadcam.locate.quality.apart import Apart, away, shown_less
from cadcam.locate.refine.answer import DOUBT
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.rivals import Rivals, _Rival
from cadcam.render import open_renderer
from cadcam.render.view import Scene

from ..cad.solids import box, prism

CAMERA = Camera.from_focal((640, 480), 1000.0)
BAY = 24.0
RNG_SIGMA = 2 / 255


@cache
def comb() -> Mesh:
    """Return seven equal teeth on a bar, and a block on one of its ends."""
    teeth = [box([BAY * k, 0, 10], [BAY * k + 12, 30, 26]) for k in range(7)]
    return merge([box([0, 0, 0], [BAY * 6 + 12, 30, 10]), *teeth, box([-14, 0, 0], [0, 30, 40])])


@cache
def hooked() -> Mesh:
    """Return a plate that is its own mirror image but for a block that stands aside of both its middles."""
    posts = [box([x, y, 12], [x + 16, y + 16, 24]) for x in (6, 98) for y in (6, 58)]
    return merge([box([0, 0, 0], [120, 80, 12]), *posts, box([34, 6, 12], [58, 26, 36])])


def grillage() -> Mesh:
    """Return a deck with girders and web frames at even pitches of 745 and 1333 mm, and what tells its ends apart."""
    girders = [box([0, 740 + 745 * k, 15], [4000, 752 + 745 * k, 260]) for k in range(3)]
    frames = [box([200 + 1333 * k, 0, 15], [212 + 1333 * k, 3000, 900]) for k in range(3)]
    ends = [box([0, -12, 0], [4000, 0, 1200]), box([3300, 2300, 15], [3500, 2500, 300])]
    return merge([box([0, 0, 0], [4000, 3000, 15]), *girders, *frames, *ends])


@cache
def hood() -> Mesh:
    """Return a hood from a rectangle to a circle, 1.2 mm off its middle: nearly itself turned by a half."""
    t = np.arange(48) * 2 * np.pi / 48
    opening = np.column_stack([1.0 + 45 * np.cos(t), 0.6 + 45 * np.sin(t), np.full(48, 90.0)])
    foot = np.array([[60.0, 50, 0], [-60, 50, 0], [-60, -50, 0], [60, -50, 0]])
    hull = ConvexHull(np.concatenate([opening, foot]))
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    return Mesh.single(hull.points, np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices))


@cache
def part_of(mesh: Mesh) -> Part:
    """Return the part, whose look-alikes are found once."""
    return Part.of(mesh)


def photo_of(mesh: Mesh, pose: Rigid) -> Photo:
    image = open_renderer(Scene.of(mesh)).render(CAMERA, pose).image.mean(axis=2)
    noisy = image * 0.8 + RNG_SIGMA * np.random.default_rng(0).standard_normal(image.shape)
    return Photo.of(np.clip(noisy, 0, 1).astype(np.float32), CAMERA)


def looking(mesh: Mesh) -> Rigid:
    middle = mesh.bounds.mean(axis=0)
    return Rigid.look_at(middle + np.array([120.0, -330.0, 330.0]), middle)


@pytest.mark.parametrize("n", [pytest.param(-1, marks=pytest.mark.slow), 1])
def test_a_lattice_is_told_from_itself_one_bay_on(n: int) -> None:
    """Ask of a pose one bay off, as if it had been found: what comes back is the right one."""
    part, pose = part_of(comb()), looking(comb())
    shifts = [like.motion.translation for like in part.likenesses if not like.mirrored]
    assert any(np.allclose(s, [n * BAY, 0, 0], atol=1.0) for s in shifts)
    photo = photo_of(comb(), pose)
    wrong = refine_pose(part, [photo], pose @ Rigid(translation=np.array([n * BAY, 0.0, 0.0])))
    asked = Rivals(part, [photo], FREE, EDGES, 0)
    right = asked.checked(wrong)
    corners = part.scene.mesh.vertices
    apart = CAMERA.project(right.pose.world_from_part @ corners) - CAMERA.project(pose @ corners)
    assert right.found
    assert np.abs(apart).max() < 0.5
    kept = refine_pose(part, [photo], pose)
    assert asked.checked(kept).pose is kept.pose
    assert asked.holds(kept, wrong.pose.world_from_part)
    assert not asked.holds(wrong, kept.pose.world_from_part)
    assert asked.prefers(kept, wrong)
    assert not asked.prefers(wrong, kept)
    assert not asked.prefers(kept, kept)


def test_a_pose_is_preferred_only_if_its_own_lines_with_room_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where the steps that the fits have measured, of crowded lines most of all, say that it is the right one."""
    part, pose = part_of(comb()), looking(comb())
    photo = photo_of(comb(), pose)
    bay = pose @ Rigid(translation=np.array([BAY, 0.0, 0.0]))
    kept, wrong = refine_pose(part, [photo], pose), refine_pose(part, [photo], bay)
    monkeypatch.setattr(Rivals, "holds", lambda _, found, __: found is wrong)
    asked = Rivals(part, [photo], FREE, EDGES, 0)
    assert not asked.prefers(wrong, kept)
    monkeypatch.setattr(Rivals, "holds", lambda _, found, __: found is kept)
    assert asked.prefers(kept, wrong)


@pytest.mark.parametrize(
    ("mesh", "which"),
    [
        (comb(), 5),
        (hooked(), 3),
        *(pytest.param(mesh, k, marks=pytest.mark.slow) for mesh, k in ((comb(), 0), (comb(), 8), (hooked(), 0))),
    ],
)
def test_a_look_alike_is_told_from_the_part_however_well_it_fits(mesh: Mesh, which: int) -> None:
    """From a start turned over, or a bay off, a pose is found that nothing puts in doubt but its own missing lines."""
    part, pose = part_of(mesh), looking(mesh)
    photo = photo_of(mesh, pose)
    turned = pose @ part.likenesses[which].motion.inv
    rivals = Rivals(part, [photo], FREE, EDGES, 0)
    wrong = refine_pose(part, [photo], turned)
    assert wrong.quality > DOUBT[1]
    assert rivals.contested(wrong).any()
    found = locate_part(part, [photo], turned)
    apart = CAMERA.project(found.pose.world_from_part @ mesh.vertices) - CAMERA.project(pose @ mesh.vertices)
    assert found.found
    assert np.abs(apart).max() < 0.5
    assert not rivals.contested(found).any()


def test_of_two_poses_that_show_as_much_the_one_that_fits_far_closer_leads() -> None:
    """The half-turn's hypothesis scores higher, and as many of its lines are met, but beside the photo's steps."""
    mesh = hood()
    pose = Rigid.look_at(np.array([120.0, -330.0, 330.0]), mesh.bounds.mean(axis=0))
    part, photo = part_of(mesh), photo_of(mesh, pose)
    right, turned = (refine_pose(part, [photo], pose @ Rigid.exp([0, 0, 0, 0, 0, angle])) for angle in (0.0, np.pi))
    assert turned.quality > max(FOUND, right.quality - _AS_GOOD)
    assert _ranked([Trial(45.0, turned), Trial(38.0, right)])[0].location is right
    assert _ranked([Trial(45.0, right), Trial(38.0, turned)])[0].location is right


def test_edges_that_are_off_by_more_than_light_explains_are_led_by_those_of_any_found_pose_that_fit() -> None:
    """Of a part with a wood's grain one 3.5 px beside had quality 0.79, its edges off by 0.8 px; the right one 0.6."""
    mesh = hood()
    pose = looking(mesh)
    right = refine_pose(part_of(mesh), [photo_of(mesh, pose)], pose)
    m = right.matches
    grain = replace(right, quality=0.9, off_px=0.8, matches=replace(m, offset=m.offset + 0.8))
    least = replace(right, quality=FOUND)
    assert _ranked([Trial(45.0, grain), Trial(38.0, least)])[0].location is least
    for other in (replace(least, quality=0.45), replace(least, matches=replace(m, offset=m.offset + 0.5))):
        assert _ranked([Trial(45.0, grain), Trial(38.0, other)])[0].location is grain
    as_light_does = replace(grain, off_px=0.0)
    assert _ranked([Trial(45.0, as_light_does), Trial(38.0, least)])[0].location is as_light_does


def test_turns_that_no_line_in_view_tells_apart_are_alternatives() -> None:
    """Of a plate of sixteen sides with a block beneath, seen from above: turned by quarters it looks the same."""
    mesh = merge([prism(16, radius=60.0, height=40.0), box((20, -6, -14), (44, 6, 0))])
    part, pose = part_of(mesh), looking(mesh)
    photo = photo_of(mesh, pose)
    found = Rivals(part, [photo], FREE, EDGES, 0).checked(refine_pose(part, [photo], pose))
    turns = [(pose.inv @ other.pose.world_from_part).log()[3:] for other in found.alternatives]
    quarters = sorted(round(float(np.degrees(turn[2])) / 90) % 4 for turn in turns)
    assert len(part.symmetries) == 1
    assert quarters == [1, 2, 3]
    sigma = np.sqrt(np.linalg.eigvalsh(found.pose.covariance[3:5, 3:5])[-1])
    assert max(np.linalg.norm(turn[:2]) for turn in turns) < 5 * np.sqrt(2) * sigma


def test_where_nothing_shows_which_way_round_the_part_is_the_other_way_is_an_alternative() -> None:
    """Of a comb without the block that tells its ends apart either end may be the one."""
    part, pose = part_of(comb()), looking(comb())
    photo = photo_of(merge([comb().subset([k]) for k in range(8)]), pose)
    found = locate_part(part, [photo], pose)
    turned = found.pose.world_from_part @ part.likenesses[0].motion
    others = [other.pose.world_from_part.inv @ turned for other in found.alternatives]
    assert found.quality > DOUBT[1]
    assert min(np.linalg.norm((one @ np.array([72.0, 15.0, 10.0])) - [72, 15, 10]) for one in others) < 2.0
    assert re.search("[1-9] other poses? looks? as good", found.reason)


def test_a_body_that_is_left_out_as_missing_still_tells_whose_lines_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a wrong pose just the body is missing that tells it from the right one."""
    pose = looking(hooked())
    photo = photo_of(merge([hooked().subset([k]) for k in range(5)]), pose)
    sight = Sight.of(part_of(hooked()), photo, pose, step_px=EDGES.step_px, reach_px=2 * EDGES.reach_px)
    monkeypatch.setattr(support, "_WITHOUT", (0.0, 1.1))
    told = support.judged_support([sight], pose, np.eye(6), chosen=0, scatter=0.0)
    of_block = (told.judged.p[:, 2] > 24.1) & ~told.judged.shown
    assert told.without > 0
    assert of_block.sum() >= 12


def test_places_know_how_far_the_edges_of_a_look_alike_pass() -> None:
    """A comb turned about the upright has its edges on its own, but for the block: 26 mm of bar less, 24 mm aside."""
    part = part_of(comb())
    turned = next(k for k, like in enumerate(part.likenesses) if np.allclose(like.motion.translation, [156, 30, 0]))
    common, own = [BAY, 15.0, 10.0], [-14.0, 15.0, 40.0]
    near, far = part.own_edges.at(np.array([common, own]))[turned]
    assert near < 0.5
    assert far == pytest.approx(np.hypot(14.0, 14.0), abs=1.0)


def test_own_lines_that_are_shown_less_are_told_reading_by_reading() -> None:
    """Shown: all common lines, and of the own ones of the three readings none, all, and none of too few."""
    own = np.zeros((3, 200), bool)
    own[0, :40] = own[1, 40:80] = own[2, :5] = True
    assert shown_less(own, np.arange(200) >= 40).tolist() == [True, False, False]


def test_few_lines_decide_only_where_they_are_clearer() -> None:
    assert Apart(12, 0.3, 12, 0.75).against
    assert not Apart(8, 0.3, 13, 0.75).against
    assert Apart(8, 0.0, 13, 1.0).against
    assert Apart(8, 0.0, 13, 1.0).open
    assert not Apart(5, 0.0, 40, 1.0).against


def test_own_places_are_those_that_no_other_is_near_to(rng: np.random.Generator) -> None:
    """Farther than 4 px, to the 2 px of a cell on each axis; what lies far outside, or nowhere, is near to none."""
    q, others = rng.uniform(0, 200, (400, 2)), rng.uniform(0, 200, (60, 2))
    nearest = np.linalg.norm(q[:, None] - others, axis=2).min(axis=1)
    nowhere = np.array([[np.nan, 1.0], [1e12, -1e12]])
    own = away(q, np.concatenate([others, nowhere]))
    assert not own[nearest <= 4].any()
    assert own[nearest > 6 * np.sqrt(2)].all()
    assert 0.1 < own.mean() < 0.9
    assert away(q, nowhere).all()
    assert away(q[:0], others).shape == (0,)


def test_the_part_of_the_other_hand_is_refused_and_the_right_one_is_not() -> None:
    part, pose = part_of(hooked()), looking(hooked())
    best = next(like for like in part.likenesses if like.mirrored)
    assert 0.6 < best.share < 0.995
    right = locate_part(part, [photo_of(hooked(), pose)], pose)
    assert right.found
    assert "mirror" not in right.reason
    other = part.mirrored.scene.mesh
    there = photo_of(other, pose @ best.motion)
    wrong = refine_pose(part, [there], pose)
    told = Rivals(part, [there], FREE, EDGES, 0).checked(wrong)
    assert not told.found
    assert "mirror image" in told.reason


def flange() -> Mesh:
    """Return a plate with a ring of holes, which a slot through its rim leaves hardly unlike its mirror image."""
    angles = 2 * np.pi * np.arange(6) / 6
    holes = [circle((34 * np.cos(a), 34 * np.sin(a)), 4.5, 32) for a in angles]
    slot = np.array([(-6, -14), (14, -14), (14, -6), (-6, -6)], float)
    plate = extruded([filled(circle((0, 0), 46, 128), [*holes, slot])], 0, 9, name="flange", color=None)
    rim = extruded([filled(circle((0, 3), 20, 96), [circle((0, 3), 15, 96)])], 9, 26, name="rim", color=None)
    return merge([plate, rim])


def test_a_turned_part_is_not_taken_for_one_of_the_other_hand() -> None:
    """Turned by a hole, and mirrored, the flange shows all that it lacks where it was found: the former is likelier."""
    mesh = flange()
    part, middle = part_of(mesh), mesh.bounds.mean(axis=0)
    pose = Rigid.look_at(middle + np.array([62.0, -168.0, 168.0]), middle)
    photo = photo_of(mesh, pose)
    asked = Rivals(part, [photo], FREE, EDGES, 0)
    for like in [like for like in part.likenesses if not like.mirrored][1:5:2]:
        wrong = refine_pose(part, [photo], pose @ like.motion.inv)
        told = asked.checked(wrong)
        apart = CAMERA.project(told.pose.world_from_part @ mesh.vertices) - CAMERA.project(pose @ mesh.vertices)
        assert told.found
        assert np.abs(apart).max() < 0.5


@pytest.mark.parametrize(("more", "other_hand"), [(0.05, False), (0.15, True)])
def test_one_of_the_other_hand_is_told_where_clearly_more_of_it_shows(
    more: float, other_hand: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    part, pose = part_of(hooked()), looking(hooked())
    photo = photo_of(hooked(), pose)
    found, shown = refine_pose(part, [photo], pose), Apart(40, 0.1, 40, 0.8)
    hands = {like.mirrored: like for like in part.likenesses}
    both = [
        _Rival(hands[False], pose, shown, contested=True),
        _Rival(hands[True], pose, replace(shown, others_shown=0.8 + more), contested=True),
    ]
    monkeypatch.setattr(Rivals, "_rivals", lambda *given: both)
    told = Rivals(part, [photo], FREE, EDGES, 0).checked(found)
    assert told.found != other_hand
    assert ("mirror image" in told.reason) == other_hand


def test_what_only_lies_in_the_dark_is_said_to_be_open() -> None:
    """The block that tells the hand is cut off: either may be seen, and the pose stays."""
    plain = merge([hooked().subset([k]) for k in range(5)])
    part, pose = part_of(hooked()), looking(hooked())
    photo = photo_of(plain, pose)
    found = refine_pose(part, [photo], pose)
    told = Rivals(part, [photo], FREE, EDGES, 0).checked(found)
    assert told.pose is found.pose
    assert "either may be seen" in told.reason


def test_a_lattice_s_pitch_is_told_to_less_than_its_plates_are_thick() -> None:
    """In a picture of one bay a plate's thickness is many px: a rival as far off as that is none."""
    shifts = [like.motion.translation for like in part_of(grillage()).likenesses if not like.mirrored]
    for pitch in (745.0, -745.0):
        assert any(np.allclose(s, [0, pitch, 0], atol=0.5) for s in shifts)


def test_a_part_turned_over_in_its_own_place_is_a_likeness() -> None:
    """Many shifts along the bench's rails lay as many points on points as the one that turns it about its middle."""
    mesh = calibration_bench()
    turned = Rigid(np.diag([-1.0, -1.0, 1.0]), 2 * mesh.bounds.mean(axis=0) * [1, 1, 0])
    corners = mesh.vertices
    off = [np.abs(like.motion @ corners - turned @ corners).max() for like in part_of(mesh).likenesses]
    assert min(off) < 1.0


def test_what_is_its_own_mirror_image_has_no_other_hand() -> None:
    likenesses = Part.of(machined_bracket()).likenesses
    assert not any(like.mirrored for like in likenesses)


@pytest.mark.parametrize("away", [0.0, 20.0])
def test_lines_drawn_from_elsewhere_make_no_other_reading(away: float) -> None:
    """A lattice whose ends are out of the picture looks the same one bay on: it stays where it was found.

    Drawn from some way off other lines are hidden than at the pose; these would be the other bay's alone.
    """
    mesh = comb()
    part = part_of(mesh)
    near = Camera.from_focal((240, 180), 1000.0)
    middle = np.array([BAY * 3 + 6, 15.0, 20.0])
    pose = Rigid.look_at(middle + np.array([30.0, -140.0, 160.0]), middle)
    image = open_renderer(Scene.of(mesh)).render(near, pose).image.mean(axis=2)
    photo = Photo.of(np.asarray(image * 0.8, np.float32), near)
    found = refine_pose(part, [photo], pose)
    aside = pose @ Rigid(translation=np.array([away / 2, away, -away]))
    sights = [Sight.of(part, photo, aside, step_px=EDGES.step_px, reach_px=2 * EDGES.reach_px)]
    assert found.found
    assert Rivals(part, [photo], FREE, EDGES, 0).checked(found, sights).pose is found.pose
