"""A part stays lying on those faces of its convex hull that its centre of mass lies above, and on no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket
from cadcam.errors import BadValue
from cadcam.geometry.plane import Plane
from cadcam.locate.views.resting import OnPlane, RestingFaces, centre_of_mass, few
from cadcam.locate.views.view_range import ViewRange

from ..cad.solids import box, prism, sheet
from .smooth import globe

EPS = np.finfo(float).eps
TABLE = Plane([0.0, 0.0, 1.0], 0.0)


def stable(mesh: Mesh) -> list[list[float]]:
    """Return the directions that point down where a part stays lying."""
    resting = RestingFaces.of(mesh)
    return sorted(np.round(resting.down[resting.stable] + 0.0, 6).tolist())


def sheared(mesh: Mesh, by: float) -> Mesh:
    """Return a mesh whose upper parts lean towards +x."""
    return replace(mesh, vertices=mesh.vertices @ np.array([[1.0, 0, 0], [0, 1, 0], [by, 0, 1]]))


def test_a_box_lies_on_any_of_its_faces() -> None:
    resting = RestingFaces.of(box((10, 20, 30), (110, 80, 70)))
    assert len(resting.down) == resting.stable.sum() == 6
    for down, height, corners in zip(resting.down, resting.height, resting.corners, strict=True):
        assert len(corners) == 4
        assert np.abs(corners @ down - height).max() <= 8 * EPS * 110
    assert np.abs(resting.down[0]).argmax() == 2  # the widest first


def test_a_bracket_lies_on_its_base_its_sides_and_across_its_wall() -> None:
    downs = stable(machined_bracket())
    assert len(downs) == 4
    for flat in ([0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]):
        assert flat in downs
    (across,) = (d for d in downs if 0 < d[0] < 1)  # on the wall's top and the boss
    assert across[2] > 0
    assert across[1] == 0


@pytest.mark.parametrize(("lean", "stays"), [(0.9, True), (1.1, False)])
def test_a_part_that_leans_over_its_base_falls_over(lean: float, stays: bool) -> None:
    """A box as high as wide, its middle above the border of its base where it leans by its width."""
    assert ([0.0, 0.0, -1.0] in stable(sheared(box((0, 0, 0), (40, 40, 40)), lean))) == stays


def test_a_cylinder_lies_on_its_ends_and_on_every_side() -> None:
    resting = RestingFaces.of(prism(32))
    assert resting.stable.all()
    assert len(resting.down) == 34


def test_of_a_finely_facetted_ball_few_faces_are_told_all_around_it() -> None:
    ball = globe(5)  # 20,480 facets, nearly as many of them a degree apart
    resting = RestingFaces.of(ball)
    assert len(resting.down) <= 2048
    assert resting.stable.all()
    a, b, c = (ball.vertices[ball.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    nearest = (normal / np.linalg.norm(normal, axis=1, keepdims=True) @ resting.down.T).max(axis=1)
    assert nearest.min() >= np.cos(np.radians(4.0)) - 8 * EPS
    assert len(few(resting.down, 48)) <= 48


def test_a_sheet_lies_on_either_side() -> None:
    resting = RestingFaces.of(sheet(0, 60, 0, 40))
    down = resting.down[resting.stable]
    assert {1.0, -1.0} <= set(np.round(down[:, 2], 3).tolist())


def test_the_centre_of_mass_is_that_of_the_volume_if_there_is_one() -> None:
    mesh = box((0, 0, 0), (30, 20, 10))
    wedge = replace(mesh, vertices=mesh.vertices * np.where(mesh.vertices[:, :1] > 0, [1.0, 0.0, 1.0], 1.0))
    assert centre_of_mass(wedge)[0] == pytest.approx(10.0, abs=64 * EPS * 30)
    assert np.abs(centre_of_mass(sheet(0, 60, 0, 40, z=5)) - [30, 20, 5]).max() <= 64 * EPS * 60


def test_a_direction_out_of_no_face_is_refused_with_those_on_which_the_part_stays_lying() -> None:
    resting = RestingFaces.of(box((0, 0, 0), (100, 60, 40)))
    assert np.abs(resting.down[resting.chosen([0, 0.02, -1], 5.0)] - [[0, 0, -1]]).max() < 8 * EPS
    with pytest.raises(BadValue, match=r"down of the part.*\(0, 0, -1\)"):
        resting.chosen([0.6, 0.8, 0.0], 5.0)


def test_wrong_planes_are_named() -> None:
    with pytest.raises(BadValue, match="plane normal"):
        OnPlane(Plane([0.0, 0.0, 0.0], 1.0))
    with pytest.raises(BadValue, match="plane offset"):
        OnPlane(Plane([0.0, 0.0, 1.0], np.nan))
    with pytest.raises(BadValue, match="2 planes"):
        OnPlane(Plane(np.eye(3)[:2], np.zeros(2)))
    with pytest.raises(BadValue, match="plane that the part lies on"):
        OnPlane((0, 0, 1, 0))  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="down of the part"):
        OnPlane(TABLE, [0, 0, 0])
    for within in (-1.0, np.nan, np.inf):
        with pytest.raises(BadValue, match="within_mm"):
            OnPlane(TABLE, within_mm=within)
    with pytest.raises(BadValue, match="roll_deg"):
        ViewRange(roll_deg=30.0, on=OnPlane(TABLE))
    with pytest.raises(BadValue, match="on of the views"):
        ViewRange(on=TABLE)  # type: ignore[arg-type]
