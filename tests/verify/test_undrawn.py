"""Borders for which no line is drawn: where bodies cut each other, and where a shadow begins beside an edge."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box, prism
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.edges.sightlines import sightlines
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.edges.undrawn import room_beside
from cadcam.verify.tolerances.tolerance import whole_parts

from .scene import CAMERA, POSE, part, photo, plate
from .test_astray import strip

_SPACING = 0.75  # px, of the places at which it is asked what shows


def test_the_side_of_a_body_that_has_sunk_ends_where_no_line_is_drawn(rng: np.random.Generator) -> None:
    """A nut 5.7 px off was measured 4.5 px off, wrong by 43 sigma: its side, 1 px wide, ended in the plate below."""
    low = (-50.0, -20.0, 12.0), (50.0, 20.0, 16.0)
    whole, shot = Part.of(merge([plate().subset(["plate"]), box(*low, name="nut")])), photo(plate(), rng)
    sunk = redrawn(whole, np.array([[0, 0, 0], [0, 0, -2.0]]))
    assert sunk is not None
    for drawn, undrawn in ((whole, False), (sunk, True)):
        lines, sights = sightlines(drawn, [shot], Rigid())
        room = room_beside(drawn, sights, lines)
        front = (lines.part == 1) & (np.abs(lines.p[:, 1] - low[0][1]) < 1e-6) & (lines.p[:, 2] > 13)
        assert front.sum() > 10
        ends = CAMERA.project(POSE @ (lines.p[front] * [1, 1, 0] + [0, 0, 12]))
        wide = np.abs(np.einsum("ni,ni->n", ends - lines.q[front], lines.normal[front]))
        assert ((wide > 1) & (wide < 3.5)).all()
        if undrawn:
            alone = lines.room[front] > wide + 1  # not so at the corners
            assert alone.mean() > 0.8
            np.testing.assert_allclose(room[front][alone], (wide - 0.5 * _SPACING)[alone], atol=0.5 * _SPACING)
            survey = surveyed(sunk, [shot], Rigid(), whole_parts(sunk.scene), reach_px=8.0)
            np.testing.assert_array_equal(survey.lines.room, room)
            assert not survey.matched.measured[front][alone].any()
        else:
            np.testing.assert_array_equal(room, lines.room)


def foot(radius: float, *, strip_mm: float) -> Part:
    """Return a wall on a floor with a fillet at its foot, one body; so wide a strip of the wall is flat."""
    t = np.linspace(0, np.pi / 2, 13)
    fillet = np.stack([radius * (1 - np.sin(t)), radius * (1 - np.cos(t))], axis=1)
    outline = [(-40, -12), (100, -12), (100, 0), *fillet.tolist(), (0, radius + strip_mm), (-40, radius + strip_mm)]
    return Part.of(prism(outline, -60, 60, name="foot"))


@pytest.mark.parametrize(("radius", "taken"), [(2.0, True), (60.0, False)])
def test_a_fillet_that_joins_a_strip_of_wall_smoothly_is_a_border_and_a_wide_one_is_a_slope(
    radius: float, taken: bool, rng: np.random.Generator
) -> None:
    """The upper edge of a strip 4 px wide was measured 0.5 mm off, at 16 sigma: its fillet is lit otherwise."""
    drawn = foot(radius, strip_mm=4.0)
    camera = Camera.from_focal((640, 480), 900.0)
    pose = Rigid.look_at(np.array([500.0, 560.0, 80.0]), np.array([0.0, radius, 0.0]), up=(0.0, 1.0, 0.0))
    lines, sights = sightlines(drawn, [Photo.of(np.zeros((480, 640), np.float32), camera, pose)], Rigid())
    room = room_beside(drawn, sights, lines)
    upper = (
        (np.abs(lines.p[:, 0]) < 1e-6) & (np.abs(lines.p[:, 1] - radius - 4.0) < 1e-6) & (np.abs(lines.p[:, 2]) < 50)
    )
    assert upper.sum() > 10
    below = camera.project(pose @ (lines.p[upper] - [0, 4.0, 0]))
    wide = np.abs(np.einsum("ni,ni->n", below - lines.q[upper], lines.normal[upper]))
    assert ((wide > 2) & (wide < 3.9)).all()
    if taken:
        assert (room[upper] < 4.0).all()
    else:
        np.testing.assert_array_equal(room[upper], lines.room[upper])


def test_what_shows_at_an_edge_between_faces_lit_alike_is_the_border_of_a_shadow(rng: np.random.Generator) -> None:
    """A clip in place was called displaced, at 18 sigma: a shadow began 1.3 px beside one of its edges."""
    (x0, y1, z), x1 = (-120.0, -48.0, 52.0), 40.0  # of the first rib, before the plate's face

    def back(of: Array) -> Array:
        return np.asarray((np.abs(of[:, 1] - y1) < 1e-6) & (np.abs(of[:, 2] - z) < 1e-6))

    gray = photo(plate(), rng).gray
    beside = 2.5  # mm
    shot = strip(gray, (np.array([x1 - 2, y1 + beside, z]), np.array([x0 + 2, y1 + beside, z])), 6.0, 0.4)
    survey = surveyed(part(), [shot], Rigid(), whole_parts(part().scene), reach_px=8.0)
    measured = survey.matched.measured
    edge = measured & (survey.lines.part == 1) & back(survey.lines.p)
    assert edge.sum() > 5
    assert np.abs(np.median(survey.matched.offset[edge])) > 0.8
    assert (survey.matched.common[edge] >= 0.5).all()
    lit = measured & ~np.isin(survey.lines.edge, survey.lines.edge[edge])
    assert (survey.matched.common[lit] < 0.2).mean() > 0.9
