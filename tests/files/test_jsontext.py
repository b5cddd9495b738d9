"""JSON that is not what it should be is one error that says where, what stands there, and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import Place, parsed, parsed_line
from cadcam.files.matrix import read_matrix
from cadcam.files.text import read_text
from cadcam.files.yamltext import parsed_yaml


@pytest.mark.parametrize(
    ("shape", "value", "says"),
    [
        ((), "x", 'f.json: a.b is "x"; a number is expected'),
        ((2,), "64x48", 'f.json: a.b is "64x48"; a list of 2 numbers is expected'),
        ((None,), [1, None], "f.json: a.b is [1, null]; a list of numbers is expected"),
        ((3, 3), [1.0, 2.0], "f.json: a.b has shape (2,); a list of 3 lists of 3 numbers is expected"),
        ((None, 3), [[1, 2], [3]], "f.json: a.b is [[1, 2], [3]]; a list of lists of 3 numbers is expected"),
    ],
)
def test_what_numbers_are_expected_is_said_in_words(shape: tuple[int | None, ...], value: object, says: str) -> None:
    with pytest.raises(UnreadableFile) as refused:
        Place("f.json", ("a", "b"), value).array(shape)
    assert str(refused.value) == says


def test_what_is_nested_too_deeply_is_refused_wherever_json_is_read(tmp_path: Path) -> None:
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 100_000)
    with pytest.raises(UnreadableFile, match="nested too deeply"):
        parsed(read_text(deep))
    with pytest.raises(UnreadableFile, match="line 7 is not JSON"):
        parsed_line("log.jsonl", 7, "[" * 100_000)
    with pytest.raises(UnreadableFile, match=r"deep\.json"):
        read_matrix(deep, rows=3, columns=4)


@pytest.mark.parametrize(("text", "remedy"), [("k:\n\ta: 2\n", "YAML takes no tabs"), ("k: [1, 2", "is it cut off?")])
def test_tabs_in_yaml_are_named_because_they_look_like_blanks(tmp_path: Path, text: str, remedy: str) -> None:
    file = tmp_path / "tolerances.yaml"
    file.write_text(text)
    with pytest.raises(UnreadableFile, match=f"is not YAML: .*{remedy}".replace("?", r"\?")):
        parsed_yaml(read_text(file))


def test_a_line_that_holds_no_object_is_named() -> None:
    with pytest.raises(UnreadableFile, match=r"log\.jsonl: line 3 is \[1\]; an object \{\.\.\.\} is expected"):
        parsed_line("log.jsonl", 3, "[1]")
