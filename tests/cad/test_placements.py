"""PMI of an assembly: what a file states of a component holds for each of its occurrences, at its place there."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.pmi.bores import bores_of
from cadcam.cad.pmi.exchange import Exchange
from cadcam.cad.pmi.placements import Placements
from cadcam.cad.pmi.read import read_pmi
from cadcam.cad.read import read_model
from cadcam.geometry.rigid import Rigid
from cadcam.render.view import Scene
from cadcam.verify.tolerances.drawing import drawing_template
from cadcam.verify.tolerances.file import read_tolerances

from .drawn_plate import HOLES, stated_plate

_EPS = np.finfo(np.float64).eps
UPRIGHT = ((300.0, 10.0, 20.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8))  # origin, z, x
TURNED = ((0.0, 0.0, 200.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))


def written(folder: Path, *, unit_mm: float = 1.0, turned: bool = False) -> Path:
    plate = stated_plate(unit_mm)
    plate.assemble(UPRIGHT, TURNED, turned=turned)
    (folder / "plates.step").write_text(plate.whole())
    return folder / "plates.step"


def placed(place: tuple[tuple[float, ...], ...]) -> Rigid:
    origin, z, x = map(np.array, place)
    return Rigid(np.column_stack([x, np.cross(z, x), z]), origin)


@pytest.mark.parametrize(("unit_mm", "turned"), [(1.0, False), (25.4, False), (1.0, True)])
def test_each_occurrence_states_its_tolerances_at_its_place(tmp_path: Path, unit_mm: float, turned: bool) -> None:
    """Whichever of the two models an exporter relates to the other."""
    pmi = read_pmi(written(tmp_path, unit_mm=unit_mm, turned=turned))
    pairs = [t for t in pmi.tolerances if t.name == "pair"]
    assert [t.datums for t in pairs] == [("A", "B", "C"), ("A.2", "B.2", "C.2")]
    assert {d.letter for d in pmi.datums} == {"A", "B", "C", "A.2", "B.2", "C.2"}
    fronts = [t.faces[0] for t in pmi.tolerances if t.name == "front"]
    for place, pair, front in zip((UPRIGHT, TURNED), pairs, fronts, strict=True):
        pose = placed(place)
        bores = bores_of(pair)
        expected = [pose @ np.array([x, y, 5.0]) for x, y, _ in (HOLES["left"], HOLES["right"])]
        np.testing.assert_allclose([b.centre for b in bores], expected, rtol=0, atol=16 * _EPS * 500)
        np.testing.assert_allclose([np.cross(b.axis, pose.rotation[:, 2]) for b in bores], 0, atol=16 * _EPS)
        np.testing.assert_allclose(front.direction, -pose.rotation[:, 1], atol=16 * _EPS)
    curves = [{c.number for face in t.faces for c in face.curves} for t in pairs]
    assert curves[0].isdisjoint(curves[1])


@pytest.mark.parametrize("turned", [False, True])
def test_an_assembly_s_tolerance_file_holds_of_the_datum_s_own_plate(tmp_path: Path, turned: bool) -> None:
    """Open CASCADE puts the plates where the tolerances are found on them; with other letters it is the other one."""
    pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')
    path = written(tmp_path, turned=turned)
    scene, pmi = Scene.of(read_model(path)), read_pmi(path)
    for letters, part in ((["A", "B", "C"], "plate 1"), (["A.2", "B.2", "C.2"], "plate 2")):
        (tmp_path / "tolerances.yaml").write_text(drawing_template(scene, pmi, path.name, letters=letters))
        found = read_tolerances(tmp_path / "tolerances.yaml")
        found.check(scene)
        assert {selection.part for selection in found.datum} == {part}
        of = [f.selection.part for f in found.features if any(limit.axis is not None for limit in f.limits)]
        assert of == [part] * 3
        assert len(found.features) == 2 * 4 + 2  # diameters do not refer to a datum: those of both plates


def test_places_of_assemblies_within_assemblies_and_within_themselves() -> None:
    def text(*usages: tuple[int, int, float]) -> bytes:
        lines = ["#1=DIRECTION('',(0.,0.,1.))", "#2=DIRECTION('',(1.,0.,0.))", "#3=CARTESIAN_POINT('',(0.,0.,0.))"]
        lines += ["#4=AXIS2_PLACEMENT_3D('',#3,#1,#2)"]
        for n, (assembly, component, x) in enumerate(usages):
            a = 100 + 10 * n
            lines += [
                f"#{a}=CARTESIAN_POINT('',({x},0.,0.))",
                f"#{a + 1}=AXIS2_PLACEMENT_3D('',#{a},#1,#2)",
                f"#{a + 2}=ITEM_DEFINED_TRANSFORMATION('','',#4,#{a + 1})",
                f"#{a + 3}=(REPRESENTATION_RELATIONSHIP('','',#5,#6) "
                f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{a + 2}))",
                f"#{a + 4}=NEXT_ASSEMBLY_USAGE_OCCURRENCE('','','',#{assembly},#{component},$)",
                f"#{a + 5}=PRODUCT_DEFINITION_SHAPE('','',#{a + 4})",
                f"#{a + 6}=CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{a + 3},#{a + 5})",
            ]
        return ("DATA;" + "".join(f"{line};" for line in lines)).encode()

    def places(component: int, *usages: tuple[int, int, float]) -> list[float]:
        return [float(p.translation[0]) for p in Placements(Exchange("a.step", text(*usages)), 10.0).of(component)]

    assert places(50, (51, 50, 1.0), (51, 50, 2.0), (52, 51, 10.0), (52, 51, 20.0)) == [110, 210, 120, 220]
    assert places(52, (51, 50, 1.0), (52, 51, 10.0)) == [0]
    assert places(50, (51, 50, 1.0), (50, 51, 2.0)) == [10]


@pytest.mark.parametrize("damaged", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_damaged_assemblies_never_break_the_reader(tmp_path: Path, damaged: int) -> None:
    data, chance = written(tmp_path).read_bytes(), random.Random(0)
    begin, scraps = data.rindex(b"PRODUCT('pair of plates'"), (b"", b"#1", b"'", b"(", b"$", b"(1.)", b"\xff", b";")
    for _ in range(damaged):
        broken = bytearray(data)
        for _ in range(chance.choice((1, 5, 20))):
            at = chance.randrange(begin, len(broken) - 1)
            broken[at : at + chance.choice((0, 1, 3))] = chance.choice(scraps)
        (tmp_path / "broken.step").write_bytes(broken)
        found = read_pmi(tmp_path / "broken.step")
        assert len(found.tolerances) + len(found.others) >= 6 + 1  # lost only where it is told
