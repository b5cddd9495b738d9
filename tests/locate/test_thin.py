"""Plates whose borders lie less than a pixel apart: what they show is evidence, though neither border is measured."""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import merge
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.quality.shown import ROOM_PX
from cadcam.locate.quality.support import support_at
from cadcam.locate.quality.thin import Strips

from ..cad.solids import box
from .photos import CAMERA, photo, view

# An open crate with a partition, of sheets 1.5 mm thick: every border runs beside another one.
CRATE = Part.of(
    merge(
        [
            box([0, 0, 0], [160, 100, 1.5]),
            *(box([x, 0, 1.5], [x + 1.5, 100, top]) for x, top in ((0.0, 50.0), (60.0, 35.0), (158.5, 50.0))),
            *(box([1.5, y, 1.5], [60.0, y + 1.5, 42.0]) for y in (0.0, 98.5)),
            *(box([61.5, y, 1.5], [158.5, y + 1.5, 28.0]) for y in (0.0, 98.5)),
        ]
    )
)
POSE = view(CRATE, (0.6, -0.9, 1.1), away=7.0)


def drawn(rng: np.random.Generator) -> Sight:
    return Sight.of(CRATE, photo(CRATE, POSE, rng), POSE, step_px=4.0, reach_px=9.0)


def test_a_strip_has_its_middle_between_its_borders(rng: np.random.Generator) -> None:
    samples = drawn(rng).samples
    strips = Strips.of(samples)
    thin = strips.half > 0
    assert thin.sum() > 60
    twins = samples.twins[thin][:, :, 0]
    nearest = np.where(np.abs(twins[:, 0]) < np.abs(twins[:, 1]), twins[:, 0], twins[:, 1])
    np.testing.assert_allclose(strips.middle[thin], nearest / 2, rtol=1e-12)
    np.testing.assert_allclose(strips.half[thin], np.abs(nearest) / 2, rtol=1e-12)
    alone = np.minimum(samples.below, samples.above)
    assert (strips.room[~thin] == alone[~thin]).all()
    assert (alone[thin] < ROOM_PX).all()  # as lines by themselves these could tell nothing
    assert np.mean(strips.room[thin] >= ROOM_PX) > 0.4


def test_a_crate_of_sheets_seen_from_afar_is_found_where_it_is_and_nowhere_else(rng: np.random.Generator) -> None:
    """Of borders with room of their own alone there are so few that much of them could be fitted anywhere."""
    sight = drawn(rng)
    samples = sight.samples
    here = support_at([sight], POSE, constraints=6, scatter=0.05)
    lone = support_at(
        [sight.select(np.minimum(samples.below, samples.above) >= ROOM_PX)], POSE, constraints=6, scatter=0.05
    )
    assert here.free < 0.6 * lone.free
    assert here.quality > max(0.6, lone.quality)
    for shift in ((6.0, 0.0), (0.0, 7.0), (-9.0, 5.0)):
        elsewhere = np.array([*shift, 0.0]) * (POSE @ CRATE.aspects.centre)[2] / CAMERA.fx
        pose = type(POSE)(translation=elsewhere) @ POSE
        assert support_at([sight], pose, constraints=6, scatter=0.05).quality < 0.3
