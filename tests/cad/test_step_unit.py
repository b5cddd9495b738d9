"""The unit of a STEP file is what its factor says, under whatever name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.formats.step_unit import LengthUnit, declared_unit
from cadcam.cad.read import LoadReport, read_model_with_report
from cadcam.errors import UnreadableFile

MILLI, METRE = ".MILLI.,.METRE.", "$,.METRE."


def units(length: str) -> bytes:
    """Return the units of a file: length is the entity #5, with those that it refers to from #6 on."""
    context = "#1=(GLOBAL_UNIT_ASSIGNED_CONTEXT((#3,#5,#4))REPRESENTATION_CONTEXT('a','b'));"
    degree = "#3=(CONVERSION_BASED_UNIT('DEGREE',#9)NAMED_UNIT(*)PLANE_ANGLE_UNIT());"
    return "\n".join((context, degree, "#4=(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT());", length)).encode()


def converted(name: str, factor: str, base: str = MILLI) -> str:
    return f"""#5=(
CONVERSION_BASED_UNIT('{name}',#6)
LENGTH_UNIT()
NAMED_UNIT(#8)
);
#6=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({factor}),#7);
#7=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({base}));"""


@pytest.mark.parametrize(
    ("length", "name", "mm", "called"),
    [
        (converted("INCH", "25.4"), "in", 25.4, ""),
        (converted("INCH", "2.54E1"), "in", 25.4, ""),
        (converted("INCH", "0.0254", METRE), "in", 25.4, ""),
        (converted("INCH", "2.54", ".CENTI.,.METRE."), "in", 25.4, ""),
        (converted("Zoll", "25.4"), "in", 25.4, ""),
        (converted("''in''", "25.4"), "in", 25.4, ""),
        (converted("in", "25.4"), "in", 25.4, ""),
        (converted("", "25.4"), "in", 25.4, ""),
        (converted("a;b", "25.4"), "in", 25.4, ""),
        (converted("US SURVEY FOOT", "0.304800609601", METRE), "ft", 304.800609601, ""),
        (converted("INCH", "10."), "cm", 10.0, "INCH"),
        (converted("YARD", "914.4"), "914.4 mm", 914.4, ""),
        ("#5=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));", "mm", 1.0, ""),
        ("#5=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.));", "m", 1000.0, ""),
        ("#5=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.KILO.,.METRE.));", "1000000 mm", 1e6, ""),
        # as AP242 writes it: a unit of a unit, in a measure that is a complex entity
        (
            "#5=(CONVERSION_BASED_UNIT('FOOT',#6)LENGTH_UNIT()NAMED_UNIT(*));"
            "#6=(LENGTH_MEASURE_WITH_UNIT()MEASURE_REPRESENTATION_ITEM()MEASURE_WITH_UNIT(LENGTH_MEASURE(12.),#10));"
            "#10=(CONVERSION_BASED_UNIT('INCH',#11)LENGTH_UNIT()NAMED_UNIT(*));"
            "#11=LENGTH_MEASURE_WITH_UNIT(POSITIVE_LENGTH_MEASURE(25.4),#12);"
            "#12=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));",
            "ft",
            304.8,
            "",
        ),
        # nothing to go by: millimetres, as Open CASCADE takes it
        ("#5=(CONVERSION_BASED_UNIT('INCH',#6)LENGTH_UNIT()NAMED_UNIT(*));", "mm", 1.0, ""),
        (
            "#5=(CONVERSION_BASED_UNIT('X',#6)LENGTH_UNIT());#6=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(2.),#5);",
            "mm",
            1.0,
            "",
        ),
        ("", "mm", 1.0, ""),
    ],
)
def test_the_factor_says_how_long_a_unit_is(length: str, name: str, mm: float, called: str) -> None:
    found = declared_unit(units(length))
    assert (found.name, found.called) == (name, called)
    assert found.mm == pytest.approx(mm, rel=4 * np.finfo(float).eps)


def test_a_unit_that_the_geometry_is_not_in_does_not_count() -> None:
    assert declared_unit(b"#9=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.));") == LengthUnit("mm", 1.0)


@cache
def usual_report(path: Path) -> LoadReport:
    return read_model_with_report(path)[1]


@pytest.mark.parametrize(
    ("name", "factor", "unit", "note"),
    [
        ("Zoll", 25.4, "in", ()),
        ("INCH", 10.0, "cm", ("its unit is called 'INCH', but is 10 mm by its factor, which counts",)),
        ("ELL", 571.5, "571.5 mm", ()),
    ],
)
def test_a_model_is_as_large_as_the_factor_says_and_as_fine_as_in_any_unit(
    shared: Callable[[str], Path], tmp_path: Path, name: str, factor: float, unit: str, note: tuple[str, ...]
) -> None:
    """A unit that passes for millimetres would have a tolerance of another size: 3 times the triangles, or 100."""
    pytest.importorskip("cascadio", reason='reading STEP needs the extra "step"')
    written = shared("data/cad_nist_ctc/nist_ctc_03_asme1_ap203.stp").read_bytes()
    usual = usual_report(shared("data/cad_nist_ctc/nist_ctc_03_asme1_ap203.stp"))
    other = written.replace(b"UNIT('INCH'", f"UNIT('{name}'".encode()).replace(b"(25.4)", f"({factor})".encode())
    (tmp_path / "part.stp").write_bytes(other)
    report = read_model_with_report(tmp_path / "part.stp")[1]
    assert (report.unit, report.unit_source, report.warnings) == (unit, "file", note)
    float32 = np.finfo(np.float32).eps  # what Open CASCADE writes
    assert np.allclose(np.array(report.size_mm) / factor, np.array(usual.size_mm) / 25.4, rtol=1e-4 + float32)
    assert report.n_faces == pytest.approx(usual.n_faces, rel=0.1)


def test_a_unit_of_no_length_is_refused(shared: Callable[[str], Path], tmp_path: Path) -> None:
    written = shared("data/cad_nist_ctc/nist_ctc_03_asme1_ap203.stp").read_bytes()
    (tmp_path / "part.stp").write_bytes(written.replace(b"(25.4)", b"(0.)"))
    with pytest.raises(UnreadableFile, match=r"part\.stp: its unit of length is 0 mm"):
        read_model_with_report(tmp_path / "part.stp")
