"""The sample parts: closed solids in the places and of the sizes they promise, the same every time."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import EdgeKind, edge_table, feature_edges
from cadcam.cad.formats.polygons import turn
from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import BENCH_POINTS, calibration_bench, machined_bracket, ship_block
from cadcam.cad.parts.shape import circle, filled
from cadcam.cad.read import read_model
from cadcam.errors import BadValue, UnknownName

from .solids import outward

EPS = np.finfo(float).eps
ROOT = Path(__file__).resolve().parents[2]
EYE = np.array([7.7, 416.0, -210.0])  # where the camera of Table 2.3 stands


def table_2_3(path: Path) -> np.ndarray:
    rows = [line for line in path.read_text().splitlines() if not line.startswith("#")][1:]
    return np.array([[float(x) for x in row.split(",")[:3]] for row in rows])


def blocked(mesh: Mesh, start: np.ndarray, end: np.ndarray) -> bool:
    """Return whether a triangle cuts the line from start to end before its last micrometre (Möller-Trumbore)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    d = end - start
    p = np.cross(d, c - a)
    det = np.einsum("ij,ij->i", b - a, p)
    safe = np.where(np.abs(det) > 1e-12, det, np.inf)
    u = np.einsum("ij,ij->i", start - a, p) / safe
    q = np.cross(start - a, b - a)
    v = q @ d / safe
    t = np.einsum("ij,ij->i", c - a, q) / safe
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1 - 1e-3 / np.linalg.norm(d))
    return bool((hit & np.isfinite(safe)).any())


def test_the_bench_points_are_those_of_table_2_3(shared) -> None:
    assert (table_2_3(shared("thesis/tables/table_2_3.csv")) == BENCH_POINTS).all()


def test_every_target_is_centred_on_its_point_and_faces_the_camera() -> None:
    bench = calibration_bench()
    for k, point in enumerate(BENCH_POINTS, 1):
        for what in ("dot", "ring"):
            mark = bench.subset([f"target {k} {what}"])
            weights = mark.face_areas / mark.face_areas.sum()
            centre = weights @ mark.vertices[mark.faces].mean(axis=1)
            assert np.allclose(centre, point, rtol=0, atol=1e-9)
            assert np.allclose(mark.face_normals, (0, 0, 1))


def test_from_the_camera_of_the_dissertation_only_target_eleven_is_hidden() -> None:
    bench = calibration_bench(sides=24)
    above = np.array([0, 0, 1e-3])
    hidden = [k for k, point in enumerate(BENCH_POINTS, 1) if blocked(bench, EYE, point + above)]
    assert hidden == [11]
    t = 2 * np.pi * np.arange(16) / 16
    rim = 20.0 * np.column_stack([np.cos(t), np.sin(t), 0 * t])
    for k, point in enumerate(BENCH_POINTS, 1):
        seen = [not blocked(bench, EYE, point + offset + above) for offset in rim]
        assert all(seen) or k == 11, k


def test_each_position_of_the_board_can_be_had_alone() -> None:
    near, far = calibration_bench(targets="near"), calibration_bench(targets="far")
    assert sum("ring" in name for name in near.part_names) == 8
    assert "target 16 ring" in far.part_names
    assert "target 1 ring" not in far.part_names
    with pytest.raises(UnknownName, match="middle"):
        calibration_bench(targets="middle")


def test_the_circles_of_a_target_are_drawn_and_its_back_is_closed() -> None:
    target = calibration_bench(targets="far").subset([f"target 9 {what}" for what in ("dot", "ring", "disc")])
    edges = feature_edges(target)
    radii = sorted(
        round(float(np.linalg.norm(line[0, :2] - BENCH_POINTS[8, :2])), 3) for line in edges.polylines(target)
    )
    assert radii == [6, 12, 20, 21.5, 21.5]
    assert outward(target) > 0


def closed_parts(mesh: Mesh) -> bool:
    return bool((edge_table(mesh).count == 2).all())


@pytest.mark.parametrize("triangles", [6_000, 10_000, 33_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_a_ship_block_has_about_the_triangles_asked_for_in_closed_plates(triangles: int) -> None:
    block = ship_block(triangles=triangles)
    assert block.n_faces == pytest.approx(triangles, rel=0.1)
    assert closed_parts(block)
    assert outward(block) > 0
    _, repairs = mend(block)
    assert repairs.lines() == []


@pytest.mark.slow
@pytest.mark.parametrize("triangles", [300_000, 1_000_000])
def test_a_large_ship_block_has_about_the_triangles_asked_for(triangles: int) -> None:
    block = ship_block(triangles=triangles)
    assert block.n_faces == pytest.approx(triangles, rel=0.1)
    assert closed_parts(block)


def test_a_ship_block_has_its_size_and_plates_of_real_thickness() -> None:
    block = ship_block(triangles=10_000, size=(5000.0, 3600.0, 1800.0))
    shell = block.subset(["tank top", "bottom shell", "centre girder", "side girder"])
    assert shell.size_mm.tolist() == [5000, 3600, 1800]
    for name in block.part_names:
        if name.startswith(("floor", "tank", "bottom", "centre", "side")):
            assert 8 <= block.subset([name]).size_mm.min() <= 20


def test_the_longitudinals_of_a_block_touch_the_floors_they_run_through() -> None:
    block = ship_block(triangles=10_000)
    pair = block.subset(["floor 1 port", "longitudinal 1 port"])
    edges = feature_edges(pair)
    contact = edges.of_kind(EdgeKind.CONTACT)
    # along the slot's side on both faces of the floor, up to where its corner begins, and across the floor's foot
    assert contact.lengths(pair).sum() == pytest.approx(2 * (240 - 30) + 10)


def test_requests_out_of_range_are_refused() -> None:
    with pytest.raises(BadValue, match="triangles"):
        ship_block(triangles=100)
    with pytest.raises(BadValue, match="size"):
        ship_block(size=(4000, 3000, 500))
    with pytest.raises(BadValue, match="sides"):
        machined_bracket(sides=30)


@pytest.mark.parametrize("sides", [12, 48, 120])
def test_the_bracket_is_watertight_and_weighs_what_its_drawing_says(sides: int) -> None:
    bracket = machined_bracket(sides=sides)
    assert bracket.size_mm.tolist() == [129, 80, 60]
    assert closed_parts(bracket)
    corner = 1 - np.pi / 4
    base = 120 * 80 * 12 - 2 * corner * 12**2 * 12 - 4 * np.pi * 4.5**2 * 12
    wall = 14 * (80 * 48 - 2 * corner * 18**2) - np.pi * 9**2 * 14
    fillet = corner * 10**2 * 80
    boss = np.pi * (16**2 - 9**2) * 9
    # the foot of the boss, by Pappus: area between quarter circle and its corner, turned about the bore
    area, arm = corner * 3**2, 16 + 3 * _centroid()
    foot = 2 * np.pi * arm * area
    true = base + wall + fillet + boss + foot
    # a polygon of n sides misses its circle by (2 pi / n)² / 6 of its area; round shapes make up less than a fifth
    assert outward(bracket) == pytest.approx(true, rel=0.2 * (2 * np.pi / sides) ** 2 / 6)


def _centroid() -> float:
    """Return how far the centroid of a unit square less its quarter disc lies from the corner it keeps."""
    quarter = np.pi / 4
    return 1 - (0.5 - quarter * 4 / (3 * np.pi)) / (1 - quarter)


@pytest.mark.parametrize("seed", range(20))
def test_a_plate_is_filled_but_for_its_holes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres = np.stack(np.meshgrid((30, 90, 150), (20, 60, 100)), axis=-1).reshape(-1, 2) + rng.uniform(-8, 8, (9, 2))
    holes = [circle(c, r, 40) for c, r in zip(centres, rng.uniform(2, 6, 9), strict=True)]
    points, triangles = filled([(0, 0), (180, 0), (180, 120), (0, 120)], holes)
    area = turn(*np.moveaxis(points[triangles], 1, 0)) / 2
    open_ = sum(turn(c, hole, np.roll(hole, -1, axis=0)).sum() for c, hole in zip(centres, holes, strict=True)) / 2
    assert area.min() > 0
    assert area.sum() == pytest.approx(180 * 120 - open_, abs=400 * EPS * 180 * 120)


def test_no_edge_of_the_bracket_is_a_tangent_seam_unless_asked_for() -> None:
    bracket = machined_bracket()
    edges = feature_edges(bracket)
    assert (edges.kind == EdgeKind.BREP).all()
    fillet = np.isin(bracket.surface[edges.faces], (42, 30))
    planes = np.isin(bracket.surface[edges.faces], (0, 20, 21, 31))
    assert not (fillet.any(axis=1) & planes.any(axis=1)).any()
    assert len(feature_edges(bracket, smooth_seams=True)) > len(edges)


def test_the_models_in_the_repository_are_those_the_example_writes(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("sample_parts", ROOT / "examples" / "sample_parts.py")
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.main(tmp_path / "one")
    example.main(tmp_path / "two")
    written = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert written == ["bench.glb", "bracket.stl", "shipblock_10k.obj"]
    for name in written:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
        kept, made = read_model(ROOT / "models" / name), read_model(tmp_path / "one" / name)
        assert kept.part_names == made.part_names
        assert (kept.faces == made.faces).all()
        # sines differ in the last bit between machines; files hold float32 or nine digits
        assert np.allclose(kept.vertices, made.vertices, rtol=1e-6, atol=1e-4)
    assert sum(path.stat().st_size for path in (ROOT / "models").iterdir()) < 2_000_000
