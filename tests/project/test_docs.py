"""Documents, docstrings and comments name files, tests, modules and functions that exist; every page is listed."""

from __future__ import annotations

import ast
import pkgutil
import re
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src/cadcam"
FILES = {"py", "json", "html", "yaml", "csv", "png"}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
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
def test_every_heading_linked_to_exists(document: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", document.read_text())
    pages = [((document.parent / page) if page else document, anchor) for page, anchor in links if "://" not in page]
    missing = [f"{p.name}#{a}" for p, a in pages if p.suffix == ".md" and a not in anchors(p.read_text())]
    assert not missing


def anchors(text: str) -> set[str]:
    """Return what GitHub calls the headings: lower case, without punctuation, hyphens for spaces."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    heads = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", h) for h in re.findall(r"^#+ +(.+?) *$", prose, flags=re.MULTILINE)]
    return {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in heads}


def test_anchors_are_those_of_github() -> None:
    assert anchors("# A `b_c`, 2.5 px\n```sh\n# no heading\n```\n## [D](e.md): f") == {"a-b_c-25-px", "d-f"}


def test_every_page_is_listed_in_the_index_of_the_documentation() -> None:
    """And the front page leads to the index."""
    folder = ROOT / "docs"
    index = (folder / "README.md").read_text()
    listed = {(folder / t).resolve() for t in re.findall(r"\]\(([^)#\s]+)[^)]*\)", index) if "://" not in t}
    pages = set(folder.rglob("*.md")) - {folder / "README.md"}
    assert len(pages) > 30
    assert not sorted(str(p.relative_to(ROOT)) for p in pages - listed)
    assert "](docs/README.md)" in (ROOT / "README.md").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_test_named_exists(document: Path) -> None:
    for file, name in re.findall(r"(tests/[\w/]+\.py)::(\w+)", document.read_text()):
        assert f"def {name}(" in (ROOT / file).read_text(), f"{file}::{name}"


def test_every_dotted_name_leads_somewhere() -> None:
    """In full, or without `cadcam.`: of what begins with one of its rooms and is no file."""
    rooms = "|".join(sorted(p.name for p in PACKAGE.iterdir() if p.is_dir()))
    pattern = re.compile(rf"`(?:cadcam\.)?((?:{rooms})(?:\.\w+)+)`")
    named = {
        (p, name) for p in SOURCES for name in pattern.findall(p.read_text()) if name.rpartition(".")[2] not in FILES
    }
    assert {name for _, name in named} >= {"camera.sensitivity", "fit.grouped"}  # some are found
    assert not [f"{p.relative_to(ROOT)}: {name}" for p, name in sorted(named) if not exists(f"cadcam.{name}")]


def exists(name: str) -> bool:
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def test_names_in_docstrings_are_names_of_the_code() -> None:
    """Of those with an underscore, which no other word has; not in `files/foreign`, where others' names are."""
    code, said = set(), []
    for file, documents, names in modules():
        code |= {file.stem, *names}
        if "foreign" not in file.parts:
            said += [(file.stem, name) for d in documents for name in re.findall(r"`(\w*[a-z]_\w+)`", d)]
    assert len(said) > 100
    assert not [(file, name) for file, name in said if name not in code]


def test_no_line_of_a_docstring_is_left_beside_the_one_that_replaces_it() -> None:
    """Of two such lines the beginnings are the same, or the ends."""
    lines = ((file, two) for file, documents, _ in modules() for d in documents for two in pairwise(d.splitlines()))
    assert not [f"{file.relative_to(ROOT)}: {after}" for file, (line, after) in lines if left_beside(line, after)]


def left_beside(line: str, after: str) -> bool:
    """Return whether two lines of prose begin or end alike; listings and tables, indented, may."""
    alike = line[:20] == after[:20] or line[-30:] == after[-30:]
    return alike and min(len(line), len(after)) > 30 and not line.startswith((" ", "|", "#"))


def test_a_line_left_twice_is_recognised() -> None:
    assert left_beside(
        "dark or towards bright: one more unknown, with a prior.", "dark or towards bright; it is unknown."
    )
    assert not left_beside(
        "A foot is a contact line. A body that is lifted takes it", "along; one that sinks does not."
    )


@cache
def modules() -> list[tuple[Path, list[str], set[str]]]:
    """Return each module of the package with its docstrings and names, read once for all tests."""
    return [(file, *docstrings_and_names(ast.parse(file.read_text()))) for file in sorted(PACKAGE.rglob("*.py"))]


def docstrings_and_names(tree: ast.AST) -> tuple[list[str], set[str]]:
    """Return all docstrings, and all names of the code with strings that are names: keywords, attributes by name."""
    documents, names = [], set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and (document := ast.get_docstring(node)):
            documents.append(document)
        names.update(value for _, value in ast.iter_fields(node) if isinstance(value, str) and value.isidentifier())
    return documents, names


def test_every_docstring_and_name_of_a_module_is_seen() -> None:
    text = '"M."\nclass A:\n "a"\n if b:\n  def c(d: int = e.f):\n   "C."\n   g["h", "not one"] = lambda i: {**j}'
    documents, names = docstrings_and_names(ast.parse(text))
    assert sorted(documents) == ["C.", "M.", "a"]
    assert names == {*"Aabcdefghij", "int"}


def test_a_dotted_name_may_lead_nowhere() -> None:
    assert exists("cadcam.locate.lines.edges.project")
    assert not exists("cadcam.locate.lines.edges.projekt")
