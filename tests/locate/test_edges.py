"""Samples on visible edges: they lie on their lines, move as their Jacobian says, and know what lies beside them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Ideal, Lens
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.edges import EdgeSamples, project, sample_lines
from cadcam.locate.part import Part
from cadcam.native.profiles import clearance
from cadcam.render.lines.wireframe import Polylines

from ..cad.solids import prism
from .smooth import globe

CAMERA = Camera.from_focal((640, 480), 900.0, fy=880.0, skew=2.0, lens=BrownConrady(k1=-0.15, k2=0.05, p1=1e-3))
PLAIN = Camera.from_focal((640, 480), 900.0)
POSE = Rigid.look_at((260.0, -330.0, 300.0), (0.0, 0.0, 20.0))


def above(distance: float) -> Rigid:
    """Return a camera straight above a body 30 mm high, so far from its top."""
    return Rigid.look_at((0.0, 0.0, 30.0 + distance), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0))


def test_samples_lie_on_the_drawn_lines_a_step_apart(part: Part) -> None:
    lines = part.lines.draw(CAMERA, POSE).visible
    samples = sample_lines(lines, CAMERA, step_px=4.0, reach_px=10.0)
    q = project(samples, CAMERA, POSE).q
    a = lines.q[:-1][np.diff(lines.line_of_point) == 0]
    b = lines.q[1:][np.diff(lines.line_of_point) == 0]
    t = np.clip(((q[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
    off = np.linalg.norm(q[:, None] - a - t[..., None] * (b - a), axis=-1).min(axis=1)
    assert off.max() < 0.021  # the chord of a line that the lens bends, LineOptions.chord_px
    same = samples.run[1:] == samples.run[:-1]
    apart = np.linalg.norm(np.diff(q, axis=0), axis=1)[same]
    assert apart.min() > 3.5
    assert apart.max() < 4.5
    assert len(samples) > 0.6 * lines.length_px.sum() / 4


def test_rows_are_how_lines_move_across_themselves(part: Part, rng: np.random.Generator) -> None:
    samples = sample_lines(part.lines.draw(CAMERA, POSE).visible, CAMERA, step_px=6.0, reach_px=10.0)
    at, xi, step = project(samples, CAMERA, POSE), rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01], 1e-4
    ahead, behind = (project(samples, CAMERA, POSE @ Rigid.exp(s * step * xi)).q for s in (1, -1))
    across = np.einsum("ij,ij->i", at.normal, ahead - behind) / (2 * step)
    np.testing.assert_allclose(at.row @ xi, across, atol=1e-6 * np.abs(across).max())


LENSES = (
    Ideal(),
    BrownConrady(k1=-0.3, k2=0.05, p1=1e-3, p2=-2e-3),
    BrownConrady(-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.03, -0.02, 0.01, 2e-3, -1e-3, 3e-3, 5e-4),
)


@pytest.mark.parametrize("lens", LENSES)
def test_samples_are_where_the_camera_sees_their_points(lens: Lens, rng: np.random.Generator) -> None:
    """And nowhere where it sees none: behind it, and where the lens folds."""
    camera, at, none = Camera(CAMERA.size, CAMERA.K, lens), POSE.inv, np.zeros(400, np.int32)
    q = rng.uniform([-900, -700], [1500, 1200], (400, 2))
    p = at @ (np.linalg.inv(CAMERA.K) @ np.column_stack([q, np.ones(400)]).T * rng.uniform(-50, 400, 400)).T
    tangent, far = rng.normal(size=(400, 3)), np.zeros(400)
    twins, beyond = np.zeros((400, 2, 2)), np.zeros((400, 2))
    found = project(EdgeSamples(p, tangent, none, none, none, none, none, far, far, twins, beyond, far), camera, POSE)
    wanted = camera.project(POSE @ p)
    seen = np.isfinite(wanted).all(axis=1)
    assert 100 < seen.sum() < 380
    assert np.isnan(found.q[~seen]).all()
    assert np.isnan(found.row[~seen]).all()
    np.testing.assert_allclose(found.q[seen], wanted[seen], rtol=0, atol=1e-9)  # of 1000 px, after a dozen products


def test_room_does_not_depend_on_which_samples_are_asked_together(rng: np.random.Generator) -> None:
    """Samples near each other share the segments near them, unless there are very many."""
    for m, size in ((900, 900.0), (900, 60.0)):
        a = rng.uniform(0, size, (m, 2))
        segments = np.concatenate([a, a + rng.normal(0, 6, (m, 2))], axis=1)
        run, arc = np.arange(m, dtype=np.int32), np.tile([0.0, 10.0], (m, 1))
        q = np.repeat(rng.uniform(0, size, (20, 2)), 5, axis=0) + rng.normal(0, 9, (100, 2))
        turn = rng.uniform(0, 7, 100)
        normal, own = np.stack([np.cos(turn), np.sin(turn)], axis=1), np.full(100, -1, np.int32)
        options = {"half_length": 3.0, "near": 40.0, "most": 10.0}
        every = clearance(q, normal, own, np.zeros(100), segments, run, arc, **options)
        for k in range(100):
            one = slice(k, k + 1)
            alone = clearance(q[one], normal[one], own[one], np.zeros(1), segments, run, arc, **options)
            for together, single in zip(every, alone, strict=True):
                np.testing.assert_array_equal(together[one], single)


def test_a_twin_does_not_go_on_beyond_the_reach_for_samples_with_neighbours_alone() -> None:
    """What runs on along a twin out of reach tells no sample anything, though the box of two samples holds it."""
    axes = np.array([[-0.669, 0.743], [0.743, 0.669]])  # along the line, along its normal
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    places = np.array([[[-6.0, 0.6], [4.6, 4.31]], [[5.4, 4.59], [100.0, 0.5]]])  # (t, d) of two segments' ends
    segments = (places @ axes).reshape(2, 4)
    q, normal = np.array([[0.0, 0.0], [0.0, 8.0]]), np.tile(axes[1], (2, 1))
    lines = (segments, np.arange(2, dtype=np.int32), np.tile([0.0, 9.0], (2, 1)))
    own, arc, options = np.full(2, -1, np.int32), np.zeros(2), {"half_length": 6.0, "near": 4.0, "most": 1.0}
    alone = clearance(q[:1], normal[:1], own[:1], arc[:1], *lines, **options)
    for single, together in zip(alone, clearance(q, normal, own, arc, *lines, **options), strict=True):
        np.testing.assert_array_equal(single, together[:1])
    np.testing.assert_allclose(alone[1], 0.6)


def test_the_nearest_line_counts_however_many_are_farther() -> None:
    """Two hundred lines 5 to 9 px off come first; the one at 2 px comes last, and the room ends there."""
    far = np.linspace(5.0, 9.0, 200)
    d = np.append(far, 2.0)
    segments = np.stack([np.full_like(d, -20.0), d, np.full_like(d, 20.0), d], axis=1)
    _, above, twins, beyond = clearance(
        np.zeros((1, 2)),
        np.array([[0.0, 1.0]]),
        np.full(1, -1, np.int32),
        np.zeros(1),
        segments,
        np.arange(len(d), dtype=np.int32),
        np.tile([0.0, 40.0], (len(d), 1)),
        half_length=3.0,
        near=20.0,
        most=10.0,
    )
    assert above[0] == 2.0
    np.testing.assert_array_equal(twins[0, 1], [2.0, 0.0])
    assert beyond[0, 1] == 5.0


def test_normals_stand_on_the_lines_under_lens_and_skew(part: Part) -> None:
    samples = sample_lines(part.lines.draw(CAMERA, POSE).visible, CAMERA, step_px=6.0, reach_px=10.0)
    at = project(samples, CAMERA, POSE)
    ends = [CAMERA.project(POSE @ (samples.p + s * 0.01 * samples.tangent)) for s in (1, -1)]
    assert np.abs(np.einsum("ij,ij->i", at.normal, ends[0] - ends[1])).max() < 1e-5


def test_twin_lines_know_how_far_apart_they_are() -> None:
    """Two lines along x, 9 px apart: free on the outside, 9 px to the other; and one that ends before is not met.

    The other is a twin: straight through the cell, with room behind it as far as a third line that slants by 0.1.
    """
    segments = np.array([[0, 0, 100, 0], [0, 9, 60, 9], [0, 8, 60, 14]], float)
    q, normal = np.array([[30.0, 0.0], [80.0, 0.0]]), np.tile([0.0, 1.0], (2, 1))
    arcs = np.array([[0.0, 100.0], [0.0, 60.0], [0.0, 60.3]])
    below, above, twins, beyond = clearance(
        q,
        normal,
        np.zeros(2, np.int32),
        np.array([30.0, 80.0]),
        segments,
        np.arange(3, dtype=np.int32),
        arcs,
        half_length=3.0,
        near=20.0,
        most=12.0,
    )
    np.testing.assert_array_equal(below, 12.0)
    np.testing.assert_allclose(above, [9.0, 12.0])
    np.testing.assert_allclose(beyond, [[12.0, 10.7], [12.0, 12.0]])
    np.testing.assert_allclose(twins[0], [[-np.inf, 0.0], [9.0, 0.0]])
    np.testing.assert_array_equal(twins[1], [[-np.inf, 0.0], [np.inf, 0.0]])


def test_a_line_across_the_cell_is_no_twin() -> None:
    """A line at 45 degrees, and one that ends within the cell, bound the cell: no room beyond them."""
    for segment in ([20.0, 3.0, 40.0, 23.0], [0.0, 8.0, 31.0, 8.0]):
        _, above, twins, beyond = clearance(
            np.array([[30.0, 0.0]]),
            np.array([[0.0, 1.0]]),
            np.zeros(1, np.int32),
            np.array([30.0]),
            np.array([segment]),
            np.ones(1, np.int32),
            np.array([[0.0, 30.0]]),
            half_length=3.0,
            near=20.0,
            most=20.0,
        )
        assert np.isinf(twins).any(axis=(1, 2)).all()
        assert np.isinf(twins[:, 1, 0]).all()
        assert beyond[0, 1] == above[0] < 20.0


@pytest.mark.parametrize("level", [3, 4, 5])
def test_the_contour_of_a_faceted_ball_is_one_run_of_twelve_arcs(level: int) -> None:
    """Facets of 9, 4 and 2 degrees: no corner, nothing beside it, normals across the circle and to the outside."""
    ball = Part.of(globe(level))
    pose = Rigid.look_at((260.0, -330.0, 300.0), (0.0, 0.0, 0.0))
    samples = sample_lines(
        ball.lines.draw(PLAIN, pose).visible, PLAIN, step_px=4.0, reach_px=10.0, bulges=ball.lines.bulges
    )
    at, middle = project(samples, PLAIN, pose), PLAIN.project((pose @ np.zeros(3))[None])
    out = at.q - middle
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    assert np.array_equal(np.unique(samples.run), [0])
    assert len(np.unique(samples.arc)) == 12
    assert np.bincount(samples.arc).min() > 0.6 * len(samples) / 12
    assert np.minimum(samples.below, samples.above).mean() > 9.5
    assert np.degrees(np.arccos(np.clip((at.normal * out).sum(axis=1), -1, 1))).max() < {3: 20, 4: 10, 5: 5}[level]
    assert samples.bulge == pytest.approx(ball.lines.bulges[0])


def test_a_straight_contour_is_one_arc_and_edges_are_their_own() -> None:
    """Along a cylinder's side, and around its rim."""
    pipe = Part.of(prism(64, radius=30.0, height=120.0))
    lines = pipe.lines.draw(PLAIN, Rigid.look_at((300.0, -260.0, 200.0), (0.0, 0.0, 60.0))).visible
    samples = sample_lines(lines, PLAIN, step_px=4.0, reach_px=10.0, bulges=pipe.lines.bulges)
    sides = samples.chain < 0
    assert len(np.unique(samples.run[sides])) == len(np.unique(samples.arc[sides])) == 2
    rim = samples.select(~sides)
    assert np.array_equal(np.unique(rim.run, return_inverse=True)[1], np.unique(rim.arc, return_inverse=True)[1])
    assert not rim.bulge.any()
    assert samples.bulge[sides].min() > 0


@pytest.mark.parametrize(
    ("sides", "distance", "runs"), [(20, 1700.0, 1), (16, 2400.0, 1), (6, 2400.0, 6), (6, 4000.0, 6)]
)
def test_the_short_sides_of_a_coarse_circle_are_one_run_and_those_of_a_nut_are_not(
    sides: int, distance: float, runs: int
) -> None:
    """Looked upon from above; sides of 5, 4.4, 11 and 7 px that turn by 18, 23, 60 and 60 degrees."""
    nut = Part.of(prism(sides, radius=30.0, height=30.0))
    lines = nut.lines.draw(PLAIN, above(distance)).visible
    samples = sample_lines(lines, PLAIN, step_px=4.0, reach_px=10.0)
    round_px = 900.0 / distance * sides * 60.0 * np.sin(np.pi / sides)
    assert len(np.unique(samples.run)) == runs
    assert len(samples) == pytest.approx(round_px / 4, abs=runs)


def test_a_coarse_circle_too_small_for_cells_is_left_out_and_coarse_fillets_are_cut_at_their_corners() -> None:
    """A cell would bend by 46 degrees on the one; the others turn by 90 degrees in all, in sides of 6 px."""
    small = Part.of(prism(16, radius=13.5, height=30.0))
    assert not len(sample_lines(small.lines.draw(PLAIN, above(2400.0)).visible, PLAIN, step_px=4.0, reach_px=10.0))
    turn = np.linspace(0, np.pi / 2, 5)
    quarter = np.column_stack([45 + 15 * np.cos(turn), 25 + 15 * np.sin(turn)])
    outline = np.concatenate([quarter * (x, y) for x in (-1, 1) for y in (-1, 1)])
    hull = ConvexHull(np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, 30.0)]))
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    plate = Part.of(Mesh.single(hull.points, np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)))
    samples = sample_lines(plate.lines.draw(PLAIN, above(900.0)).visible, PLAIN, step_px=4.0, reach_px=10.0)
    assert len(np.unique(samples.run)) == 4 + 4 * 4


def test_two_fillets_that_follow_each_other_are_no_circle() -> None:
    """Each turns by 90 degrees; that their polylines stand in a row does not join them."""
    turn = np.linspace(0, np.pi / 2, 5)
    bend = 15 * np.column_stack([np.cos(turn), np.sin(turn)])
    q = np.concatenate([bend + 100, bend @ [[0, 1], [-1, 0]] + 300])  # the other goes on in the one's direction
    none = np.full(2, -1, np.int32)
    lines = Polylines(q, np.column_stack([q, q[:, 0]]), np.full(10, -1), np.array([0, 5, 10]), none + 1, none + 1, none)
    assert len(np.unique(sample_lines(lines, PLAIN, step_px=4.0, reach_px=10.0).run)) == 8
