"""Coverage is painted on the whole surface, and counts cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.plan import coverage as module
from cadcam.plan import pictures
from cadcam.plan.coverage import coverage, coverage_steps, divided
from cadcam.plan.layout import plan_layout, survey
from cadcam.plan.pictures import camera_pictures, coverage_pictures
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.plan.scene.layout_scene import Mount
from cadcam.plan.uncertainty.finding import Finder

from .scenes import MIDDLE, features, part, position, scene


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


def test_pieces_stay_large_rather_than_become_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = part()
    monkeypatch.setattr(module, "_MOST", 200)
    pieces = divided(mesh)
    assert mesh.n_faces < pieces.n_faces <= 200
    assert pieces.face_areas.sum() == pytest.approx(mesh.face_areas.sum())


def test_a_camera_above_covers_what_looks_up_and_nothing_below() -> None:
    layout = plan_layout(scene(9))
    covered = coverage(layout)
    below = covered.mesh.face_normals[:, 2] < -0.5
    assert (covered.cameras[below] == 0).all()
    assert covered.cameras.max() <= len(layout.chosen)
    assert covered.shares.sum() == pytest.approx(1.0)
    assert covered.shares[1:].sum() > 0.2
    assert covered.counted(3).words == ("no camera", "one camera", "2 cameras", "3 cameras")
    assert covered.counted(7).words[-2:] == ("4 cameras", "5 or more")


def test_as_many_steps_are_shown_as_were_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_AT_ONCE", 100)
    layout, steps = plan_layout(scene(9)), []
    pieces = divided(layout.survey.scene.part)
    coverage(layout, pieces, step=lambda: steps.append(1))
    assert len(steps) == coverage_steps(layout, pieces) >= 2


def test_the_uncertainty_painted_is_that_of_a_point_feature_there() -> None:
    """Pieces against a feature at their middles, in the pose that measures it worst.

    Those of a group lie within a 45th of the diagonal, a hundredth of their distance from the cameras, and U grows
    with the square of the distance: 3 % at the most.
    """
    layout = plan_layout(scene(9))
    covered = coverage(layout)
    middle, normal = covered.mesh.vertices[covered.mesh.faces].mean(axis=1), covered.mesh.face_normals
    known = np.flatnonzero(np.isfinite(covered.U))
    for i in known[:: len(known) // 5]:
        one = LayoutFeature("here", Kind.POINT, middle[i], position(1.0), normal=normal[i])
        alone = survey(replace(layout.survey.scene, features=(one,))).assess(layout.chosen)
        assert covered.U[i] == pytest.approx(2.0 * alone.sigma.max(), rel=0.03)
        assert covered.cameras[i] == alone.cameras.min()


def test_what_fewer_than_two_cameras_see_is_not_measured() -> None:
    covered = coverage(plan_layout(scene(9)))
    np.testing.assert_array_equal(np.isfinite(covered.U), covered.cameras >= 2)
    painting = covered.measured()
    assert painting is not None
    assert painting.shares.sum() == pytest.approx(1.0)
    assert painting.shares[0] == pytest.approx(covered.shares[:2].sum())
    assert (painting.shares[1:-1] > 0.05).any()


def test_without_a_stated_sigma_nothing_is_said_of_uncertainty() -> None:
    """Grey levels and contrast tell of features of known size only."""
    marks = tuple(f for f in features() if f.kind is not Kind.POINT)
    layout = plan_layout(scene(9, features=marks, finder=Finder(gray=0.01, contrast=0.5)))
    assert coverage(layout).measured() is None


def test_pictures_show_the_part_and_its_features() -> None:
    layout = plan_layout(scene(9))
    for picture in camera_pictures(layout):
        assert picture.ndim == 3
        assert picture.std() > 0.02
        green = (picture[..., 1] > picture[..., 0] + 0.25).sum()
        assert green > 50
    covered = coverage(layout)
    for painting in (covered.counted(3), covered.measured()):
        assert painting is not None
        for _, picture in coverage_pictures(layout, painting):
            assert picture.std() > 0.05


@pytest.mark.parametrize("up", [1.0, -1.0], ids=["above", "below"])
@pytest.mark.parametrize("aside", [0.0, 300.0], ids=["straight", "aslant"])
def test_coverage_is_shown_from_the_side_of_the_cameras(up: float, aside: float) -> None:
    """Cameras below the part see its underside: a picture from above would show what none of them sees."""
    eyes = MIDDLE + up * np.array([[-100.0, aside, 900], [100.0, aside, 900]])
    mount = Mount("m", eyes, np.tile(MIDDLE, (2, 1)), ("cam",))
    face = LayoutFeature("f", Kind.POINT, [60.0, 80, 5 + 5 * up], position(1.0), normal=[0, 0, up])
    layout = plan_layout(scene(mounts=(mount,), features=(face,)), 2)
    (_, _, first), _ = pictures._sides(layout, part())
    assert np.sign(first.origin[2] - MIDDLE[2]) == up
