"""The winding number: inside, outside, inwards, and what an open surface gives."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.winding import winding_number

from .solids import box, sheet


def test_a_closed_surface_winds_once_round_what_it_holds_and_not_round_the_rest(rng: np.random.Generator) -> None:
    solid = box((0, 0, 0), (3, 2, 1))
    corners = solid.vertices[solid.faces]
    for point in rng.uniform(-2, 4, (60, 3)):
        inside = ((point > 0) & (point < (3, 2, 1))).all()
        assert winding_number(corners, point) == pytest.approx(float(inside), abs=1e-12)
        assert winding_number(corners[:, ::-1], point) == pytest.approx(-float(inside), abs=1e-12)


def test_a_face_of_a_cube_takes_a_sixth_of_what_its_middle_sees() -> None:
    floor = sheet(0, 2, 0, 2)
    assert winding_number(floor.vertices[floor.faces], np.array([1.0, 1.0, -1.0])) == pytest.approx(1 / 6, abs=1e-12)
