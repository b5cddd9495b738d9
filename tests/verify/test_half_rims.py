"""Holes of STEP files, whose rims are two edges each: their size is searched for as that of one rim."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.verify.edges.sightlines import sightlines
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Verdict

from .scene import photographed

pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')

PLATE = Path(__file__).resolve().parents[2] / "models/drilled_plate.step"
CAMERA = Camera.from_focal((1200, 900), 2700.0)  # 7 px a mm
MIDDLE = (60.0, 40.0, 5.0)
PLACES = [Rigid.look_at(eye, MIDDLE) for eye in ((75.0, 20.0, 380.0), (200.0, -200.0, 240.0), (-140.0, 180.0, 290.0))]
AT, RADIUS = (60.0, 60.0), 6.0


@cache
def plate() -> Part:
    return Part.of(read_model(PLATE))


def verified(larger: float, place: Rigid, limit: Limit) -> Verification:
    """Return the verdict on the hole of 12 mm, its radius `larger` (mm)."""
    mesh = plate().scene.mesh
    wall = np.abs(np.hypot(*(mesh.vertices[:, :2] - AT).T) - RADIUS) < 0.01
    vertices = mesh.vertices.copy()
    vertices[wall, :2] += larger * (vertices[wall, :2] - AT) / RADIUS
    gray = photographed(replace(mesh, vertices=vertices), np.random.default_rng(1), place, CAMERA)
    shot = Photo.of(gray, CAMERA, place, name="photo")
    box = np.array([[*np.subtract(AT, RADIUS + 1), -1], [*np.add(AT, RADIUS + 1), 11]])
    hole = Feature("hole", Selection(mesh.part_names[0], box=box), (limit,))
    return verify_part(plate(), [shot], refine_pose(plate(), [shot], Rigid()), Tolerances((hole,)))


@pytest.mark.parametrize(
    ("place", "larger"),
    [
        (PLACES[0], -0.5),
        (PLACES[1], 0.5),
        *(pytest.param(PLACES[k], mm, marks=pytest.mark.slow) for k, mm in ((0, 0.5), (1, -0.5), (2, 0.5), (2, -0.5))),
    ],
)
def test_a_hole_that_is_too_large_or_too_small_is_so_and_not_missing(place: Rigid, larger: float) -> None:
    """By 3.5 px all round; it was called missing or undecided, or a quarter of its rim was measured."""
    (profile,) = verified(larger, place, Limit(Quantity.PROFILE, 0.3)).judgements
    assert profile.verdict is Verdict.FAIL
    assert 0.45 < abs(profile.deviation) < 0.5 + 1.5 * profile.U  # of what is oblique a little less shows
    (size,) = verified(larger, place, Limit(Quantity.DIAMETER, 0.3)).judgements
    assert size.verdict is Verdict.FAIL
    assert abs(size.deviation - 2 * larger) < 1.5 * size.U < 0.1


@pytest.mark.parametrize("place", [*PLACES[:2], pytest.param(PLACES[2], marks=pytest.mark.slow)])
def test_a_hole_of_another_size_is_not_off_its_place(place: Rigid) -> None:
    """As two edges, its rims were measured where a displacement of 0.55 to 0.86 mm would have them."""
    for larger in (0.5, -0.5):
        limit = Limit(Quantity.POSITION, 0.3, axis=np.array([0.0, 0.0, 1.0]))
        (position,) = verified(larger, place, limit).judgements
        assert position.verdict is not Verdict.FAIL


def test_normals_of_both_halves_point_out_of_their_rim_as_told() -> None:
    photo = Photo.of(np.zeros((900, 1200), np.float32), CAMERA, PLACES[0])
    lines, _ = sightlines(plate(), [photo], Rigid())
    upper = np.abs(lines.p[:, 2] - 10) < 1e-6
    rim = upper & (np.abs(np.hypot(*(lines.p[:, :2] - AT).T) - RADIUS) < 0.01)
    assert len(np.unique(lines.edge[rim])) == 2
    assert len(np.unique(lines.rim[rim])) == 1
    centre = CAMERA.project(PLACES[0] @ np.array([[*AT, 10.0]]))[0]
    out = np.einsum("ni,ni->n", lines.normal[rim], lines.q[rim] - centre)
    np.testing.assert_array_equal(np.sign(out), lines.outward[rim])
