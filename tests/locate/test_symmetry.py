"""The poses in which a part looks the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import machined_bracket
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part

from ..cad.solids import box, prism


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box([0, 0, 0], [84, 84, 84]), 24),
        (box([5, 5, -80], [170, 73, 0]), 4),
        (box([0, 0, 0], [50, 50, 10]), 8),
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
    spin = Part.of(prism(sides).transformed(away)).spin
    assert spin is not None
    points = away @ np.array([[0.0, 0, 0], [0, 0, 30]])
    assert Rigid.exp(spin) @ points == pytest.approx(points, abs=1e-9 * 100)
    assert np.linalg.norm(spin[3:]) == pytest.approx(1.0)


def test_a_part_with_anything_to_one_side_may_not() -> None:
    ball = np.array([[10.0, 10, 5], [11, 10, 5], [10, 11, 5], [10, 10, 6]])
    lump = Mesh.single(ball, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    for mesh in (merge([prism(64), lump]), prism(6), box([0, 0, 0], [50, 50, 10]), machined_bracket()):
        assert Part.of(mesh).spin is None
