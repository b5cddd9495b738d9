"""Which of the photo's edges are measured at all."""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.verify.association import ROOM_PX
from cadcam.verify.survey import surveyed
from cadcam.verify.tolerance import whole_parts

from .scene import photo, plate


def test_twins_are_not_measured(rng: np.random.Generator) -> None:
    """A sheet of 3 mm shows two edges some 2 px apart; either may be taken for the other."""
    mesh = merge([plate(), box((-100, -95, 12), (60, -70, 15), name="sheet", color=(0.55, 0.55, 0.6))])
    seen = surveyed(Part.of(mesh), [photo(mesh, rng)], Rigid(), whole_parts(Part.of(mesh).scene), reach_px=8.0)
    twins = seen.usable & (seen.lines.room < ROOM_PX)
    assert (twins & seen.matched.support).sum() > 20
    assert not (twins & seen.matched.measured).any()
