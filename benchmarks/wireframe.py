"""Visible wireframes: time, and share of wrong samples against float64, beside pyvista and Open CASCADE.

    python benchmarks/wireframe.py ../shared/data/cad_nist_ctc/nist_ctc_0{1,3,5}_asme1_ap242.stp

Prints two markdown tables. A peer that cannot be imported is left out with a line that says so. Peers:
pyvista (feature edges once; per view an off-screen z-buffer, and a depth test of every edge at 1 px steps) and Open
CASCADE (cadquery-ocp: exact and polygonal hidden-line removal on the STEP shape itself).

Wrong samples: points at random along all lines, visible and hidden, each judged in float64 against every triangle
(tests/render/reference.py). pyvista labels the points of cadcam's lines, with the depth tolerance that suits it best;
Open CASCADE labels points of its own sharp edges, judged with a tolerance of twice the tessellation's chord. Its
outlines lie on the true surface, which the judging tessellation does not resolve: they are timed but not judged.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.cad.edges import EdgeKind, feature_edges
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shipblock import ship_block
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Polylines
from cadcam.render.view import Scene

CAMERA = Camera.from_focal((1920, 1080), 1500.0)
CHORD_MM = 0.1  # of the tessellation of the STEP files


@dataclass(frozen=True)
class Row:
    """One method on one model: seconds once and per view (median), and the share of wrong samples (NaN: not judged)."""

    model: str
    method: str
    once: float
    view: float
    wrong: float


def timed(job: Callable[[], Any], repeat: int) -> tuple[float, Any]:
    """Return the median time in s, after one run to warm up where several are asked for, and the result."""
    result = job() if repeat > 1 else None
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        result = job()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), result


def looking_at(mesh: Mesh) -> Rigid:
    """Return the pose that sees the model from the front right above, filling most of the picture."""
    centre, diagonal = mesh.bounds.mean(axis=0), float(np.linalg.norm(mesh.size_mm))
    return Rigid.look_at(centre + diagonal * np.array([0.93, -0.97, 0.62]), centre)


def judge(mesh: Mesh, p: Array, eye: Array, tolerance: Array) -> Mask:
    """Return which points are visible, by the brute-force judge of the tests."""
    path = Path(__file__).resolve().parents[1] / "tests/render/reference.py"
    spec = importlib.util.spec_from_file_location("reference", path)
    if spec is None or spec.loader is None:
        sys.exit(f"{path} is missing: run from a source checkout")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return np.asarray(module.seen(mesh.vertices, mesh.faces, p, eye, tolerance))


def at_random(lines: Polylines, n: int, rng: np.random.Generator) -> tuple[Array, Ids]:
    """Return points (n, 3) spread evenly over the lines' length in the picture, and the kind of the line of each."""
    line = lines.line_of_point
    step = np.flatnonzero(line[1:] == line[:-1])
    length = np.linalg.norm(lines.q[step + 1] - lines.q[step], axis=1)
    k = rng.choice(step, n, p=length / length.sum())
    return lines.p[k] + rng.random((n, 1)) * (lines.p[k + 1] - lines.p[k]), lines.kind[line[k]]


@dataclass(frozen=True)
class Samples:
    """Points on all lines of a view, cadcam's word on them, and the judge's."""

    p: Array
    drawn: Mask
    seen: Mask


def ours(model: str, mesh: Mesh, pose: Rigid, n: int) -> tuple[Row, Samples]:
    once, drawer = timed(lambda: LineDrawer(Scene.of(mesh, edges=feature_edges(mesh))), 1)
    view, _ = timed(lambda: drawer.draw(CAMERA, pose), 9)
    wireframe = drawer.draw(CAMERA, pose, options=LineOptions(hidden=True, margin_px=0))
    rng = np.random.default_rng(1)
    lengths = [lines.length_px.sum() for lines in (wireframe.visible, wireframe.hidden)]
    share = lengths[0] / sum(lengths)
    m = round(n * share)
    parts = [at_random(wireframe.visible, m, rng), at_random(wireframe.hidden, n - m, rng)]
    p, kind = (np.concatenate([part[k] for part in parts]) for k in range(2))
    drawn = np.arange(n) < m
    diagonal = np.linalg.norm(mesh.size_mm)
    seen = judge(mesh, p, pose.origin, diagonal * np.where(kind == EdgeKind.CONTACT, 1e-5, 1e-6))
    return Row(model, "cadcam", once, view, float((drawn != seen).mean())), Samples(p, drawn, seen)


def with_pyvista(model: str, mesh: Mesh, pose: Rigid, samples: Samples) -> Row:
    import pyvista

    faces = np.column_stack([np.full(mesh.n_faces, 3), mesh.faces]).ravel()
    surface = pyvista.PolyData(np.asarray(mesh.vertices), faces)
    plotter = pyvista.Plotter(off_screen=True, window_size=list(CAMERA.size))
    plotter.disable_anti_aliasing()
    plotter.add_mesh(surface)

    def prepare() -> Array:
        edges = surface.extract_feature_edges(feature_angle=30.0)
        ends = edges.points[edges.lines.reshape(-1, 3)[:, 1:]].astype(np.float64)
        plotter.show(auto_close=False)
        return np.asarray(ends)

    once, ends = timed(prepare, 1)
    camera = plotter.camera
    camera.position, camera.focal_point = pose.origin, pose.origin + pose.rotation[2]
    camera.up, camera.view_angle = -pose.rotation[1], np.degrees(2 * np.arctan(CAMERA.height / 2 / CAMERA.fy))

    def depth() -> Array:
        plotter.renderer.reset_camera_clipping_range()
        plotter.render()
        return -np.asarray(plotter.get_image_depth(fill_value=-np.inf), np.float64)

    def view() -> Mask:
        a, b = (CAMERA.project(pose @ ends[:, k]) for k in range(2))
        count = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1)), 1).astype(int)
        i = np.repeat(np.arange(len(a)), count)
        t = (np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[i]
        return _in_front(ends[i, 0] + t[:, None] * (ends[i, 1] - ends[i, 0]), depth(), pose, 1e-3)

    seconds, _ = timed(view, 5)
    buffer = depth()
    wrong = [(_in_front(samples.p, buffer, pose, t) != samples.seen).mean() for t in np.geomspace(1e-6, 3e-2, 40)]
    return Row(model, "pyvista: feature edges + depth test", once, seconds, float(min(wrong)))


def _in_front(p: Array, depth: Array, pose: Rigid, tolerance: float) -> Mask:
    """Return which points are no deeper than the deepest of the four pixels around them, by a relative tolerance."""
    c = pose @ p
    q = np.floor(CAMERA.project(c))
    x, y = np.clip(q[:, 0], 0, CAMERA.width - 2).astype(int), np.clip(q[:, 1], 0, CAMERA.height - 2).astype(int)
    deepest = np.max([depth[y + j, x + i] for j in (0, 1) for i in (0, 1)], axis=0)
    return np.asarray(c[:, 2] <= deepest * (1 + tolerance))


def with_open_cascade(model: str, path: Path, mesh: Mesh, pose: Rigid, n: int) -> list[Row]:
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
    from OCP.HLRAlgo import HLRAlgo_Projector
    from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape, HLRBRep_PolyAlgo, HLRBRep_PolyHLRToShape
    from OCP.STEPControl import STEPControl_Reader

    def read() -> Any:
        reader = STEPControl_Reader()
        reader.ReadFile(str(path))
        reader.TransferRoots()
        return reader.OneShape()

    _, shape = timed(read, 1)
    focus = float((pose @ mesh.bounds.mean(axis=0))[2])
    foot = pose.origin + focus * pose.rotation[2]
    axes = gp_Ax2(gp_Pnt(*foot), gp_Dir(*-pose.rotation[2]), gp_Dir(*pose.rotation[0]))

    def exact() -> Any:
        algorithm = HLRBRep_Algo()
        algorithm.Add(shape)
        algorithm.Projector(HLRAlgo_Projector(axes, focus))
        algorithm.Update()
        algorithm.Hide()
        return algorithm

    def polygonal() -> Any:
        algorithm = HLRBRep_PolyAlgo()
        algorithm.Load(shape)
        algorithm.Projector(HLRAlgo_Projector(axes, focus))
        algorithm.Update()
        to_shape = HLRBRep_PolyHLRToShape()
        to_shape.Update(algorithm)
        return to_shape.VCompound(), to_shape.OutLineVCompound()

    seconds, algorithm = timed(exact, 3)
    p, drawn = _open_cascade_points(HLRBRep_HLRToShape(algorithm), n)
    camera = pose @ p
    p, drawn = p[CAMERA.sees(CAMERA.project(camera))], drawn[CAMERA.sees(CAMERA.project(camera))]
    seen = judge(mesh, p, pose.origin, np.full(len(p), 2 * CHORD_MM))
    once, _ = timed(lambda: BRepMesh_IncrementalMesh(shape, CHORD_MM, False, 0.35, False), 1)
    quick, _ = timed(polygonal, 3)
    return [
        Row(model, "Open CASCADE, exact", np.nan, seconds, float((drawn != seen).mean())),
        Row(model, "Open CASCADE, polygonal", once, quick, np.nan),
    ]


def _open_cascade_points(lines: Any, n: int) -> tuple[Array, Mask]:
    """Return points at random along Open CASCADE's sharp edges, and whether they came out as visible."""
    from OCP.BRepAdaptor import BRepAdaptor_Curve
    from OCP.GCPnts import GCPnts_AbscissaPoint
    from OCP.HLRBRep import HLRBRep_TypeOfResultingEdge as Kind
    from OCP.TopAbs import TopAbs_EDGE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    curves, lengths, visible = [], [], []
    for shown in (True, False):
        explorer = TopExp_Explorer(lines.CompoundOfEdges(Kind.HLRBRep_Sharp, shown, True), TopAbs_EDGE)
        while explorer.More():
            edge = TopoDS.Edge(explorer.Current()) if hasattr(TopoDS, "Edge") else TopoDS.Edge_s(explorer.Current())
            curve = BRepAdaptor_Curve(edge)
            curves.append(curve)
            lengths.append(GCPnts_AbscissaPoint.Length_s(curve))
            visible.append(shown)
            explorer.Next()
    rng = np.random.default_rng(2)
    chosen = rng.choice(len(curves), n, p=np.array(lengths) / sum(lengths))
    points = []
    for k in chosen.tolist():
        first, last = curves[k].FirstParameter(), curves[k].LastParameter()
        point = curves[k].Value(first + rng.random() * (last - first))
        points.append((point.X(), point.Y(), point.Z()))
    return np.array(points), np.array(visible)[chosen]


def table(rows: Sequence[Row]) -> str:
    """Return a markdown table; the ratio is to cadcam's time per view on the same model."""
    base = {row.model: row.view for row in rows if row.method == "cadcam"}
    lines = ["| model | method | once, ms | per view, ms | ratio | wrong samples |", "|---|---|---|---|---|---|"]
    for row in rows:
        once = "" if np.isnan(row.once) else f"{1000 * row.once:.0f}"
        wrong = "not judged" if np.isnan(row.wrong) else f"{row.wrong:.3%}"
        ratio = row.view / base[row.model]
        lines.append(f"| {row.model} | {row.method} | {once} | {1000 * row.view:.1f} | {ratio:.1f} | {wrong} |")
    return "\n".join(lines)


def has(module: str, what: str) -> bool:
    if importlib.util.find_spec(module) is None:
        print(f"{what} left out: {module} is not installed")
        return False
    return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", type=Path, nargs="*", help="STEP files")
    parser.add_argument("--triangles", type=int, nargs="*", default=[10_000, 100_000], help="sizes of the ship block")
    parser.add_argument("--samples", type=int, default=20_000)
    arguments = parser.parse_args()
    pyvista, occ = has("pyvista", "pyvista"), has("OCP", "Open CASCADE")
    rows: list[Row] = []
    for triangles in arguments.triangles:
        mesh = ship_block(triangles=triangles)
        name, pose = f"ship block, {mesh.n_faces} triangles", looking_at(mesh)
        row, samples = ours(name, mesh, pose, arguments.samples)
        rows += [row] + ([with_pyvista(name, mesh, pose, samples)] if pyvista else [])
    for path in arguments.step:
        mesh = read_model(path, chordal_tolerance_mm=CHORD_MM)
        name, pose = f"{path.stem}, {mesh.n_faces} triangles", looking_at(mesh)
        row, samples = ours(name, mesh, pose, arguments.samples)
        rows += [row] + ([with_pyvista(name, mesh, pose, samples)] if pyvista else [])
        rows += with_open_cascade(name, path, mesh, pose, arguments.samples // 4) if occ else []
    print(table(rows))


if __name__ == "__main__":
    main()
