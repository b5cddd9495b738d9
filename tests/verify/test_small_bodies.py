"""Bodies in plain sight, too small in the photo to be judged: a person is told so, and what would help."""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.report.verify.words import unclear_words
from cadcam.verify.deviations.deviation import State, Unclear
from cadcam.verify.inspection import inspect

from .scene import photo, plate


def test_a_small_body_in_plain_sight_is_unclear_rather_than_out_of_view(rng: np.random.Generator) -> None:
    """A stud with edges of 8 to 15 px gives none that is evidence: no table had it, as if it were not in view.

    One below the plate is out of view.
    """
    stud = box((0, -20, 12), (16, -4, 26), name="stud", color=(0.9, 0.8, 0.5))
    under = box((0, -20, -20), (16, -4, -5), name="under", color=(0.9, 0.8, 0.5))
    mesh = merge([plate(), stud, under])
    found = inspect(Part.of(mesh), [photo(mesh, rng)], Rigid())
    assert found.feature("stud").presence.expected == 0
    assert found.feature("stud").state is State.UNCLEAR
    assert found.feature("stud").why is Unclear.SHORT_EDGES
    assert found.feature("under").state is State.OUT_OF_VIEW
    assert any("stud" in line and "too short" in line for line in unclear_words(found))
