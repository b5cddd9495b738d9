"""Documents, docstrings and comments name files, tests and modules that exist."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [*DOCUMENTS, *(p for room in ("src", "benchmarks", "examples") for p in sorted((ROOT / room).rglob("*.py")))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_path_named_exists(document: Path) -> None:
    text = document.read_text()
    links = [t for t in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) if "://" not in t]
    missing = [t for t in links if not (document.parent / t).exists()]
    code = re.findall(r"`((?:src|tests|docs|examples|benchmarks|models|renders)/[\w./-]+)`", text)
    missing += [t for t in code if not (ROOT / t).exists()]
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_test_named_exists(document: Path) -> None:
    for file, name in re.findall(r"(tests/[\w/]+\.py)::(\w+)", document.read_text()):
        assert f"def {name}(" in (ROOT / file).read_text(), f"{file}::{name}"


def test_every_dotted_name_leads_somewhere() -> None:
    named = {(p, name) for p in SOURCES for name in re.findall(r"`(cadcam(?:\.\w+)+)`", p.read_text())}
    assert {name for _, name in named} >= {"cadcam.camera.sensitivity"}  # some are found
    assert not [f"{p.relative_to(ROOT)}: {name}" for p, name in sorted(named) if not exists(name)]


def exists(name: str) -> bool:
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def test_a_dotted_name_may_lead_nowhere() -> None:
    assert exists("cadcam.locate.lines.edges.project")
    assert not exists("cadcam.locate.lines.edges.projekt")
