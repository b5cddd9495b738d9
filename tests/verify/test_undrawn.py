"""Borders for which no line is drawn: where bodies cut each other."""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.verify.bodies.redrawn import redrawn
from cadcam.verify.edges.sightlines import sightlines
from cadcam.verify.edges.undrawn import room_beside

from .scene import CAMERA, POSE, photo, plate

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
        else:
            np.testing.assert_array_equal(room, lines.room)
