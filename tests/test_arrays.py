"""The gate through which arrays enter a value: what it lets through, and what it says of what it does not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cadcam.arrays import Brief, brief, component_major, frozen, in_parts, quantile, significant
from cadcam.errors import BadValue


def test_a_frozen_array_is_a_copy_that_nobody_can_write() -> None:
    given = np.zeros((2, 3))
    array = frozen(given, "points", (None, 3))
    given[0, 0] = 7
    assert array[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 1


@pytest.mark.parametrize(
    ("values", "dtype", "words"),
    [
        ([[1.0, 2.0], [3.0]], np.float64, "numbers of shape"),
        ([[1.0, 2.0]], np.float64, r"of shape \(1, 2\); expected shape \(N, 3\)"),
        ([[1.0, 2.0, np.inf]], np.float64, r"x\[0, 2\] is inf; expected a finite number"),
        ([[1, 2, 10**400]], np.float64, "numbers of shape"),
        ([[1, 2, -1e300]], np.float64, r"x\[0, 2\] is -1e\+300; expected a number of at most 1e\+100 in size"),
        ([[1, 2, 1e300]], np.float32, r"x\[0, 2\] is inf; expected a finite number"),
        ([[1, 2, 2**40]], np.int32, "numbers of shape|whole number"),
        (np.array([[1, 2, 2**40]]), np.int32, r"x\[0, 2\] is 1099511627776; expected a whole number"),
        ([[1, 2, 2.5]], np.int32, r"x\[0, 2\] is 2.5; expected a whole number"),
        (np.array([[1, -2, 0]]), np.uint8, r"x\[0, 1\] is -2; expected a whole number from 0 to 255"),
        ([["a", "b", "c"]], np.float64, "numbers of shape"),
        ([[1, 2, 3 + 1j]], np.float64, r"complex; expected real numbers of shape \(N, 3\)"),
    ],
)
def test_what_is_not_as_asked_is_refused_with_its_place(values: Any, dtype: npt.DTypeLike, words: str) -> None:
    with pytest.raises(BadValue, match=words):
        frozen(values, "x", (None, 3), dtype)


def test_whole_numbers_of_another_kind_are_let_through() -> None:
    for given in (np.arange(3), np.arange(3.0), np.arange(3, dtype=np.uint64), [False, True, True]):
        array = frozen(given, "ids", (3,), np.int32)
        assert array.dtype == np.int32
        np.testing.assert_array_equal(array, np.asarray(given, int))


def test_parts_come_back_in_order_and_of_one_shape(rng: np.random.Generator) -> None:
    x = rng.random((5, 7, 2))
    together = in_parts(lambda p: p[..., :1] * 2, x)
    np.testing.assert_array_equal(in_parts(lambda p: p[..., :1] * 2, x, at_once=4), together)
    assert in_parts(lambda p: p, np.zeros((0, 2))).shape == (0, 2)


def test_components_are_runs_of_memory() -> None:
    J = component_major((4, 5), 2, 3)
    assert J.shape == (4, 5, 2, 3)
    assert J[..., 1, 2].flags.c_contiguous


def test_the_quantile_is_that_of_numpy(rng: np.random.Generator) -> None:
    for n in (1, 2, 3, 10, 101):
        values = rng.normal(size=n)
        for share in (0.0, 0.1, 0.5, 0.9, 1.0):
            assert quantile(values, share) == pytest.approx(float(np.quantile(values, share)), rel=1e-14, abs=1e-15)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (np.array([1.0, 2.5, 1 / 3]), "[1.    , 2.5   , 0.3333]"),
        (np.zeros((4, 3), np.float32), "(4, 3) float32"),
        (np.eye(2), "(2, 2) float64"),
        (np.array(2.5), "2.5"),
        (1 / 3, "0.333333"),
        ((1, 2), "(1, 2)"),
        (("x" * 90,) * 7, "7 of str"),
        (dict.fromkeys("abc", "x" * 90), "3 of str"),
        ("x" * 999, "'" + "x" * 159 + "...'"),
        (None, "None"),
    ],
)
def test_what_a_value_holds_is_told_in_short(value: Any, told: str) -> None:
    assert brief(value) == told


def test_a_brief_value_tells_its_fields_without_their_numbers() -> None:
    @dataclass(frozen=True, repr=False)
    class Found(Brief):
        q: npt.NDArray[np.float64]
        name: str
        secret: int = field(default=0, repr=False)

    assert repr(Found(np.zeros((1000, 2)), "a")) == "Found(q=(1000, 2) float64, name='a')"


def test_digits_that_count_are_never_a_power_of_ten() -> None:
    told = {0.000123: "0.00012", 0.0999: "0.1", 3.14: "3.1", 20.0: "20", 109.7: "110", 2.2e5: "220000"}
    assert {value: significant(value) for value in told} == told
    assert significant(1234.56, 4) == "1235"
    assert significant(float("nan")) == "nan"
