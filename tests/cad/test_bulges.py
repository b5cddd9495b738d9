"""How far surfaces bulge over their facets: what a circle through the corners says."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.cad.bulges import bulges
from cadcam.cad.mesh import merge
from cadcam.cad.topology import edge_table

from .solids import box, prism


@pytest.mark.parametrize("n", [32, 96])
def test_a_ring_of_strips_bulges_by_their_arrow_height(n: int) -> None:
    """Strips of width w bend by w / R: w^2 / 9R, between the mean of an arc, w^2 / 12R, and its middle, w^2 / 8R."""
    mesh = prism(n, radius=10.0, height=30.0)
    table = edge_table(mesh)
    smooth = (table.angle > 1e-5) & (table.angle < 1.0)
    w, bend = 20 * np.sin(np.pi / n), 2 * np.pi / n
    (found,) = bulges(mesh, table, smooth)
    assert found == pytest.approx(w * bend / 9, rel=1e-6)
    assert w**2 / 120 < found < w**2 / 80


@pytest.mark.parametrize("level", [3, 5])
def test_a_ball_bulges_over_the_middles_of_its_facets(level: int) -> None:
    """By its radius less the height of the facets' middles, weighed by the facets' sizes: larger ones are seen more."""
    import trimesh

    from cadcam.cad.mesh import Mesh

    ball = trimesh.creation.icosphere(subdivisions=level, radius=50.0)
    mesh = Mesh.single(ball.vertices, ball.faces)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    over = 50 - np.linalg.norm(middle, axis=1)
    (found,) = bulges(mesh, edge_table(mesh), np.ones(len(edge_table(mesh).count), bool))
    assert found == pytest.approx(np.average(over, weights=mesh.face_areas), rel=0.1)


def test_flat_sides_do_not_bulge() -> None:
    mesh = merge([box([0, 0, 0], [5, 6, 7]), box([20, 0, 0], [25, 6, 7], "other")])
    table = edge_table(mesh)
    assert np.array_equal(bulges(mesh, table, table.angle < 0.5), [0.0, 0.0])
