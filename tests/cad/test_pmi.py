"""Semantic PMI of STEP files: what is stated comes out in mm, with its faces; what is broken is told."""

import random
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.edges import feature_edges
from cadcam.cad.pmi.bores import bores_of
from cadcam.cad.pmi.chains import chains_of
from cadcam.cad.pmi.exchange import Exchange
from cadcam.cad.pmi.fits import fit_limits_mm
from cadcam.cad.pmi.read import read_pmi
from cadcam.cad.pmi.stated import Pmi
from cadcam.cad.read import read_model
from cadcam.errors import UnreadableFile

from .drawn_plate import HOLES, drawn_plate

_EPS = np.finfo(np.float64).eps


def _pmi(tmp_path, text: str) -> Pmi:
    path = tmp_path / "plate.step"
    path.write_text(text)
    return read_pmi(path)


@pytest.mark.parametrize("unit_mm", [1.0, 25.4])
def test_tolerances_are_read_in_mm(tmp_path, unit_mm):
    pmi = _pmi(tmp_path, drawn_plate(unit_mm))
    stated = {t.name: t for t in pmi.tolerances}
    widths = {"pair": 0.4, "small": 0.3, "front": 0.5, "back": 0.5, "flat": 0.1, "upright": 0.2}
    assert {name: t.mm for name, t in stated.items()} == pytest.approx(widths, rel=8 * _EPS)
    assert {name: t.characteristic for name, t in stated.items()} == {
        "pair": "position",
        "small": "position",
        "front": "surface profile",
        "back": "surface profile",
        "flat": "flatness",
        "upright": "perpendicularity",
    }
    assert [name for name, t in stated.items() if t.diametral] == ["pair", "small", "upright"]
    assert [stated[name].datums for name in ("pair", "flat", "upright")] == [("A", "B", "C"), (), ("A",)]
    assert stated["small"].modifiers == ("maximum material requirement",)
    assert stated["back"].outside_mm == pytest.approx(0.5, rel=8 * _EPS)
    assert stated["front"].outside_mm is None
    assert pmi.others == ("angle",)


@pytest.mark.parametrize("unit_mm", [1.0, 25.4])
def test_sizes_have_their_limits_in_mm(tmp_path, unit_mm):
    sizes = _pmi(tmp_path, drawn_plate(unit_mm)).sizes
    limits = [s.limits_mm for s in sizes]
    assert [s.kind for s in sizes] == ["diameter", "diameter", "diameter", "linear distance"]
    assert limits[0] == pytest.approx((19.9, 20.1), rel=8 * _EPS)
    assert limits[1] == pytest.approx((12.0, 12.2), rel=8 * _EPS)
    assert (sizes[2].fit, limits[2]) == ("H11", pytest.approx((8.0, 8.09), rel=8 * _EPS))
    assert limits[3] == pytest.approx((29.8, 30.2), rel=8 * _EPS)


@pytest.mark.parametrize(
    ("fit", "nominal", "limits"),
    [
        ("H7", 25.0, (25.0, 25.021)),
        ("H7", 30.0, (30.0, 30.021)),
        ("H7", 30.001, (30.001, 30.026)),
        ("h6", 50.0, (49.984, 50.0)),
        ("H11", 100.0, (100.0, 100.22)),
        ("JS13", 400.0, (399.555, 400.445)),
        ("g6", 25.0, None),
        ("H7", 501.0, None),
        ("H4", 10.0, None),
        ("H15", 10.0, None),
    ],
)
def test_limits_of_fits_are_those_of_the_standard(fit, nominal, limits):
    assert fit_limits_mm(fit, nominal) == (limits if limits is None else pytest.approx(limits, rel=4 * _EPS))


@pytest.mark.parametrize("unit_mm", [1.0, 25.4])
def test_the_halves_of_a_hole_are_one(tmp_path, unit_mm):
    pmi = _pmi(tmp_path, drawn_plate(unit_mm))
    pair = next(t for t in pmi.tolerances if t.name == "pair")
    for bore, name in zip(bores_of(pair), ("left", "right"), strict=True):
        x, y, radius = HOLES[name]
        assert bore.kind == "hole"
        assert bore.radius == pytest.approx(radius, rel=8 * _EPS)
        np.testing.assert_allclose(bore.centre, [x, y, 5.0], atol=8 * _EPS * 120)
        np.testing.assert_allclose(bore.axis, [0, 0, 1], atol=_EPS)
        assert len(bore.rims) == 4  # two arcs above, two below


def test_datums_have_their_faces(tmp_path):
    datums = {d.letter: d for d in _pmi(tmp_path, drawn_plate()).datums}
    assert [face.surface for face in datums["A"].faces] == ["plane"]
    np.testing.assert_allclose(datums["A"].faces[0].direction, [0, 0, 1], atol=_EPS)
    assert datums["A"].faces[0].outer == 4  # its rims are not part of the way round it
    assert len(datums["A"].faces[0].curves) == 4 + 2 * len(HOLES)
    assert [face.surface for face in datums["B"].faces] == ["cylinder", "cylinder"]


@pytest.mark.parametrize("unit_mm", [1.0, 25.4])
def test_rims_are_found_among_the_edges_of_the_mesh(tmp_path, unit_mm):
    """All vertices of their chains lie on the circle of the drawing, as exactly as the mesh's float32 hold it."""
    pytest.importorskip("cascadio", reason="reading STEP needs the extra step")
    pmi = _pmi(tmp_path, drawn_plate(unit_mm))
    mesh = read_model(tmp_path / "plate.step")
    edges = feature_edges(mesh)
    bores = [bore for size in pmi.sizes if size.other is None for bore in bores_of(size)]
    chain = chains_of([rim for bore in bores for rim in bore.rims], mesh, edges)
    assert len(bores) == 4
    for bore in bores:
        assert len({chain[rim.number] for rim in bore.rims}) == 4
        for rim in bore.rims:
            on = mesh.vertices[edges.vertices[edges.chain == chain[rim.number]]].reshape(-1, 3) - rim.centre
            np.testing.assert_allclose(np.linalg.norm(on[:, :2], axis=1), bore.radius, atol=4 * 2.0**-24 * 120)
            np.testing.assert_allclose(on[:, 2], 0, atol=4 * 2.0**-24 * 120)
            half = np.sign(on[:, 1][np.abs(on[:, 1]) > 1e-3])
            assert abs(half.sum()) == len(half) > 4  # the vertices of this arc, not of its other half


def test_seams_and_smooth_edges_have_no_chain(tmp_path):
    pytest.importorskip("cascadio", reason="reading STEP needs the extra step")
    pmi = _pmi(tmp_path, drawn_plate())
    mesh = read_model(tmp_path / "plate.step")
    halves = next(t for t in pmi.tolerances if t.name == "small").faces
    seams = {c.number for c in halves[0].curves if not np.isfinite(c.radius)}
    assert len(seams) == 2
    assert seams.isdisjoint(chains_of(halves[0].curves, mesh, feature_edges(mesh)))


def test_what_is_broken_is_told_and_the_rest_is_read(tmp_path):
    text = drawn_plate()
    number = text.partition("GEOMETRIC_TOLERANCE('pair','',#")[2].partition(",")[0]
    pmi = _pmi(tmp_path, text.replace(f"'pair','',#{number}", "'pair','',#98765"))
    assert [t.name for t in pmi.tolerances] == ["small", "front", "back", "flat", "upright"]
    said, angle = pmi.others
    assert angle == "angle"
    assert "refers to #98765, which it does not have" in said


def test_names_are_one_line_that_can_be_printed(tmp_path):
    pmi = _pmi(tmp_path, drawn_plate().replace("'pair'", r"'pa\X\0Air \X\1B[31m'"))
    assert pmi.tolerances[0].name == "pa ir [31m"


def test_a_file_without_tolerances_has_none(tmp_path):
    words = ("TOLERANCE", "DIMENSION", "ANGULAR")
    text = "\n".join(line for line in drawn_plate().splitlines() if not any(w in line for w in words))
    assert not _pmi(tmp_path, text)


def test_a_file_that_is_not_there_is_one_clear_error(tmp_path):
    with pytest.raises(UnreadableFile, match=r"plate\.step: cannot be read"):
        read_pmi(tmp_path / "plate.step")


def test_damaged_files_never_break_the_reader(tmp_path):
    """Of files with bytes changed, cut and inserted some statements are lost, and told; there are no other errors."""
    whole, chance = drawn_plate().encode(), random.Random(0)
    scraps = (b"", b"#1", b"'", b"(", b"$", b"1E999", b"\xff", b";")
    path = tmp_path / "plate.step"
    told = 0
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(chance.choice((1, 10, 80))):
            at = chance.randrange(1000, len(data) - 1)
            data[at : at + chance.choice((0, 1, 40))] = chance.choice(scraps)
        path.write_bytes(data)
        pmi = read_pmi(path)
        told += bool(pmi.others)
        for stated in (*pmi.tolerances, *pmi.sizes, *pmi.datums):
            bores_of(stated)
    assert told > 20


def test_entities_are_parsed_as_the_standard_writes_them():
    data = rb"""ISO-10303-21;HEADER;ENDSEC;DATA;
#1=( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );
#2 = SHAPE_ASPECT('it''s; #1 (\X2\00E9\X0\)\X\E4', $, #1, .T.);/* a comment; #3 */
#4=MEASURE_WITH_UNIT(LENGTH_MEASURE(-2.5E-1),#1);
#5=CARTESIAN_POINT('',(1.,2,+3.E0));
"""
    file = Exchange("a.step", data)
    assert file[1] == {"LENGTH_UNIT": [], "NAMED_UNIT": [None], "SI_UNIT": ["MILLI", "METRE"]}
    assert file[2] == {"SHAPE_ASPECT": ["it's; #1 (é)ä", None, 1, "T"]}
    assert file[4] == {"MEASURE_WITH_UNIT": [("LENGTH_MEASURE", [-0.25]), 1]}
    assert file[5] == {"CARTESIAN_POINT": ["", [1.0, 2.0, 3.0]]}
    assert list(file.having("LENGTH_UNIT", "CARTESIAN_POINT")) == [1, 5]
    with pytest.raises(UnreadableFile, match="refers to #6, which it does not have"):
        file[6]


@pytest.mark.parametrize("body", [b"POINT(1.", b"POINT 1", b"(A() 2)", b"POINT(1 2)", b"POINT(?)"])
def test_what_is_no_entity_is_one_clear_error(body):
    with pytest.raises(UnreadableFile, match="#1 is no entity"):
        Exchange("a.step", b"DATA;#1=" + body + b";")[1]


# of the NIST test cases, as their sheets state them: (characteristic, width), diameters with their limits; 3 is in inch
_STATED = {
    1: (1.0, {("position", 0.75), ("surface profile", 1.25), ("surface profile", 0.5), ("perpendicularity", 1.5)},
        {(35.0, 34.8, 35.0), (35.0, 35.0, 35.2), (20.0, 19.9, 20.05), (20.0, 19.95, 20.1), (25.0, 24.85, 25.15)}),
    3: (25.4, {("position", 0.05), ("position", 0.06), ("position", 0.02), ("angularity", 0.04), ("flatness", 0.005)},
        {(0.438, 0.433, 0.443), (0.625, 0.62, 0.63), (2.0, 1.99, 2.01), (1.5, 1.495, 1.505), (1.065, 1.062, 1.068)}),
}  # fmt: skip


@pytest.mark.parametrize("number", _STATED)
def test_the_tolerances_of_nist_s_test_cases_are_those_of_their_sheets(shared, number):
    pmi = read_pmi(shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_ap242.stp"))
    unit, tolerances, sizes = _STATED[number]
    assert tolerances <= {(t.characteristic, round(t.mm / unit, 4)) for t in pmi.tolerances}
    limits = [(s.nominal_mm, *s.limits_mm) for s in pmi.sizes if s.kind == "diameter" and s.limits_mm]
    assert sizes <= {tuple(round(value / unit, 4) for value in one) for one in limits}
    assert all(t.faces for t in pmi.tolerances)


@pytest.mark.parametrize("number", [1, 3, 5, *(pytest.param(number, marks=pytest.mark.slow) for number in (2, 4))])
def test_rims_of_nist_s_test_cases_lie_on_their_circles(shared, number):
    """Of each bore that is toleranced the rims are chains of the mesh, all of whose vertices lie on the circle."""
    pytest.importorskip("cascadio", reason="reading STEP needs the extra step")
    path = shared(f"data/cad_nist_ctc/nist_ctc_0{number}_asme1_ap242.stp")
    pmi, mesh = read_pmi(path), read_model(path)
    edges = feature_edges(mesh)
    bores = [bore for size in pmi.sizes if size.other is None for bore in bores_of(size)]
    chain = chains_of([rim for bore in bores for rim in bore.rims], mesh, edges)
    eps = 16 * 2.0**-24 * np.linalg.norm(mesh.size_mm)
    checked = 0
    for rim in (rim for bore in bores for rim in bore.rims if rim.number in chain):
        on = mesh.vertices[edges.vertices[edges.chain == chain[rim.number]]].reshape(-1, 3) - rim.centre
        along = on @ rim.axis
        np.testing.assert_allclose(along, 0, atol=eps)
        np.testing.assert_allclose(np.linalg.norm(on - along[:, None] * rim.axis, axis=1), rim.radius, atol=eps)
        checked += 1
    assert checked >= {1: 28, 2: 36, 3: 44, 4: 200, 5: 2}[number]


def test_the_plate_among_the_models_is_this_one():
    """`python tests/cad/drawn_plate.py > models/drilled_plate.step` writes it."""
    assert (Path(__file__).resolve().parents[2] / "models/drilled_plate.step").read_text() == drawn_plate()
