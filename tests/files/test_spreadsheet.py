"""Tables that people open in spreadsheets: no name is run as a formula, every number stays one."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from cadcam.files.text import spreadsheet_rows

SOURCES = Path(__file__).parents[2] / "src" / "cadcam"
FORMULAS = ["=1+1", "=cmd|' /C calc'!A1", "+SUM(A1)", "-2+3", "@x", "\t=1", "\r=1", "\uff1d1"]
NUMBERS = ["-1", "+3.250", "-1e-05", "-inf", "+0.000"]


def cells(text: str) -> list[list[str]]:
    return list(csv.reader(text.splitlines()))


@pytest.mark.parametrize("name", FORMULAS[:5] + FORMULAS[7:])
def test_a_text_that_begins_as_a_formula_is_told_to_be_text(name: str) -> None:
    assert cells(spreadsheet_rows([[name, 1.5, name]])) == [[f"'{name}", "1.5", f"'{name}"]]


@pytest.mark.parametrize("name", FORMULAS)
def test_no_cell_begins_as_a_formula(name: str) -> None:
    assert spreadsheet_rows([[name]])[0] in "'\""
    assert spreadsheet_rows([[name]]).lstrip('"').startswith("'")


@pytest.mark.parametrize("number", [*NUMBERS, -1.5, -3, 1e-7])
def test_numbers_and_plain_texts_stay_what_they_are(number: str | float) -> None:
    assert spreadsheet_rows([["bar 1=2, port", number, "", None]]) == f'"bar 1=2, port",{number},,\n'


def test_every_table_of_the_package_is_written_so() -> None:
    """Other writers of CSV are for files that are read back, whose names must stay: those of `rows_of_cells`."""
    writers = [f for f in SOURCES.rglob("*.py") if re.search(r"csv\.(writer|DictWriter)\(", f.read_text("utf-8"))]
    assert [f.name for f in writers] == ["text.py"]
