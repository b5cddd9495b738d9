"""Screws flush with their plate: none of their edges has room to be counted, but pixels tell them from holes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cadcam.arrays import Array, Longs
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box, circle, extruded, filled
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.image.sensor.presets import preset
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.light import FittedLight
from cadcam.locate.refine.refinement import refine_pose
from cadcam.render.photograph import Photographer
from cadcam.render.view import Scene
from cadcam.verify.bodies.openness import Sky
from cadcam.verify.bodies.tones import _SurfacePixels
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from . import scene
from .scene import photographed
from .screwed import CAMERA, HIGH, POSE, RADIUS, SCREWS, part, screwed

GROUND = (0.10, 0.12, 0.14)
LIMITS = (Limit(Quantity.PRESENCE, 0.0), Limit(Quantity.POSITION, 0.5))
ASKED = Tolerances(tuple(Feature(name, Selection(name), LIMITS) for name in SCREWS))
WHOLE = (slice(0, CAMERA.height), slice(0, CAMERA.width))


class OpenBy(Sky):
    """A sky of which every surface sees the same share."""

    def __init__(self, share: float) -> None:
        object.__setattr__(self, "share", share)

    def of_groups(self, q: Array, group: Longs, n: int) -> Array:
        return np.full(n, self.share)


def taken(mesh: Mesh, rng: np.random.Generator, *, dark: bool = False) -> Photo:
    """Return a photo in the light of a hall; dark: the screws are black, not of the CAD's grey."""
    if dark:
        mesh = replace(mesh, part_colors=np.where([[n in SCREWS] for n in mesh.part_names], 0.05, mesh.part_colors))
    view = Photographer(Scene.of(mesh, edges=NO_EDGES))
    picture = view.photograph(CAMERA, POSE, sensor=preset("global-shutter"), rng=rng, samples=8, background=GROUND)
    return Photo.of(to_gray(picture), CAMERA, POSE)


@cache
def whole() -> Photo:
    """Return a photo of the part with all its screws."""
    return taken(screwed(), np.random.default_rng(0))


def without(name: str) -> Mesh:
    mesh = screwed()
    return mesh.select(mesh.part != mesh.part_names.index(name))


@pytest.fixture(scope="module")
def two_of_three() -> tuple[Photo, Inspection]:
    photo = taken(without("screw 2"), np.random.default_rng(4))
    return photo, inspect(part(), [photo], Rigid())


def test_a_flush_screw_that_is_there_is_seen_though_not_where(two_of_three: tuple[Photo, Inspection]) -> None:
    _, found = two_of_three
    for name in ("screw 1", "screw 3"):
        screw = found.feature(name)
        assert screw.presence.expected == 0
        assert screw.presence.log_ratio >= found.passable
        assert (screw.state, screw.why) == (State.UNCLEAR, Unclear.SHOWN)


def test_a_flush_screw_that_is_gone_is_missing(two_of_three: tuple[Photo, Inspection]) -> None:
    _, found = two_of_three
    assert found.feature("screw 2").presence.expected == 0
    assert found.feature("screw 2").state is State.MISSING


def test_the_verdict_says_what_of_a_flush_screw_is_seen(two_of_three: tuple[Photo, Inspection]) -> None:
    """There: its surfaces; where it is, is undecided. Gone: what is behind it."""
    photo, _ = two_of_three
    verdict = verify_part(part(), [photo], refine_pose(part(), [photo], Rigid()), ASKED)
    said = {(j.feature, j.limit.quantity): j for j in verdict.judgements}
    there, gone = said["screw 1", Quantity.PRESENCE], said["screw 2", Quantity.PRESENCE]
    assert (there.verdict, there.reason) == (Verdict.PASS, "its surfaces are seen")
    assert (gone.verdict, gone.reason) == (Verdict.FAIL, "missing: what is behind it is seen")
    where = said["screw 1", Quantity.POSITION]
    assert where.verdict is Verdict.UNDECIDED
    assert where.reason == Unclear.SHOWN.value


def test_a_head_and_its_socket_are_two_patches_and_a_cone_is_few() -> None:
    """Head and socket face one way; the cone of a hole has 40 sides, each of them a surface of its own."""
    photo, body = whole(), screwed().part_names.index("screw 2")
    shown = ShownFaces.of(part(), photo, Rigid())
    x, y = SCREWS["screw 2"]
    head, socket = ([x + 0.75 * RADIUS, y, HIGH], [x, y, HIGH - 0.51 * RADIUS])
    (a, b), (c, d) = np.rint(CAMERA.project(POSE @ np.array([head, socket]))).astype(int)
    of = shown.face[[b, d], [a, c]]
    assert len(set(shown.surface[of])) == 1
    assert len(set(shown.patch[of])) == 2
    behind = shown.uncovered(part(), photo, Rigid(), body)
    cone = np.unique(behind.face[shown.shows(body)])
    cone = cone[np.abs(behind.normal[cone, 2] - 0.7) < 0.1]
    assert len(set(behind.surface[cone])) > 15
    assert len(set(behind.patch[cone])) < 10
    assert not set(behind.patch[cone]) & set(shown.patch)


def test_a_hole_that_is_black_all_over_is_no_screw_of_that_tone() -> None:
    """What seven strips of a bore's wall look like, one tone, in a photo whose light is known to 0.19."""
    form = np.append(0.44, np.zeros(8))
    light = FittedLight(form, 1e-4 * np.eye(9), {0: 1.0}, nothing=0.5, scale=0.19, mean=0.39, spread=0.21)
    tones = np.array([0.082, 0.075, 0.080, 0.086, 0.090, 0.090, 0.094])
    turn = np.linspace(0, np.pi, 7)
    wall = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(7)])
    pieces = [np.arange(k, k + 6) for k in range(0, 42, 6)]
    head, hole = (
        _SurfacePixels(normal, np.zeros(42, np.int32), surface, np.zeros((42, 2)), OpenBy(share)).log_density(
            light, tones, pieces
        )
        for normal, surface, share in (
            (np.tile([0.0, 0.0, 1.0], (42, 1)), np.zeros(42, np.int64), 1.0),
            (np.repeat(wall, 6, axis=0), np.repeat(np.arange(7), 6), 0.06),
        )
    )
    assert head < hole


def test_a_black_screw_is_not_taken_for_its_hole(rng: np.random.Generator) -> None:
    """The CAD has it grey: the bottom of a hole would be as dark."""
    found = inspect(part(), [taken(screwed(), rng, dark=True)], Rigid())
    assert all(found.feature(name).state is not State.MISSING for name in SCREWS)
    assert all(found.feature(name).presence.log_ratio > -1 for name in SCREWS)


@pytest.mark.parametrize("tone", [0.05, pytest.param(0.3, marks=pytest.mark.slow), 0.75])
def test_a_screw_under_a_patch_of_one_tone_is_neither_there_nor_gone(tone: float, rng: np.random.Generator) -> None:
    """Whatever that tone: a dark one resembles a hole, a light one a head, but neither as much as a patch."""
    photo, body = whole(), screwed().part_names.index("screw 2")
    patch = ShownFaces.of(part(), photo, Rigid()).shows(body)
    covered = np.where(patch, tone + rng.normal(0, 0.01, patch.shape), photo.gray).astype(np.float32)
    found = inspect(part(), [Photo.of(np.clip(covered, 0, 1), CAMERA, POSE)], Rigid()).feature("screw 2")
    assert found.presence.log_ratio == 0
    assert (found.state, found.why) == (State.UNCLEAR, Unclear.SHORT_EDGES)


@pytest.mark.parametrize("name", list(SCREWS))
def test_the_ground_of_a_hole_sees_little_of_the_sky(name: str) -> None:
    """Of the middle of a disc of radius r at depth d r^2 / (r^2 + d^2) of the light, by cosine, comes through."""
    sky = Sky.of(part(), Photo.of(np.zeros((CAMERA.height, CAMERA.width), np.float32), CAMERA, POSE), Rigid(), WHOLE)
    x, y = SCREWS[name]
    depth = 0.5 * RADIUS  # of the socket, a hexagon between these two circles
    hexagon = [(0.5 * RADIUS * np.cos(a)) ** 2 for a in (0.0, np.pi / 6)]
    high, low = (2 * r2 / (r2 + depth**2) for r2 in hexagon)
    q = CAMERA.project(POSE @ np.array([[x, y, HIGH - 0.01 * RADIUS - depth], [x + 0.75 * RADIUS, y, HIGH]]))
    socket, head = sky.openness(q)
    assert head == 1
    assert min(low, 1) - 2 / 48 <= socket <= high + 2 / 48


def test_a_screw_left_out_takes_nothing_of_the_sky() -> None:
    """Rays go through it, as through nothing: the wall of its hole and the cone above are seen, and see, as without."""
    sky = Sky.of(part(), Photo.of(np.zeros((CAMERA.height, CAMERA.width), np.float32), CAMERA, POSE), Rigid(), WHOLE)
    gone = Part.of(without("screw 2"))
    alone = replace(sky, mesh=gone.scene.mesh, caster=gone.caster)
    across = np.array(SCREWS["screw 2"]) + RADIUS * np.linspace(-0.8, 0.8, 9)[:, None]
    q = CAMERA.project(POSE @ np.column_stack([across, np.full(9, HIGH)]))
    open_ = replace(sky, without=screwed().part_names.index("screw 2")).openness(q)
    np.testing.assert_array_equal(open_, alone.openness(q))
    assert open_.min() < 0.5 < 0.9 < open_.max()


def test_nothing_is_as_open_as_can_be() -> None:
    sky = Sky.of(part(), Photo.of(np.zeros((CAMERA.height, CAMERA.width), np.float32), CAMERA, POSE), Rigid(), WHOLE)
    assert sky.openness(np.array([[1.0, 1.0]])) == 1
    np.testing.assert_array_equal(sky.of_groups(np.zeros((0, 2)), np.zeros(0, np.int64), 2), 1.0)


@pytest.mark.parametrize("shade", [0.7, 0.5, 1.3])
def test_a_body_seen_through_a_hole_alone_is_not_missing_for_its_shadow(shade: float) -> None:
    """Half of what shows of it is in other light, as if it were gone: the border there is the hole's, not its own."""
    color, outline = (0.55, 0.55, 0.6), np.array([(-100, -70), (100, -70), (100, 70), (-100, 70)], float)
    front = extruded([filled(outline, [circle((30, 0), 30, 96)])], 0, 12, name="front", color=color)
    back = box((-4, -60, -60), (90, 60, -50), name="back", color=color)
    deep = box((-90, -60, -120), (33, 60, -110), name="deep", color=color)  # shows in half of the hole without it
    mesh, pose = merge([front, back, deep]), Rigid.look_at((60.0, -80.0, 560.0), (0.0, 0.0, 0.0))
    gray = photographed(mesh, np.random.default_rng(1), pose)
    photo, whole = Photo.of(gray, scene.CAMERA, pose), Part.of(mesh)
    shown = ShownFaces.of(whole, photo, Rigid())
    assert shown.own_border(whole, photo, Rigid(), 1) < 24 < 200 < shown.own_border(whole, photo, Rigid(), 0)
    ends = scene.CAMERA.project(pose @ np.array([[33.0, 0.0, -110.0]]))[0, 0]
    dark = shown.shows(1) & (np.arange(gray.shape[1]) > ends)
    found = inspect(whole, [Photo.of(np.where(dark, shade * gray, gray), scene.CAMERA, pose)], Rigid()).feature("back")
    assert found.state is not State.MISSING
    assert found.presence.log_ratio == 0
