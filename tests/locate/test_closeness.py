"""The closeness of edges: high where the pose is right, at chance where it is wrong, and its shift is the true one."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.image.edges import canny
from cadcam.locate.match.closeness import ClosenessOptions, edge_closeness
from cadcam.locate.part import Part

from ..cad.solids import prism
from .scene import CAMERA, block, off, photo_of, pose_of


def test_at_the_right_pose_edges_are_close_and_at_a_wrong_one_no_closer_than_chance(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    edges = canny(photo_of(truth, rng).gray)
    right = edge_closeness(edges, block().lines.draw(CAMERA, truth))
    wrong = edge_closeness(edges, block().lines.draw(CAMERA, off(truth, rng, degrees=25, px=40)))
    assert right.total > 0.6
    assert abs(wrong.total) < 0.15
    long = right.length > 100
    assert np.median(right.share[long]) > 0.8
    assert np.median(np.abs(right.offset[long])) < 0.3


def test_a_shift_of_the_model_is_read_off_each_edge(rng: np.random.Generator) -> None:
    """Along the normal of each edge the offset is the shift's part along it, and so is the fullest vote."""
    truth = pose_of(rng)
    edges = canny(photo_of(truth, rng).gray)
    centre = truth @ np.asarray(block().scene.mesh.bounds).mean(axis=0)
    shifted = Rigid(translation=[1.5 * centre[2] / CAMERA.fx, 0, 0]) @ truth  # the model 1.5 px too far right
    wireframe = block().lines.draw(CAMERA, shifted)
    close = edge_closeness(edges, wireframe)
    _, normal, line, _ = wireframe.visible.points_along(1.0)
    chain = wireframe.visible.chain[line]
    long = np.flatnonzero((close.length > 80) & (close.share > 0.8))
    expected = np.array([-1.5 * normal[chain == close.chain[k], 0].mean() for k in long])
    assert len(long) >= 6
    assert np.abs(expected).max() > 1
    assert np.median(np.abs(close.offset[long] - expected)) < 0.35  # depth varies by a fifth: 0.3 px of 1.5
    agree = np.abs(close.shift[long] - expected) < 0.6
    assert agree.mean() > 0.5  # the others are twin edges of plates, one of which the vote may take for the other


def test_the_vote_finds_shifts_that_are_too_far_for_the_direct_way(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    edges = canny(photo_of(truth, rng).gray)
    centre = truth @ np.asarray(block().scene.mesh.bounds).mean(axis=0)
    far = Rigid(translation=[8 * centre[2] / CAMERA.fx, 0, 0]) @ truth
    close = edge_closeness(edges, block().lines.draw(CAMERA, far))
    steep = (close.length > 60) & (np.abs(close.shift) > 5) & (np.abs(close.shift) < 11)
    assert steep.sum() >= 4
    assert np.median(close.votes[steep]) > 0.6
    assert np.median(close.share[steep]) < 0.2


def test_a_photo_without_edges_and_a_model_without_lines_are_no_error(rng: np.random.Generator) -> None:
    truth = pose_of(rng)
    blank = edge_closeness(np.full((480, 640), 0.5), block().lines.draw(CAMERA, truth))
    assert blank.total == 0
    assert np.isnan(blank.offset).all()
    assert (blank.votes == 0).all()
    away = edge_closeness(
        photo_of(truth, rng).gray, block().lines.draw(CAMERA, Rigid(translation=[0, 0, -9000]) @ truth)
    )
    assert len(away) == 0
    assert away.total == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"near": 0},
        {"near": np.inf},
        {"step": 10**400},
        {"reach": np.inf},
        {"cell": 20},
        {"cell": np.nan},
        {"within": 4},
    ],
    ids=str,
)
def test_wrong_options_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(BadValue, match=rf"^{'reach' if wrong == {'cell': 20} else next(iter(wrong))} is "):
        ClosenessOptions(**wrong)


def test_options_of_another_kind_are_refused(rng: np.random.Generator) -> None:
    drawn = block().lines.draw(CAMERA, pose_of(rng))
    with pytest.raises(BadValue, match="options is a dict of 1; expected a ClosenessOptions"):
        edge_closeness(np.zeros(CAMERA.size[::-1]), drawn, options={"near": 3})  # type: ignore[arg-type]


def test_lengths_are_those_seen_however_finely_a_curve_is_meshed(rng: np.random.Generator) -> None:
    """Each facet's edge, however short, counted as a whole step: edges of 26 px seemed 178 px long."""
    truth = Rigid.look_at((300.0, -560.0, 400.0), (0.0, 0.0, 40.0))
    totals = []
    for sides in (48, 360):
        lines = Part.of(Mesh.single(prism(sides).vertices * [40, 40, 80], prism(sides).faces)).lines.draw(CAMERA, truth)
        close = edge_closeness(canny(rng.normal(0.5, 0.1, CAMERA.size[::-1])), lines)
        seen = lines.visible
        for chain, length in zip(close.chain, close.length, strict=True):
            assert length == pytest.approx(seen.length_px[seen.chain == chain].sum(), rel=1e-6)
        totals.append(close.length.sum())
    assert totals[1] == pytest.approx(totals[0], rel=0.02)
