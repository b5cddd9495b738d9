"""ISO 14253-1, exactly; how verdicts join; how the coverage factor of many is raised."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import norm

from cadcam.errors import BadValue
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.edges.presence import Presence
from cadcam.verify.inspection import Inspection
from cadcam.verify.judge import judged, together
from cadcam.verify.tolerances.tolerance import LARGEST_K, Feature, Limit, Quantity, Rule, Selection
from cadcam.verify.tolerances.verdict import Judgement, Verdict, decided, lengths, overall, towards

LIMIT = Limit(Quantity.POSITION, 1.0, k=2.0)


@pytest.mark.parametrize(
    ("deviation", "sigma", "said"),
    [
        (0.8, 0.1, Verdict.PASS),  # 0.8 <= 1 - 0.2, the limit of conformity itself
        (-0.8, 0.1, Verdict.PASS),
        (np.nextafter(0.8, 1), 0.1, Verdict.UNDECIDED),
        (1.2, 0.1, Verdict.UNDECIDED),  # not beyond 1 + 0.2
        (np.nextafter(1.2, 2), 0.1, Verdict.FAIL),
        (-1.3, 0.1, Verdict.FAIL),
        (0.0, 0.51, Verdict.UNDECIDED),  # too poor to judge: never PASS
        (0.0, 0.5, Verdict.PASS),
        (np.nan, 0.1, Verdict.UNDECIDED),
        (0.0, np.inf, Verdict.UNDECIDED),
    ],
)
def test_the_guard_band_is_that_of_iso_14253_1(deviation: float, sigma: float, said: Verdict) -> None:
    assert decided(deviation, sigma, LIMIT) is said


def test_no_uncertainty_makes_a_bad_part_pass_or_a_good_one_fail(rng: np.random.Generator) -> None:
    """PASS and FAIL imply conformity and its opposite for every truth within deviation +- U."""
    for deviation, sigma in zip(rng.normal(0, 2, 2000), rng.exponential(0.4, 2000), strict=True):
        said = decided(deviation, sigma, LIMIT)
        possible = abs(deviation + 2 * sigma * np.array([-1, 1]))
        if said is Verdict.PASS:
            assert possible.max() <= 1.0 + 1e-12
        if said is Verdict.FAIL:
            assert abs(deviation) - 2 * sigma > 1.0 - 1e-12


def test_simple_acceptance_compares_the_deviation_alone_but_not_for_a_poor_measurement() -> None:
    simple = Limit(Quantity.POSITION, 1.0, k=2.0, rule=Rule.SIMPLE)
    assert decided(0.95, 0.16, simple) is Verdict.PASS
    assert decided(1.05, 0.16, simple) is Verdict.FAIL
    assert decided(0.0, 0.17, simple) is Verdict.UNDECIDED


def test_one_failure_fails_the_part_and_only_all_passes_pass_it() -> None:
    assert overall([Verdict.PASS, Verdict.UNDECIDED, Verdict.FAIL]) is Verdict.FAIL
    assert overall([Verdict.PASS, Verdict.NOT_FOUND]) is Verdict.UNDECIDED
    assert overall([Verdict.PASS, Verdict.PASS]) is Verdict.PASS
    assert overall([]) is Verdict.UNDECIDED


def test_exit_codes_are_0_1_and_3() -> None:
    assert [v.exit_code for v in (Verdict.PASS, Verdict.FAIL, Verdict.UNDECIDED, Verdict.NOT_FOUND)] == [0, 1, 3, 3]


@pytest.mark.parametrize("n", [1, 7, 60])
def test_many_pieces_err_together_as_rarely_as_one(n: int) -> None:
    assert 1 - (1 - norm.sf(together(2.0, n))) ** n == pytest.approx(norm.sf(2.0), rel=1e-9)


@pytest.mark.parametrize("n", [1, 60, 10**6])
def test_the_largest_coverage_factor_of_a_limit_holds_for_many_pieces_too(n: int) -> None:
    """A limit that was accepted does not raise an error in the middle of a verification."""
    asked = Limit(Quantity.PROFILE, 1.0, k=LARGEST_K)
    assert replace(asked, k=together(asked.k, n)).k == pytest.approx(LARGEST_K, rel=1e-12)
    with pytest.raises(BadValue, match=r"coverage factor k is 30\.1; expected a positive number up to 30"):
        Limit(Quantity.PROFILE, 1.0, k=30.1)


@pytest.mark.parametrize(("value", "k"), [(0.0, 2.0), (-1.0, 2.0), (np.nan, 2.0), (1.0, 0.0)])
def test_a_limit_without_meaning_is_refused(value: float, k: float) -> None:
    with pytest.raises(BadValue, match="positive number"):
        Limit(Quantity.PROFILE, value, k)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_the_shortest_and_longest_vectors_of_an_ellipsoid(rng: np.random.Generator, m: int) -> None:
    """None of 4000 points on it is beyond either, and some come near, in round, flat, small and far ellipsoids."""
    for _ in range(60):
        root = rng.normal(size=(m, m)) * np.exp(rng.normal(0, 1, m))
        value = rng.normal(size=m) * rng.choice([0.0, 0.3, 1.0, 20.0])
        low, high = lengths(value, root @ root.T, 2.0)
        u = rng.normal(size=(4000, m))
        on = np.linalg.norm(value + 2.0 * (u / np.linalg.norm(u, axis=1)[:, None]) @ root.T, axis=1)
        assert on.max() <= high * (1 + 1e-9)
        assert on.max() >= 0.9 * high
        if value @ np.linalg.solve(root @ root.T, value) > 4.0:
            assert 0 < low <= on.min() * (1 + 1e-9)
        else:
            assert low == 0


@pytest.mark.parametrize("value", [0.0, -0.7, 1.0, 1.4])
def test_one_component_is_decided_by_its_own_standard_deviation(value: float) -> None:
    assert towards(np.array([value]), np.array([[0.15**2]]), LIMIT) == pytest.approx(0.15)


@pytest.mark.parametrize("sigma", [(0.1, 0.1), (0.05, 0.45), (0.45, 0.05), (0.3, 0.3), (0.2, 0.2, 0.4)])
def test_a_displacement_on_its_limit_is_passed_and_failed_as_rarely_as_one_component(
    rng: np.random.Generator, sigma: tuple[float, ...]
) -> None:
    """k = 2: each in at most 2.3 % of 1000 drawings, within four of their standard errors (0.47 %)."""
    said = []
    for _ in range(1000):
        value = np.eye(len(sigma))[0] + rng.normal(0, sigma)
        one = towards(value, np.diag(np.square(sigma)), LIMIT)
        said.append(decided(float(np.linalg.norm(value)), one, LIMIT))
    for verdict in (Verdict.PASS, Verdict.FAIL):
        assert said.count(verdict) / 1000 < norm.sf(2.0) + 4 * 0.0047


def test_what_is_unsure_in_one_direction_is_failed_for_another(rng: np.random.Generator) -> None:
    """1.5 +- 0.1 across and 0 +- 0.6 along: beyond a limit of 1 whatever it is along."""
    value, V = np.array([1.5, 0.0]), np.diag([0.05**2, 0.3**2])
    assert decided(1.5, towards(value, V, LIMIT), LIMIT) is Verdict.FAIL
    assert decided(1.5, 0.3, LIMIT) is Verdict.UNDECIDED


@pytest.mark.parametrize(("p_value", "said"), [(1e-6, Verdict.FAIL), (0.9, Verdict.UNDECIDED)])
def test_nothing_is_failed_whose_edges_are_as_likely_in_place(p_value: float, said: Verdict) -> None:
    """19.6 +- 4.3 mm in a direction that one place at an edge's end tells: all together say nothing."""
    none = np.zeros((1, 1))
    far = Estimate(np.array([19.6]), np.array([[4.3**2]]), none, none, none)
    found = FeatureDeviation("floor", State.IN_PLACE, Presence(4, 4, 20.0), np.eye(3)[:, :1], far, p_value=p_value)
    seen = cast(Inspection, SimpleNamespace(feature=lambda name: found, measured=None))
    (judgement,) = judged(Feature("floor", Selection("floor"), (Limit(Quantity.POSITION, 5.0),)), seen)
    assert judgement.verdict is said


def test_a_judgement_is_told_in_the_units_of_the_tolerance_file() -> None:
    """Of an angle in degrees, though it is kept in rad: 0.3 deg would otherwise read as 0.0052."""
    turn = Judgement(
        "rib", Limit(Quantity.ANGLE, np.radians(0.5)), np.radians(0.3), np.radians(0.05), Verdict.UNDECIDED
    )
    assert str(turn) == "rib, angle: 0.3 +- 0.1 deg, limit 0.5 deg: UNDECIDED"
    assert (
        str(Judgement("rib", LIMIT, -0.123, 0.02, Verdict.PASS)) == "rib, position: -0.123 +- 0.04 mm, limit 1 mm: PASS"
    )
    there = Judgement("rib", Limit(Quantity.PRESENCE, 0.0), np.nan, np.nan, Verdict.FAIL)
    assert str(there) == "rib, presence: FAIL"
