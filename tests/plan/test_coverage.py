"""Coverage is painted on the whole surface, and counts cameras."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.plan.coverage import coverage, divided, legend
from cadcam.plan.layout import plan_layout
from cadcam.plan.pictures import camera_pictures, coverage_pictures

from .scenes import part, scene


def test_pieces_are_small_and_make_up_the_surface() -> None:
    mesh, pieces = part(), divided(part())
    assert pieces.face_areas.sum() == pytest.approx(mesh.face_areas.sum())
    corners = pieces.vertices[pieces.faces]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max()
    assert longest <= np.linalg.norm(mesh.size_mm) / 45
    np.testing.assert_allclose(
        [pieces.face_areas[pieces.part == i].sum() for i in range(3)],
        [mesh.face_areas[mesh.part == i].sum() for i in range(3)],
    )


def test_a_camera_above_covers_what_looks_up_and_nothing_below() -> None:
    layout = plan_layout(scene(9))
    covered = coverage(layout)
    below = covered.mesh.face_normals[:, 2] < -0.5
    assert (covered.cameras[below] == 0).all()
    assert covered.cameras.max() <= len(layout.chosen)
    assert covered.shares.sum() == pytest.approx(1.0)
    assert covered.shares[1:].sum() > 0.2
    assert len(legend(3)) == 4


def test_pictures_show_the_part_and_its_features() -> None:
    layout = plan_layout(scene(9))
    for picture in camera_pictures(layout):
        assert picture.ndim == 3
        assert picture.std() > 0.02
        green = (picture[..., 1] > picture[..., 0] + 0.25).sum()
        assert green > 50
    for _, picture in coverage_pictures(layout, coverage(layout)):
        assert picture.std() > 0.05
