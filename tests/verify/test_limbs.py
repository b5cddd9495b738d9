"""Limbs: what a photo shows inside of a round surface's border may be shade, and nobody is blamed for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array
from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import arc, box, circle, moved, prism, tube, turned
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look
from cadcam.verify.deviations.deviation import State
from cadcam.verify.deviations.measured import MeasuredEdges
from cadcam.verify.edges.limbs import limb_errors
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.sightlines import pieces, sightlines
from cadcam.verify.edges.surroundings import edge_surroundings
from cadcam.verify.inspection import Inspection, inspect

from .scene import CAMERA, NOISE, POSE

_FLASH = Look(head=0.75, fill=0.0, back=0.0, ambient=0.02, background=(0.05, 0.05, 0.05), supersampling=4)
_FROM_LEFT = Rigid.look_at((-350.0, -650.0, 560.0), (0.0, 0.0, 20.0))


@cache
def stand() -> Part:
    """Return a plate with two ribs, and a roller of 24 facets that lies before it, seen against the dark."""
    return Part.of(merge([*_plate(), _roller(np.zeros(3))]))


def _plate() -> list[Mesh]:
    low_high = {
        "plate": ((-150, -40, 0), (150, 100, 12)),
        "rib 1": ((-120, -10, 12), (40, 2, 52)),
        "rib 2": ((-120, 50, 12), (40, 62, 52)),
        "block": ((70, 0, 12), (120, 60, 45)),
    }
    return [box(low, high, name=name, color=(0.6, 0.6, 0.6)) for name, (low, high) in low_high.items()]


def _roller(by: Array) -> Mesh:
    lying = turned(prism(circle((0, 0), 22.0, 24), 0.0, 180.0, name="roller", color=(0.6, 0.6, 0.6)), "yz")
    return moved(lying, np.array([-100.0, -110.0, 20.0]) + by)


@cache
def grip() -> Part:
    """Return the plate with a bent bar that stands on it: its limbs face three ways."""
    return Part.of(merge([*_plate(), _bar(np.zeros(3))]))


def _bar(by: Array) -> Mesh:
    bends = [arc((-60, 80), 30.0, 180, 90, 9), arc((60, 80), 30.0, 90, 0, 9)]
    xz = np.concatenate([[(-90.0, 0.0)], *bends, [(90.0, 0.0)]])
    spine = np.column_stack([xz[:, 0], np.full(len(xz), 25.0), xz[:, 1]])
    color = (0.6, 0.6, 0.6)
    return moved(tube(spine, np.array([0.0, 1.0, 0.0]), (9.0, 6.0), 24, name="bar", color=color), by)


def inspected(by: Array, rng: np.random.Generator) -> Inspection:
    photo = _photo(merge([*_plate(), _roller(by)]), POSE, _FLASH, rng)
    return inspect(stand(), [photo], Rigid())


def _photo(mesh: Mesh, pose: Rigid, look: Look, rng: np.random.Generator) -> Photo:
    gray = open_renderer(Part.of(mesh).scene).render(CAMERA, pose, channels=Channel.IMAGE, look=look).gray
    gray = gaussian_filter(gray, 0.5) + rng.normal(0, NOISE, gray.shape)
    return Photo.of(np.clip(gray, 0, 1).astype(np.float32), CAMERA, pose)


def gripped(by: Array, rng: np.random.Generator) -> Inspection:
    mesh = merge([*_plate(), _bar(by)])
    look = replace(_FLASH, background=(0.6, 0.6, 0.6))
    return inspect(grip(), [_photo(mesh, pose, look, rng) for pose in (POSE, _FROM_LEFT)], Rigid())


@pytest.mark.parametrize("seed", range(3))
def test_a_dark_limb_before_a_dark_ground_is_not_called_displaced(seed: int) -> None:
    """The photo shows a border of light 0.8 px inside of the roller's: were it believed, that is ten sigmas."""
    seen = inspected(np.zeros(3), np.random.default_rng(seed))
    assert {f.state for f in seen.features} <= {State.IN_PLACE, State.UNCLEAR}
    assert "roller" not in seen.left_out


def test_a_displaced_roller_is_found_all_the_same(rng: np.random.Generator) -> None:
    """Its end is a circle that shows sharply; components seen err within chi-square of two beyond 1e-3."""
    by = np.array([0.0, -1.5, 1.0])
    found = inspected(by, rng).feature("roller")
    assert found.state is State.DISPLACED
    assert found.displacement is not None
    error = found.displacement.value - found.seen.T @ by
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 13.8


def test_a_limb_seen_outside_of_its_place_tells_and_one_seen_inside_does_not() -> None:
    """Two limbs of a roller, seen 2 px to the same side: one moved away from it, one into it."""
    lines, sights = sightlines(stand(), [Photo.of(np.zeros((360, 480), np.float32), CAMERA, POSE)], Rigid())
    beside = edge_surroundings(
        [s.photo for s in sights], [ShownFaces.of(stand(), s.photo, Rigid()) for s in sights], lines
    )
    limbs = (lines.kind == EdgeKind.CONTOUR) & (lines.part == stand().scene.mesh.part_names.index("roller"))
    down = lines.normal[:, 1]  # of the picture
    errors, apart = limb_errors(lines, beside, np.where(limbs, 2.0 * np.sign(down), np.nan))
    upper, lower = sorted(np.unique(lines.edge[limbs]), key=lambda e: lines.q[lines.edge == e, 1].mean())
    np.testing.assert_allclose(errors[lines.edge == upper], 2.0)
    np.testing.assert_allclose(errors[lines.edge == lower], 0.5)
    assert not errors[~limbs].any()
    assert not apart.any()


def test_a_bent_limb_whose_pieces_are_shaded_each_in_its_own_way_is_in_place(rng: np.random.Generator) -> None:
    """Pieces off by half a pixel, each to a side of its own, differ as those of a displaced body do, by ten sigmas."""
    seen = gripped(np.zeros(3), rng)
    survey, lines, number = seen.survey, seen.survey.lines, seen.survey.names.index("bar")
    limb = survey.members[number] & (lines.kind == EdgeKind.CONTOUR)
    piece = np.full(len(lines), -1)
    piece[limb] = pieces(lines.edge[limb], lines.normal[limb])
    for _ in range(20):
        shade = rng.choice([-0.5, 0.5], piece.max() + 1)[piece] + rng.normal(0, 0.02, len(lines))
        offset = np.where(limb & survey.matched.measured, shade, survey.matched.offset)
        shaded = replace(survey, matched=replace(survey.matched, offset=offset))
        measured = MeasuredEdges.of(shaded, np.ones(len(lines), bool), survey.body != number, np.eye(6))
        assert measured.p_value(measured.members[number]) > 0.01


def test_a_displaced_bent_bar_is_found_all_the_same(rng: np.random.Generator) -> None:
    found = gripped(np.array([0.0, -4.0, 0.0]), rng).feature("bar")
    assert found.state is State.DISPLACED
    assert found.displacement is not None
    error = found.displacement.value - found.seen.T @ [0.0, -4.0, 0.0]
    assert error @ np.linalg.solve(found.displacement.covariance, error) < 16.3  # chi-square of three beyond 1e-3
