"""JSON that is not what it should be is one error that says where, what stands there, and what would be right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.errors import UnknownName, UnreadableFile
from cadcam.files.jsontext import Place, as_json, as_json_pieces, json_line, parsed, parsed_line
from cadcam.files.matrix import read_matrix
from cadcam.files.text import TextFile, read_text
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


def test_a_decimal_comma_is_told_as_one() -> None:
    """In braces YAML takes it for the next key, elsewhere for a text."""
    point = "numbers have a decimal point, 0.5 instead of 0,5"
    for text, says in (
        ("lug: {position_mm: 0,5}", f"lug has an unknown key '5' (known: part, position_mm); {point}"),
        ("lug:\n  position_mm: 0,5", f'lug.position_mm is "0,5"; a number is expected: {point}'),
    ):
        with pytest.raises(UnreadableFile) as refused:
            _position(parsed_yaml(TextFile("t.yaml", text, "0" * 64)).at("lug"))
        assert str(refused.value) == f"t.yaml: {says}"


def _position(place: Place) -> float:
    place.only("part", "position_mm")
    return place.at("position_mm").number()


def test_of_two_names_as_near_the_one_that_differs_by_case_is_meant() -> None:
    with pytest.raises(UnknownName, match="did you mean 'lug A'"):
        raise UnknownName("part", "lug a", ("lug B", "lug A"))


@pytest.mark.parametrize("value", [1e31, [1.0, -1e300], [[1e308]]])
def test_a_number_whose_powers_overflow_is_refused(value: object) -> None:
    shape = tuple(None for _ in np.shape(value))
    with pytest.raises(UnreadableFile, match=r"c.json: x is .*1e.30 in size"):
        Place("c.json", ("x",), value).array(shape)


@pytest.mark.parametrize(
    "value", [[[-1.0]], [[1, 2], [2, 1]], [[1, 0.5], [0.4, 1]], [[0, 1], [1, 1]], [[1e-30, 2e-30], [2e-30, 1e-30]]]
)
def test_what_is_no_covariance_is_refused_whatever_its_unit(value: list) -> None:
    with pytest.raises(UnreadableFile, match=r"c.json: x is no covariance"):
        Place("c.json", ("x",), value).covariance()


@pytest.mark.parametrize("scale", [1e-20, 1, 1e20])
def test_a_covariance_without_full_rank_is_one(scale: float) -> None:
    """Six numbers that three causes move, in units a million apart: rounding makes eigenvalues below zero."""
    causes = np.random.default_rng(3).normal(size=(6, 3)) * np.array([1, 1, 1, 1e-6, 1e-6, 1e-6])[:, None]
    value = (scale * causes @ causes.T).tolist()
    assert np.linalg.eigvalsh(Place("c.json", ("x",), value).covariance(6))[0] < 1e-12 * scale
    with pytest.raises(UnreadableFile, match="x has shape"):
        Place("c.json", ("x",), value).covariance(5)


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


def test_items_flags_and_whole_numbers_say_where_they_stand() -> None:
    place = Place("f.json", ("a",), [True, 3, 2.5, "yes"])
    flag, whole, broken, text = place.items()
    assert (flag.flag(), whole.whole()) == (True, 3)
    with pytest.raises(UnreadableFile, match=r"f.json: a.2 is 2.5; a whole number is expected"):
        broken.whole()
    with pytest.raises(UnreadableFile, match=r'f.json: a.3 is "yes"; true or false is expected'):
        text.flag()
    with pytest.raises(UnreadableFile, match=r"f.json: a.0 is not a list; write '- part' lines"):
        flag.items("write '- part' lines")


@pytest.mark.parametrize("items", [[], [{"a": [1.5, {"b": "ü"}]}], [[1, 2], {}, "x"]])
def test_a_document_in_pieces_is_the_document(items: list[Any]) -> None:
    head = {"format": "f", "of": {"x": [1, 2]}}
    assert b"".join(as_json_pieces(head, "items", iter(items))) == as_json(head | {"items": items})


def test_numbers_of_numpy_are_numbers() -> None:
    given = {"one": np.float32(0.5), "two": np.int64(2), "three": np.array(0.25), "yes": np.True_}
    written = json_line(given)
    assert written == '{"one": 0.5, "two": 2, "three": 0.25, "yes": true}'
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_line(np.float32("nan"))
    with pytest.raises(TypeError, match="Path"):
        json_line(Path("file"))
