"""STEP: the NIST test parts have their true size and a wireframe of true B-rep edges, in AP203 and AP242 alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import EdgeKind, edge_table, feature_edges
from cadcam.cad.formats.gltf import Shape
from cadcam.cad.formats.step import by_product
from cadcam.cad.mesh import Mesh
from cadcam.cad.read import LoadReport, read_model_with_report
from cadcam.errors import BadValue, MissingExtra

from .solids import outward

pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')

# length, width, height in mm of the solids; drawing notes of AP203 files reach beyond them
SIZES = {
    1: (800.0, 450.0, 150.0),
    2: (680.0, 860.0, 400.0),
    3: (302.97, 485.4, 162.69),
    4: (500.0, 780.0, 130.6),
    5: (527.1, 558.8, 482.6),
}
NUMBERS = [pytest.param(number, marks=[pytest.mark.slow] * (number in (2, 4))) for number in SIZES]
PROTOCOLS = ("ap203", "ap242")


@lru_cache
def loaded(path: Path) -> tuple[Mesh, LoadReport]:
    return read_model_with_report(path)


def nist(shared: Callable[[str], Path], number: int, protocol: str) -> tuple[Mesh, LoadReport]:
    return loaded(shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_{protocol}.stp"))


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("number", NUMBERS)
def test_a_nist_part_has_the_size_of_its_solid_and_is_closed(
    shared: Callable[[str], Path], number: int, protocol: str
) -> None:
    mesh, report = nist(shared, number, protocol)
    # the chordal tolerance: 5e-5 of a diagonal of about 1 m, where a curved face bounds the part
    assert np.allclose(mesh.size_mm, SIZES[number], atol=0.1)
    assert report.unit_source == "file"
    assert len(mesh.part_names) == 1
    assert report.repairs.open_edges == report.repairs.non_manifold_edges == 0
    assert outward(mesh) > 0
    assert (mesh.surface >= 0).all()


@pytest.mark.parametrize("number", NUMBERS)
def test_both_protocols_describe_the_same_solid(shared: Callable[[str], Path], number: int) -> None:
    one, other = (nist(shared, number, protocol)[0] for protocol in PROTOCOLS)
    assert np.allclose(one.size_mm, other.size_mm, atol=0.1)
    # facets stay inside convex and outside concave faces by at most the chordal tolerance
    assert outward(one) == pytest.approx(outward(other), abs=0.06 * one.face_areas.sum())


def test_names_of_products_are_kept(shared: Callable[[str], Path]) -> None:
    assert nist(shared, 1, "ap242")[0].part_names == ("NIST Complex Test Case 1",)
    assert nist(shared, 5, "ap242")[0].part_names == ("nist_ctc_05_asme1",)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("number", NUMBERS)
def test_the_wireframe_is_made_of_sharp_edges_between_surfaces_only(
    shared: Callable[[str], Path], number: int, protocol: str
) -> None:
    mesh, _ = nist(shared, number, protocol)
    edges = feature_edges(mesh)
    assert (edges.kind == EdgeKind.BREP).all()
    assert (mesh.surface[edges.faces[:, 0]] != mesh.surface[edges.faces[:, 1]]).all()
    # every bend of more than 60 degrees between two surfaces is in it: nothing sharp is lost to the seam rule
    table = edge_table(mesh)
    between = mesh.surface[table.faces[:, 0]] != mesh.surface[table.faces[:, 1]]
    sharp = between & (table.angle > np.radians(60))
    drawn = {tuple(sorted(pair)) for pair in edges.faces.tolist()}
    missed = [pair for pair in table.faces[sharp].tolist() if tuple(sorted(pair)) not in drawn]
    assert len(missed) == 0


ENTITY = re.compile(r"#(\d+)\s*=\s*([A-Z_0-9]+)\s*\(((?:[^;']|'[^']*')*)\)\s*;", re.DOTALL)


def brep_length(path: Path) -> float:
    """Return the total length in file units of the straight and circular edges between two different faces."""
    entities = {int(n): (kind, body) for n, kind, body in ENTITY.findall(path.read_text("latin-1"))}

    def numbers(reference: int) -> list[int]:
        return [int(n) for n in re.findall(r"#(\d+)", entities[reference][1])]

    def point(reference: int) -> np.ndarray:
        return np.array([float(x) for x in re.findall(r"[-+]?\d*\.\d*(?:[Ee][-+]?\d+)?", entities[reference][1])])

    users: dict[int, set[int]] = {}
    for face, (kind, _) in entities.items():
        if kind == "ADVANCED_FACE":
            for bound in (n for n in numbers(face) if entities[n][0] in ("FACE_BOUND", "FACE_OUTER_BOUND")):
                for oriented in numbers(numbers(bound)[0]):
                    users.setdefault(numbers(oriented)[-1], set()).add(face)
    total = 0.0
    for edge, faces in users.items():
        if len(faces) < 2:
            continue  # the seam of a closed surface is no edge
        start, end, curve = numbers(edge)
        a, b = (point(numbers(v)[0]) for v in (start, end))
        kind, body = entities[curve]
        if kind in ("SURFACE_CURVE", "SEAM_CURVE"):
            curve = numbers(curve)[0]
            kind, body = entities[curve]
        assert kind in ("LINE", "CIRCLE"), kind
        if kind == "LINE":
            total += float(np.linalg.norm(b - a))
            continue
        placement, radius = numbers(curve)[0], float(body.rsplit(",", 1)[1])
        centre, axis, *_ = numbers(placement)
        c, n = point(centre), point(axis)
        n = n if entities[edge][1].rsplit(",", 1)[1].strip() == ".T." else -n
        u = (a - c) / radius
        angle = np.arctan2((b - c) @ np.cross(n, u), (b - c) @ u) % (2 * np.pi)
        total += radius * (angle if start != end and angle > 1e-9 else 2 * np.pi)
    return total


@pytest.mark.parametrize(("number", "protocol", "mm"), [(3, "ap203", 25.4), (3, "ap242", 1.0)])
def test_all_edges_together_are_as_long_as_the_curves_in_the_file(
    shared: Callable[[str], Path], number: int, protocol: str, mm: float
) -> None:
    path = shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_{protocol}.stp")
    mesh, _ = loaded(path)
    edges = feature_edges(mesh, smooth_seams=True)
    # a chord spans at most 0.2 rad and is shorter than its arc by at most 0.2² / 24
    true = mm * brep_length(path)
    assert true * (1 - 0.2**2 / 24) <= edges.lengths(mesh).sum() <= true * (1 + 1e-6)


def test_a_finer_tolerance_gives_more_triangles_nearer_to_the_surface(shared: Callable[[str], Path]) -> None:
    path = shared("data/cad_nist_ctc/nist_ctc_01_asme1_ap242.stp")
    coarse, fine = (read_model_with_report(path, chordal_tolerance_mm=t)[0] for t in (1.0, 0.01))
    assert fine.n_faces > 1.5 * coarse.n_faces
    with pytest.raises(BadValue, match="chordal_tolerance_mm"):
        read_model_with_report(path, chordal_tolerance_mm=0)


def test_the_tolerance_is_in_mm_whatever_the_unit_of_the_file(shared: Callable[[str], Path]) -> None:
    inch, mm = (nist(shared, 3, protocol) for protocol in PROTOCOLS)
    assert (inch[1].unit, mm[1].unit) == ("in", "mm")
    assert inch[0].n_faces == pytest.approx(mm[0].n_faces, rel=0.25)  # 25 times the tolerance would give a third


def test_a_unit_against_the_one_in_the_file_is_refused(shared: Callable[[str], Path]) -> None:
    with pytest.raises(BadValue, match="which the file names itself"):
        read_model_with_report(shared("data/cad_nist_ctc/nist_ctc_03_asme1_ap203.stp"), unit="mm")


def test_trimesh_is_not_loaded_for_it(
    shared: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it is installed cascadio imports it, and with it half of SciPy, which takes longer than most parts."""
    (tmp_path / "trimesh.py").write_text("raise RuntimeError('was loaded')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert read_model_with_report(shared("data/cad_nist_ctc/nist_ctc_01_asme1_ap203.stp"))[0].n_faces


def test_without_the_extra_the_remedy_is_named(shared: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cadcam.cad.formats.step.find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r'pip install "cadcam\[step\]", or cascadio by itself'):
        read_model_with_report(shared("data/cad_nist_ctc/nist_ctc_01_asme1_ap203.stp"))


def iges(unit: str) -> bytes:
    """Return a rectangle of 10 by 20 as a surface ruled between two lines; unit: flag and name."""
    program, written = "1H,,1H;,1Hx,1Hx,1Hx,1Hx,32,38,6,308,15,1Hx,1.", "15H20261127.000000,1E-7,30.,1Hx,1Hx,11,0;"
    g = f"{program},{unit},1,0.01,{written}"
    parameters = ("110,0.,0.,0.,10.,0.,0.;", "110,0.,20.,0.,10.,20.,0.;", "118,1,3,0,0;")
    rows: dict[str, list[str]] = {"S": ["a"], "G": [g[i : i + 72] for i in range(0, len(g), 72)], "D": [], "P": []}
    for k, text in enumerate(parameters):
        kind, status = text[:3], "00010000" if k < 2 else "00000000"
        rows["D"] += [f"{kind:>8}{k + 1:8}" + f"{0:8}" * 6 + status, f"{kind:>8}{0:8}{0:8}{1:8}{0:8}"]
        rows["P"].append(f"{text:64}{2 * k + 1:8}")
    rows["T"] = ["".join(f"{section}{len(own):7}" for section, own in rows.items())]
    return "".join(f"{row:72}{s}{n:7}\n" for s, own in rows.items() for n, row in enumerate(own, 1)).encode()


@pytest.mark.parametrize(("unit", "mm"), [("2,2HMM", 1.0), ("1,4HINCH", 25.4), ("6,1HM", 1000.0)])
def test_an_iges_file_has_the_size_that_its_unit_says(tmp_path: Path, unit: str, mm: float) -> None:
    """All of them were a thousand times as large: of IGES, Open CASCADE writes mm where glTF asks for metres."""
    path = tmp_path / "part.igs"
    path.write_bytes(iges(unit))
    size = read_model_with_report(path)[0].size_mm
    assert np.allclose(size, [10 * mm, 20 * mm, 0.0], rtol=4 * np.finfo(np.float32).eps, atol=0)


@pytest.mark.parametrize(
    ("occurrence", "product", "name"),
    [
        ("NAUO12", "Träger", "Träger"),
        ("12", "Träger", "Träger"),
        ("next assembly relationship", "Träger", "Träger"),
        ("Träger links", "Träger", "Träger links"),
        ("M12", "bolt", "M12"),
        ("NAUO12", "", "NAUO12"),
    ],
)
def test_an_occurrence_that_is_only_counted_has_the_name_of_its_product(
    occurrence: str, product: str, name: str
) -> None:
    assert by_product(Shape(("assembly", occurrence), np.eye(4), product, [])).names == ("assembly", name)
