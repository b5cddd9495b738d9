"""The symmetries of a part: poses in which it looks the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.in_photos import equivalent, locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.track import tracker
from cadcam.render import open_renderer
from cadcam.render.view import Channel

from ..cad.solids import box, prism
from .moving import FIRST, block, frames, location, measured
from .photos import CAMERA, noisy, photo, view


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box([0, 0, 0], [84, 84, 84]), 24),
        (box([5, 5, -80], [170, 73, 0]), 4),
        (box([0, 0, 0], [50, 50, 10]), 8),
        (box([0, 0, 0], [2000, 100, 10]), 4),
        (box([0, 0, 0], [3000, 60, 4]), 4),
        (box([0, 0, 0], [6000, 40, 40]), 8),
        (merge([box([0, 0, 0], [3000, 60, 4]), box([0, 0, 4], [3000, 3, 40])]), 1),
        (prism(3), 6),
        (prism(6, height=9.0), 12),
        (machined_bracket(), 1),
    ],
)
def test_the_group_is_that_of_the_solid(mesh: Mesh, expected: int) -> None:
    assert len(Part.of(mesh).symmetries) == expected


def test_each_symmetry_maps_the_corners_onto_themselves_and_the_first_is_the_identity() -> None:
    part = Part.of(box([0, 0, 0], [50, 50, 10]))
    v = part.scene.mesh.vertices
    for motion in part.symmetries:
        apart = np.linalg.norm((motion @ v)[:, None] - v[None], axis=2)
        assert apart.min(axis=1).max() < 1e-9 * 50
    assert np.allclose(part.symmetries[0].matrix, np.eye(4))


def dome(n: int, height: float) -> Mesh:
    """Return a cap of a ball, n facets around a rim of radius 40: its only edges."""
    turn, up = 2 * np.pi * np.arange(n) / n, np.pi / 2 * np.arange(8) / 8
    rings = [
        np.stack([40 * np.cos(a) * np.cos(turn), 40 * np.cos(a) * np.sin(turn), np.full(n, height * np.sin(a))], axis=1)
        for a in up
    ]
    ends, k = np.array([[0, 0, 0], [0, 0, height]]), np.arange(n)
    after, low = (k + 1) % n, n * np.arange(7)[:, None]
    sides = [np.stack(np.broadcast_arrays(low + k, low + after, low + n + after), axis=2).reshape(-1, 3)]
    sides.append(np.stack(np.broadcast_arrays(low + k, low + n + after, low + n + k), axis=2).reshape(-1, 3))
    caps = [np.stack([after, k, 0 * k + 8 * n], 1), np.stack([7 * n + k, 7 * n + after, 0 * k + 8 * n + 1], 1)]
    return Mesh.single(np.concatenate([*rings, ends]), np.concatenate([*sides, *caps]))


@pytest.mark.parametrize("height", [5.0, 40.0, 90.0])
def test_a_dome_upside_down_is_not_the_same(height: float) -> None:
    """Its rim is its only edge, and lies where it was."""
    part = Part.of(dome(24, height))
    assert len(part.symmetries) == 24
    assert all(S.rotation[2, 2] > 0 for S in part.symmetries)


def test_a_mark_breaks_the_symmetry() -> None:
    from cadcam.cad.mesh import merge

    marked = merge([box([0, 0, 0], [50, 50, 10]), box([40, 30, 10], [45, 33, 12], name="mark")])
    assert len(Part.of(marked).symmetries) == 1


def test_rotations_that_the_tolerance_cannot_tell_apart_are_one() -> None:
    """Curved plates in thousands of small edges map onto themselves within the tolerance by turns of a milliradian."""
    from cadcam.cad.read import read_model

    block = read_model(Path(__file__).resolve().parents[2] / "models" / "shipblock_10k.obj", unit="mm")
    assert len(Part.of(block).symmetries) == 1


@pytest.mark.parametrize("sides", [16, 64])
def test_a_turned_part_may_be_turned_about_its_axis(sides: int) -> None:
    away = Rigid.exp([30.0, -20.0, 50.0, 0.3, -0.8, 0.5])
    (spin,) = Part.of(prism(sides).transformed(away)).spins.T
    points = away @ np.array([[0.0, 0, 0], [0, 0, 30]])
    assert Rigid.exp(spin) @ points == pytest.approx(points, abs=1e-9 * 100)
    assert np.linalg.norm(spin[3:]) == pytest.approx(1.0)


def test_a_part_with_anything_to_one_side_may_not() -> None:
    ball = np.array([[10.0, 10, 5], [11, 10, 5], [10, 11, 5], [10, 10, 6]])
    lump = Mesh.single(ball, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    for mesh in (merge([prism(64), lump]), prism(6), box([0, 0, 0], [50, 50, 10]), machined_bracket()):
        assert not Part.of(mesh).spins.size


def ball(level: int = 3) -> Mesh:
    """Return a ball of radius 50 about (300, -200, 100): an octahedron cut so often, its corners pushed out."""
    p = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
    T = p[[(k, (k + 1) % 4, 4) for k in range(4)] + [((k + 1) % 4, k, 5) for k in range(4)]]
    for _ in range(level):
        a, b, c = T[:, 0], T[:, 1], T[:, 2]
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        T = np.concatenate([np.stack(t, axis=1) for t in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    T /= np.linalg.norm(T, axis=2, keepdims=True)
    return mend(Mesh.single(50 * T.reshape(-1, 3) + [300, -200, 100], np.arange(3 * len(T)).reshape(-1, 3)))[0]


def test_a_ball_may_be_turned_any_way_about_its_middle() -> None:
    spins = Part.of(ball()).spins
    assert spins.shape == (6, 3)
    middle = np.array([300.0, -200, 100])
    for spin in spins.T:
        assert Rigid.exp(spin) @ middle == pytest.approx(middle, abs=1e-9 * 500)


def test_where_a_ball_is_is_told_and_that_its_turn_cannot_be(rng: np.random.Generator) -> None:
    """Its facets would tell a turn, and wrongly."""
    camera, middle = Camera.from_focal((400, 300), 500.0), np.array([300.0, -200, 100])
    part = Part.of(ball(6))
    pose = Rigid.look_at(middle + np.array([200.0, 250, 150]), middle)
    fine = open_renderer(part.scene).render(camera.resize((3200, 2400)), pose, channels=Channel.DEPTH)
    shown = np.isfinite(fine.depth).reshape(300, 8, 400, 8).mean(axis=(1, 3))
    photo = Photo.of(noisy(0.3 + 0.4 * gaussian_filter(shown, 0.6), 0.01, rng), camera)
    start = pose @ Rigid(translation=middle) @ Rigid.exp([6, -5, 8, 0.2, 0.3, -0.2]) @ Rigid(translation=-middle)
    found = locate_part(part, [photo], start)
    assert found.found, found.reason
    assert "however it is turned" in found.reason
    at = Rigid(translation=middle).inv.adjoint()  # its covariance about its middle
    covariance = at @ found.pose.covariance @ at.T
    assert np.degrees(np.sqrt(np.diag(covariance)[3:])) == pytest.approx(180 / np.sqrt(3), rel=0.01)
    off = found.pose.world_from_part.inv @ pose @ middle - middle
    assert off @ np.linalg.solve(covariance[:3, :3], off) < 16  # chi square of 3: one in a thousand is more


def test_on_a_floor_a_ball_turns_unseen_about_the_upright_alone() -> None:
    part = Part.of(ball())
    floor = Freedom.planar([0, 0, 1.0])
    unseen = floor.among(part.spins, Rigid())
    assert unseen.shape == (6, 1)
    assert np.abs(unseen[3:, 0] / np.linalg.norm(unseen[3:])) == pytest.approx([0, 0, 1], abs=1e-9)
    assert floor.without(unseen, Rigid()).basis.shape == (6, 2)


def test_an_alternative_s_matches_are_on_its_own_edges(rng: np.random.Generator) -> None:
    """They are where the photo shows them, and on the chain that runs there."""
    part = Part.of(box([-20, -15, -10], [20, 15, 10]))
    pose = view(part, (0.8, -0.5, 0.7))
    found = refine_pose(part, [photo(part, pose, rng)], pose)
    others = equivalent(part, found)
    assert len(others) == 3
    scene = part.scene
    a, b = (scene.mesh.vertices[scene.edges.vertices[:, k]] for k in range(2))
    for one in (found, *others):
        m = one.matches
        assert np.abs(CAMERA.project(one.pose.world_from_part @ m.p) - m.q).max() < 1e-9
        assert (
            np.abs(
                CAMERA.project(one.pose.world_from_part @ one.judged.p)
                - CAMERA.project(found.pose.world_from_part @ found.judged.p)
            ).max()
            < 1e-9
        )
        own = [np.flatnonzero(scene.edges.chain == chain)[0] for chain in m.chain]
        u = (b[own] - a[own]) / np.linalg.norm(b[own] - a[own], axis=1, keepdims=True)
        assert np.linalg.norm(np.cross(m.p - a[own], u), axis=1).max() < 1e-9


def test_a_tracked_pose_keeps_the_reason_of_the_one_it_equals(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the least certain direction in its own axes: half a turn about x turns y and z."""
    part, along = block(), np.array([0.8, 0.36, 0.48])
    noise = np.diag([1e-4] * 3 + [1e-12] * 3)
    noise[:3, :3] += np.outer(along, along)
    known = "least certain along (0.80, {}) of the part, 1 mm"
    why = Reason("6 of 7 edges", known=known.format("0.36, 0.48"), notes=("3 other poses look as good",))
    found = replace(location(FIRST), pose=replace(measured(FIRST), from_noise=noise), why=why)
    noted = [one.noting("in photos reduced 2 times") for one in equivalent(part, found)]  # as of blurred photos
    both = replace(found, alternatives=tuple(noted))
    monkeypatch.setattr(tracker, "locate_part", lambda *_, **__: both)
    turned = FIRST @ Rigid.from_rotation_vector([np.pi, 0, 0], [0, 40, 20])
    (one,) = tracker.track_part(part, frames(1), turned)
    np.testing.assert_allclose(one.location.pose.world_from_part.matrix, turned.matrix, atol=1e-9)
    assert one.location.why == replace(why, known=known.format("-0.36, -0.48"))
