"""Records of many parts as a page: what fails on top, each feature over the parts, every part with its report."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.trend import Trend, trend, trends
from cadcam.report.chart import WIDTH
from cadcam.report.state.chart import trend_chart
from cadcam.report.state.page import state_page, write_state_page
from cadcam.report.state.tables import drift_words, features_table

from .browser import beyond

NOON = datetime(2026, 3, 2, 12, tzinfo=UTC)


def made(n: int, off: float, *, missing: bool = False, name: str = "rib") -> Record:
    """Return the n-th part's record: a rib `off` mm off, a bracket that is there or missing."""
    verdict = "PASS" if abs(off) <= 0.4 else "FAIL"
    rib = Deviation(name, off, 0.1, lower=-0.5, upper=0.5, verdict=verdict)
    bracket = Finding("bracket", "presence", "FAIL" if missing else "PASS", "missing" if missing else "seen")
    whole = "FAIL" if missing else verdict
    return Record(
        "block", f"S{n}", time=NOON + timedelta(minutes=n), verdict=whole, deviations=(rib,), findings=(bracket,)
    )


def drifting(slope: float, n: int = 12, sigma: float = 0.01) -> Trend:
    off = slope * np.arange(n) + np.random.default_rng(3).normal(scale=sigma, size=n)
    return trend([made(i, float(v)) for i, v in enumerate(off)], "rib")


def test_what_fails_stands_on_top_with_how_often_and_since_when() -> None:
    page = state_page([made(0, 0.1), made(1, 0.2, missing=True), made(2, 0.9), made(3, 0.8)])
    top = re.sub(r"<[^>]*>", "", page[page.index("What to look at") : page.index("Over the parts")])
    assert "rib, position, fails in 2 of 4 parts, the latest S3: 0.80 ± 0.10 mm, in each of the last 2" in top
    assert "bracket, presence, fails in 1 of 4 parts, the latest S1: missing" in top
    assert re.search(r"<b>3</b> FAIL.*<b>1</b> PASS", page)


def test_a_point_of_a_chart_leads_to_the_part_and_its_height_is_its_deviation() -> None:
    records = [made(0, 0.1), made(1, 0.3)]
    page = state_page(records, links={records[1].id: "parts/S1.html"})
    chart = next(svg for svg in page.split("<svg")[1:] if "position of rib" in svg)
    assert re.search(r'<a href="parts/S1.html"><g>.*S1, 2026-03-02 12:01:00 UTC, 0.30 ± 0.10 mm, PASS', chart)
    low, high = (float(y) for y in re.findall(r'<circle cx="[\d.]+" cy="([\d.]+)"', chart))
    zero = float(re.findall(r'y="([\d.]+)" text-anchor="end" font-size="11">0<', chart)[0]) - 4
    assert (zero - high) / (zero - low) == pytest.approx(3, abs=0.05)  # written to a tenth of a px
    assert page.count("<a href=") == 3  # both charts and the table; of S0 there is no report


def test_what_fails_is_drawn_over_what_passes() -> None:
    """Among many parts the one that fails would else be under its neighbours."""
    seen = trend([made(i, 0.1, missing=i == 1) for i in range(4)], "bracket")
    verdicts = re.findall(r"(PASS|FAIL)</title>", trend_chart(seen, {}))
    assert verdicts == ["PASS", "PASS", "PASS", "FAIL"]


def test_what_is_no_letter_in_a_name_is_spelled_out_in_a_chart() -> None:
    """A chart of its own is XML, which does not take a control character even where it is escaped."""
    rib = Deviation("rib\x02", 3.0, 0.1, upper=1.0, verdict="FAIL")
    (seen,) = trends([Record("block", "S\x011", verdict="FAIL", deviations=(rib,))])
    drawn = trend_chart(seen, {})
    assert r"S\x011" in drawn
    assert not re.search(r"[\x00-\x08]", drawn)


def test_limits_far_beyond_all_deviations_are_told_in_words() -> None:
    far = Deviation("rib", 0.1, 0.02, lower=-9.0, upper=9.0, verdict="PASS")
    assert ">limits -9 and 9 mm, not shown<" in state_page([Record("block", deviations=(far,))])
    below = Deviation("rib", 0.1, 0.02, lower=-9.0, verdict="PASS")
    assert ">limit -9 mm, not shown<" in state_page([Record("block", deviations=(below,))])


def test_names_are_text_in_the_page() -> None:
    page = state_page([made(0, 0.1, name="<script>x</script>")])
    assert "<script>" not in page


def test_several_kinds_of_part_have_sections_of_their_own(tmp_path: Path) -> None:
    other = Record("plate", "P", verdict="PASS", deviations=(Deviation("rib", 3.0, 0.1),))
    page = state_page([made(0, 0.1), other])
    assert "Features of block" in page
    assert "Features of plate" in page


def test_parts_that_could_not_be_judged_are_named_with_the_reason() -> None:
    """Who reads the page alone would not learn of them: they have no record."""
    page = state_page([made(0, 0.1)], failed={"S7": "S7.png is <truncated>"})
    assert "<b>1</b> could not be judged" in page
    assert re.search(r"<li><b>\W*(<[^>]*>)*S7.*: S7\.png is &lt;truncated&gt;</li>", page)
    assert "could not be judged" not in state_page([made(0, 0.1)])
    many = state_page([made(0, 0.1)], failed={f"S{n}": "cut" for n in range(60)})
    assert "The latest of 60." in many
    assert re.search(r"\bS10\b", many)
    assert not re.search(r"\bS9\b", many)


def test_the_tolerance_goes_on_where_a_part_has_no_number() -> None:
    """A cross beside the green area seemed to be one outside of the limits."""
    unseen = Finding("rib", "position", "UNDECIDED", "not in view")
    lost = Record("block", "S1", time=NOON + timedelta(minutes=1), verdict="UNDECIDED", findings=(unseen,))
    drawn = trend_chart(trend([made(0, 0.1), lost, made(2, 0.2)], "rib"), {})
    (width,) = re.findall(r'<rect [^>]*width="([\d.]+)"', drawn)
    assert float(width) == pytest.approx(WIDTH - 46 - 8, abs=0.1)  # all of the frame


def test_without_records_there_is_no_page(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="records of a page is none"):
        write_state_page(tmp_path / "page.html", [])


@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_is_as_wide_as_the_screen(tmp_path: Path, width: int) -> None:
    rng = np.random.default_rng(1)
    records = [made(n, float(rng.normal(0.1, 0.2)), missing=n == 7, name="longitudinal_" * 9) for n in range(40)]
    write_state_page(tmp_path / "page.html", records)
    assert max(beyond(tmp_path / "page.html", width)) <= 0


def test_a_drift_is_told_with_the_parts_left_until_the_limit() -> None:
    words = drift_words(drifting(0.02))
    slope, U = (float(v) for v in re.findall(r"[\d.]+", words)[:2])
    assert abs(slope - 0.02) <= 2 * U  # four sigmas
    # from 0.22 mm on, the last of the line, to the limit of 0.5 mm
    assert int(re.findall(r"limit in (\d+) parts", words)[0]) == pytest.approx(14, abs=2)
    assert "beyond its limit" in drift_words(drifting(0.06))


def test_a_distance_that_grows_smaller_meets_no_limit() -> None:
    shrinking = trend([made(i, 0.4 - 0.02 * i + 0.001 * (i % 2)) for i in range(12)], "rib")
    assert "a part" in drift_words(shrinking)
    assert "limit" not in drift_words(shrinking)


def test_chance_is_no_drift() -> None:
    """Of 2000 features that only scatter, one in ten thousand may be told: three or more have a chance of 1e-3."""
    rng = np.random.default_rng(0)
    told = 0
    for _ in range(2000):
        deviations = rng.normal(size=10)
        told += bool(drift_words(trend([made(i, float(v)) for i, v in enumerate(deviations)], "rib")))
    assert told < 3
    assert drift_words(drifting(0.02, n=9)) == ""


def test_the_sigma_of_a_drift_is_its_scatter() -> None:
    """Of n draws the rms of slope / sigma is 1, but for the few degrees of freedom (n - 2 = 28: 1.04)."""
    rng = np.random.default_rng(4)
    z = []
    for _ in range(400):
        of = trend([made(i, float(v)) for i, v in enumerate(0.1 * np.arange(30) + rng.normal(size=30))], "rib")
        slope, sigma = of.drift
        z.append((slope - 0.1) / sigma)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(np.sqrt(28 / 26), abs=4 / np.sqrt(2 * 400))


def test_all_trends_are_those_asked_for_one_by_one() -> None:
    records = [made(0, 0.1), made(1, 0.2, missing=True), Record("block", "S2")]
    each = {(t.feature, t.kind): t for t in trends(records)}
    assert list(each) == [("rib", "position"), ("bracket", "presence")]
    for (feature, kind), one in each.items():
        alone = trend(records, feature, kind=kind)
        assert (one.judged, one.without, one.unit) == (alone.judged, alone.without, alone.unit)


def test_the_table_of_features_begins_with_what_fails_most() -> None:
    table = features_table([made(0, 0.1, missing=True), made(1, 0.2, missing=True), made(2, 0.9)])
    assert [row[:3] for row in table.rows] == [("bracket", "presence", "2"), ("rib", "position", "1")]
