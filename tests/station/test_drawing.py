"""Distances and angles against the drawing, and what their differences say."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import astuple

import numpy as np
import pytest
from scipy import stats

from cadcam.errors import BadValue, TooFewPoints, UnknownName
from cadcam.station.drawing import check_distances, independent, trend, trend_of_log
from cadcam.station.measure import measure_marks
from cadcam.station.plate import turn
from cadcam.station.simulate import day


def test_a_turned_block_shows_its_angle_and_no_difference(hall, stations, rng):
    work = day(hall, rng, marks=3)
    found = measure_marks(stations, work.sightings)
    drawn = {n: p[:2] @ turn(0.01) + [100, 200] for n, p in zip(found.names, found.points, strict=True)}
    for check in check_distances(found, drawn):
        assert check.difference == pytest.approx(0, abs=1e-6)
        assert check.angle == pytest.approx(0.01, abs=1e-9)
        assert 1.9 < check.half_width / check.sigma < 2.2


def test_all_pairs_at_once_are_each_pair_by_itself(hall, stations, rng):
    """Of 40 marks, more than are worked out together; by the formulas, with Welch's and Satterthwaite's degrees."""
    work = day(hall, rng, marks=40)
    found = measure_marks(stations, work.sightings)
    checks = check_distances(found, dict(zip(found.names, work.points, strict=True)))
    assert len(checks) == 40 * 39 / 2
    for c, length in zip(checks, found.distances([(c.one, c.other) for c in checks]), strict=True):
        i, j = found.names.index(c.one), found.names.index(c.other)
        d = found.points[j] - found.points[i]
        g = d / np.linalg.norm(d)
        variances = defaultdict(float)
        dof = {}
        for part in found.noise:
            variances[id(part.owner)] += g @ (part.covariance[i] + part.covariance[j]) @ g
            dof[id(part.owner)] = part.dof
        for source, E in found.effects:
            along = g @ (E[j] - E[i])
            variances[id(source.owner)] += along @ source.covariance @ along
            dof.setdefault(id(source.owner), source.dof)
        total = sum(variances.values())
        effective = min(total**2 / sum(v**2 / dof[owner] for owner, v in variances.items()), 1e9)
        half = stats.t.ppf(0.975, effective) * np.sqrt(total)
        # sums of up to 100 columns of either sign, whose sizes add up to some ten times the sum at most
        assert (c.sigma, c.half_width) == pytest.approx((np.sqrt(total), half), rel=1e3 * np.finfo(float).eps)
        assert (length.value, length.sigma, length.half_width) == (c.measured, c.sigma, c.half_width)
        assert c.measured == pytest.approx(found.distance(c.one, c.other).value, rel=4 * np.finfo(float).eps)
        on_it = work.points[j] - work.points[i]
        assert c.drawn == pytest.approx(np.hypot(*on_it), rel=4 * np.finfo(float).eps)
        turned = np.arctan2(d[1], d[0]) - np.arctan2(on_it[1], on_it[0])
        assert (c.angle - turned + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0, abs=16 * np.finfo(float).eps)


def test_marks_that_are_not_drawn_are_named(hall, stations, rng):
    found = measure_marks(stations, day(hall, rng, marks=2).sightings)
    with pytest.raises(UnknownName, match="mark of the drawing 'B'"):
        check_distances(found, {"mark01": [0, 0]}, [("mark01", "B")])
    with pytest.raises(TooFewPoints):
        check_distances(found, {"mark01": [0, 0]})
    with pytest.raises(BadValue, match="different places"):
        check_distances(found, {"mark01": [0, 0], "mark02": [0, 0]})


def test_only_distances_without_a_common_mark_are_taken_together(hall, stations, rng):
    work = day(hall, rng, marks=6)
    found = measure_marks(stations, work.sightings)
    apart = independent(check_distances(found, dict(zip(found.names, work.points, strict=True))))
    assert len(apart) == 3
    assert len({name for c in apart for name in (c.one, c.other)}) == 6


def test_a_scale_is_told_from_an_offset(rng):
    lengths = rng.uniform(2000, 30000, 40)
    noise = rng.normal(size=40)
    assert trend(noise, lengths).verdict == "nothing but chance"
    assert trend(1e-3 * (lengths - lengths.mean()) + noise, lengths).verdict.startswith("a scale")
    assert trend(5 + noise, lengths).verdict.startswith("a constant offset")
    assert trend(1e-3 * lengths + noise, lengths).verdict.endswith("grow with the length")
    with pytest.raises(TooFewPoints):
        trend([1.0, 2.0], [1.0, 2.0])


@pytest.mark.parametrize("n", [3, 4, 12])
def test_the_trend_is_a_regression_with_its_degrees_of_freedom(rng, n):
    lengths = rng.uniform(2000, 30000, n)
    d = 1e-4 * lengths + rng.normal(size=n)
    found, line, mean = trend(d, lengths), stats.linregress(lengths / 1000, d), stats.ttest_1samp(d, 0.0)
    assert (found.slope, found.slope_sigma, found.p_slope) == pytest.approx((line.slope, line.stderr, line.pvalue))
    assert (found.t, found.p_mean) == pytest.approx((mean.statistic, mean.pvalue))
    assert found.standard_error == pytest.approx(stats.sem(d))


def test_three_distances_show_a_scale_by_chance_as_rarely_as_many(rng):
    """Of 2000 draws one in a hundred, and three standard deviations more at most."""
    lengths = np.array([1000.0, 3000.0, 5000.0])
    said = [trend(rng.normal(size=3), lengths).verdict for _ in range(2000)]
    assert sum("scale" in words or "grow with" in words.partition("does not")[0] for words in said) < 20 + 14


def test_differences_that_do_not_scatter_are_an_offset_or_nothing():
    lengths = [1000.0, 2000.0, 4000.0]
    assert (trend([0.0] * 3, lengths).t, trend([0.0] * 3, lengths).verdict) == (0.0, "nothing but chance")
    assert (trend([-0.5] * 3, lengths).t, trend([-0.5] * 3, lengths).verdict[:17]) == (-np.inf, "a constant offset")


def test_the_slope_is_known_as_well_as_it_says(rng):
    """600 draws: a standard deviation good to 2.9 %."""
    lengths = np.linspace(2000, 30000, 30)
    z = [
        (s.slope - 0.2) / s.slope_sigma
        for s in (trend(2e-4 * lengths + rng.normal(size=30), lengths) for _ in range(600))
    ]
    assert np.std(z) == pytest.approx(1.04, abs=0.12)  # Student, 28 degrees of freedom


def test_a_log_s_trend_takes_latest_places_within_a_block_and_no_mark_twice():
    """Six marks of one block, 100, 90 and 80 mm apart; another block's, undrawn and earlier ones make no difference."""
    drawn = {"a": [0, 0, 5], "b": [100, 0, 9], "c": [0, 10], "d": [90, 10], "e": [0, 20], "f": [80, 20]}
    off = {"b": 0.3, "d": 0.1, "f": -0.1}

    def entry(mark: str, block: str, x: float, y: float) -> dict[str, object]:
        return {"mark": mark, "block": block, "point_mm": [x, y]}

    earlier = [entry(m, "one", 500.0, 500.0) for m in drawn]
    latest = [entry(m, "one", p[0] + off.get(m, 0.0), p[1]) for m, p in drawn.items()]
    beside = [entry("a", "two", 900.0, 0.0), entry("z", "one", 0.0, 0.0)]
    seen = trend_of_log([*earlier, *beside, *latest], drawn)
    # the longest is b's diagonal to the mark farthest from it, e, and so on: b-e, d-a, f-c, all within one block
    pairs = [("b", "e"), ("d", "a"), ("f", "c")]
    at = {e["mark"]: np.array(e["point_mm"]) for e in latest}
    lengths = [np.hypot(*np.subtract(drawn[i][:2], drawn[j][:2])) for i, j in pairs]
    expected = trend([L - np.hypot(*(at[i] - at[j])) for (i, j), L in zip(pairs, lengths, strict=True)], lengths)
    assert seen is not None
    assert astuple(seen) == pytest.approx(astuple(expected), rel=1e-9)
    assert trend_of_log(beside, drawn) is None
