"""Numbers that a script gives: of any type, but numbers, and of the size that is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.kinds import expect_count, expect_flag, expect_number, expect_numbers, expect_positive


def test_numbers_are_pythons_and_numpys_and_nothing_else() -> None:
    for number in (1, 1.5, np.float32(2), np.int64(3), np.array(4.0), float("nan"), True):
        expect_number(number, "x")
    for other in ("1", None, [1], np.zeros(1), object(), np.array("1x"), np.array(None), 1j, np.complex128(1), 10**400):
        with pytest.raises(BadValue, match=r"^x is .*; expected a number$"):
            expect_number(other, "x")


@pytest.mark.parametrize("exact", [Decimal("0.5"), Decimal("nan"), Fraction(1, 2)])
def test_numbers_that_floats_do_not_calculate_with_are_refused_with_the_way(exact: object) -> None:
    for gate in (expect_number, expect_positive, expect_count):
        with pytest.raises(BadValue, match=r"^x is a (Decimal|Fraction); expected a .*number.*: float\(\) of it$"):
            gate(exact, "x")


def test_a_positive_number_is_finite_and_above_zero_or_may_be_zero() -> None:
    for number in (1, 5e-324, np.float32(2), 10**300, np.array(4.0)):
        expect_positive(number, "x")
    expect_positive(0, "x", zero=True)
    for other in (0, 0.0, -1, float("nan"), float("inf"), None, "1", [], np.zeros(0), 10**400):
        with pytest.raises(BadValue, match=r"^x is .*; expected a length in mm$"):
            expect_positive(other, "x", "a length in mm")
    for other in (-5e-324, float("nan"), float("inf")):
        with pytest.raises(BadValue, match=r"expected a positive number$"):
            expect_positive(other, "x", zero=True)


@dataclass
class Numbers:
    """One field of each kind that is looked at, and one that is not."""

    real: float = 1.0
    whole: int = 1
    perhaps: int | None = None
    both: tuple[float, float] = (1.0, 2.0)
    each: tuple[int, int, int] | None = None
    flag: bool = False
    other: object = "x"


def test_numbers_of_a_dataclass_are_those_that_it_annotates() -> None:
    for right in ({}, {"whole": np.int64(3), "both": [1, 2]}, {"both": np.zeros(2), "each": (1, 2.0, 3)}, {"real": 2}):
        expect_numbers(Numbers(**right))
    wrong = {
        "real": ({}, "real is a dict of 0; expected a number"),
        "whole": (float("nan"), "whole is nan; expected a whole number"),
        "perhaps": (0.5, "perhaps is 0.5; expected a whole number"),
        "both": ((1.0,), "both is a tuple of 1; expected 2 numbers"),
        "flag": ("no", "flag is the text 'no'; expected True or False"),
        "each": ((1, 2, "3"), r"each\[2\] is the text '3'; expected a number"),
    }
    for name, (value, words) in wrong.items():
        with pytest.raises(BadValue, match=f"^{words}$"):
            expect_numbers(Numbers(**{name: value}))
    with pytest.raises(BadValue, match="both is a dict of 2"):
        expect_numbers(Numbers(both={0: 1, 1: 2}))
    with pytest.raises(BadValue, match=r"both is an array of shape \(\); expected 2 numbers"):
        expect_numbers(Numbers(both=np.array(1.0)))  # type: ignore[arg-type]  # such is what a script gets wrong


def test_a_count_is_whole_and_large_enough() -> None:
    for number in (2, 2.0, np.int64(3), np.array(4)):
        expect_count(number, "x", least=2)
    for other in (1, 2.5, -3, float("nan"), float("inf"), None, "2", [2], 10**400):
        with pytest.raises(BadValue, match=r"^x is .*; expected a whole number of at least 2$"):
            expect_count(other, "x", least=2)


def test_a_flag_is_true_or_false_never_what_python_takes_for_either() -> None:
    for flag in (True, False, 1, 0, np.True_, np.array(False), np.int8(1)):
        expect_flag(flag, "x")
    for other in (
        None,
        "no",
        "",
        2,
        -1,
        [],
        [True],
        np.array([True, False]),
        np.zeros(1, bool),
        float("nan"),
        np.array(""),
    ):
        with pytest.raises(BadValue, match=r"^x is .*; expected True or False$"):
            expect_flag(other, "x")
