"""docs/camera-formats.md says what the code says: its table is made from the formats, and compared here."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cadcam.camera.lens import LENSES
from cadcam.files.foreign.model import Holds
from cadcam.files.foreign.registry import NAMES, format_named
from cadcam.files.foreign.viewers import VIEWERS

PAGE = Path(__file__).resolve().parents[2] / "docs/camera-formats.md"
SKEW = {"yes": "yes", "no": "no", "ignored": "kept, ignored by its own programs"}


def lenses_of(holds: Holds) -> str:
    """The lens models, with their terms where not all of them have a place."""
    if set(holds.lenses) == set(LENSES):
        return "all"
    out = []
    for name, terms in holds.lenses.items():
        every = tuple(LENSES[name]().parameters)
        out.append(name if set(terms) == set(every) else f"{name} ({' '.join(terms)})")
    return ", ".join(out)


def expected_row(name: str) -> list[str]:
    form = format_named(name)
    h = form.holds
    files = "a folder" if form.folder else " ".join(form.suffixes)
    pose = h.pose if h.pose != "relative" else "among each other"
    point = "yes" if h.principal_point else "centred only"
    return [
        f"`{name}`",
        files,
        lenses_of(h),
        SKEW[h.skew],
        point,
        pose,
        "yes" if h.several else "one",
        form.unit or "any",
    ]


def rows_of(heading: str) -> dict[str, list[str]]:
    """The rows of the table below a heading, by their first cell."""
    section = PAGE.read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line.startswith("| `")
    ]
    return {row[0]: row for row in rows}


@pytest.mark.parametrize("name", NAMES)
def test_the_table_of_formats_is_the_codes(name: str) -> None:
    assert rows_of("What each can hold")[f"`{name}`"] == expected_row(name)


def test_the_tables_name_every_format_and_viewer_and_no_other() -> None:
    assert set(rows_of("What each can hold")) == {f"`{name}`" for name in NAMES}
    assert set(rows_of("Conventions met")) == {f"`{name}`" for name in NAMES}
    assert set(rows_of("Viewers and renderers")) == {f"`{name}`" for name in VIEWERS}


@pytest.mark.parametrize("name", VIEWERS)
def test_the_table_of_viewers_is_the_codes(name: str) -> None:
    h = VIEWERS[name].holds
    row = rows_of("Viewers and renderers")[f"`{name}`"]
    assert row[1:3] == ["yes" if h.skew == "yes" else "no", "yes" if h.principal_point else "centred only"]


def test_every_lens_model_is_explained() -> None:
    assert {f"`{name}`" for name in LENSES} == set(re.findall(r"^\| (`[\w-]+`) \|", PAGE.read_text(), re.MULTILINE)) & {
        f"`{name}`" for name in LENSES
    }
