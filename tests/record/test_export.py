"""Records leave a store as JSON, JSON lines or CSV, and come back from the first two to the last bit."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile
from cadcam.geometry.rigid import Rigid
from cadcam.record.export import read_records, write_records
from cadcam.record.record import Deviation, Record, Source
from cadcam.record.trend import trend
from cadcam.report.state.tables import trend_tables

from .made import NOON, record
from .test_store import same

SEPARATORS = "one\u0085two\u2028three"  # of lines, for Python; not for JSON lines


@pytest.mark.parametrize("suffix", [".json", ".jsonl"])
def test_json_comes_back_to_the_last_bit(tmp_path: Path, suffix: str) -> None:
    records = [record(0), Record("bolt", time=NOON), record(2, reason=SEPARATORS)]
    write_records(tmp_path / f"all{suffix}", records)
    for one, back in zip(records, read_records(tmp_path / f"all{suffix}"), strict=True):
        same(back, one)


def test_csv_has_a_line_for_each_deviation_with_units_in_its_header(tmp_path: Path) -> None:
    records = [record(1), record(2, deviations=(), pose=None)]
    write_records(tmp_path / "all.csv", records)
    with (tmp_path / "all.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["feature"] for row in rows] == ["stiffener", "face", ""]
    assert float(rows[0]["deviation_mm"]) == 0.1
    assert rows[0]["deviation_deg"] == ""
    assert float(rows[1]["expanded_uncertainty_deg"]) == 0.05
    assert rows[1]["deviation_mm"] == ""
    assert rows[0]["serial"] == rows[1]["serial"] == "S001"
    assert rows[0]["photo_sha256"] == "ab" * 32
    assert rows[2]["x_mm"] == ""
    assert records[0].pose is not None
    assert float(rows[0]["x_mm"]) == records[0].pose.world_from_part.translation[0]
    assert float(rows[0]["sigma_rx_deg"]) == np.degrees(np.sqrt(records[0].pose.covariance[3, 3]))


def test_no_name_is_a_formula_in_a_spreadsheet(tmp_path: Path) -> None:
    """And a negative deviation stays a number."""
    deviations = (Deviation("=HYPERLINK(A1)", -0.25, 0.1, upper=1.0),)
    write_records(tmp_path / "all.csv", [record(1, part="@part", deviations=deviations)])
    with (tmp_path / "all.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["feature"], row["part"], row["deviation_mm"]) == ("'=HYPERLINK(A1)", "'@part", "-0.25")


def test_a_verification_is_read_by_its_keys_and_may_hold_more(tmp_path: Path) -> None:
    """The least: part and deviations; what a verification says besides is its own."""
    least = {"format": "cadcam verification", "part": "p", "deviations": [], "plots": [1, 2], "verdict": "FAIL"}
    (tmp_path / "v.json").write_text(json.dumps(least))
    (one,) = read_records(tmp_path / "v.json")
    assert (one.part, one.verdict, one.deviations) == ("p", "FAIL", ())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"part": "p"}', "has no 'deviations'"),
        ('{"part": "p", "deviations": [{"feature": "f"}]}', "deviations.0 has no deviation"),
        ('{"part": "p", "deviations": [], "time_utc": "noon"}', "time_utc is 'noon'"),
        ('{"part": "p", "deviations": [], "verdict": "GOOD"}', "unknown verdict"),
        ('{"part": "p", "deviations": [], "sources": [{"role": "cad", "path": "x", "sha256": "12"}]}', "64 hex"),
    ],
)
def test_what_is_no_record_is_refused_by_key(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(UnreadableFile, match=says):
        read_records(tmp_path / "bad.json")


def test_a_line_cut_off_is_named(tmp_path: Path) -> None:
    write_records(tmp_path / "all.jsonl", [record(0), record(1)])
    whole = (tmp_path / "all.jsonl").read_text()
    (tmp_path / "all.jsonl").write_text(whole[:-40])
    with pytest.raises(UnreadableFile, match="line 2 is not JSON"):
        read_records(tmp_path / "all.jsonl")


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="suffix"):
        write_records(tmp_path / "all.xml", [])


@pytest.mark.parametrize(
    "make",
    [
        lambda: Record(""),
        lambda: Record("p", time=NOON.replace(tzinfo=None)),
        lambda: Record("p", verdict="pass"),
        lambda: Record("p", quality=float("nan")),
        lambda: Deviation("f", float("nan"), 1.0),
        lambda: Deviation("f", 0.0, -1.0),
        lambda: Deviation("f", 0.0, 1.0, unit="m"),
        lambda: Source("cad", "x", "AB" * 32),
    ],
)
def test_what_cannot_be_kept_is_refused_at_once(make: Callable[[], object]) -> None:
    with pytest.raises(CadcamError):
        make()


def test_a_record_read_back_is_the_one_written_with_its_pose(tmp_path: Path) -> None:
    pose = PoseEstimate(Rigid.exp([1, -2, 3, 0.1, 0.2, -0.3]), 0.1 * np.eye(6), dof=7.0)
    made = Record("p", pose=pose)
    write_records(tmp_path / "all.jsonl", [made])
    (back,) = read_records(tmp_path / "all.jsonl")
    assert back == made
    assert hash(back) == hash(made)
    assert back != replace(made, pose=replace(pose, dof=8.0))
    assert back != replace(made, pose=None)


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int64, np.array, Decimal])
def test_numbers_of_any_library_are_kept_as_floats(tmp_path: Path, kind: Callable[[float], Any]) -> None:
    one = kind(1)
    made = Record("p", quality=one, deviations=(Deviation("f", one, one, lower=one, upper=one, k=one),))
    write_records(tmp_path / "all.jsonl", [made])
    (back,) = read_records(tmp_path / "all.jsonl")
    assert back == made
    assert type(made.quality) is type(made.deviations[0].lower) is float


def test_a_trend_has_the_mean_and_scatter_of_one_feature() -> None:
    records = [record(n) for n in range(5)]
    seen = trend(records, "stiffener")
    values = 0.1 * np.arange(5)
    assert [r.serial for r, _ in seen.points] == [r.serial for r in records]
    assert seen.mean == pytest.approx(values.mean(), rel=1e-12)
    assert seen.sigma == pytest.approx(values.std(ddof=1), rel=1e-12)
    assert seen.measured_sigma == pytest.approx(0.25 / 2, rel=1e-12)
    assert trend(records, "face").unit == "deg"
    assert np.isnan(trend(records[:1], "face").sigma)


def test_equal_deviations_do_not_scatter() -> None:
    """Their mean by way of their sum is not bit by bit each of them, and what is off by rounding is no scatter."""
    records = [record(n, deviations=(Deviation("rib", 0.1, 0.0),)) for n in range(10)]
    seen = trend(records, "rib")
    assert (seen.mean, seen.sigma) == (0.1, 0.0)
    assert ("sigma from part to part, mm", "0") in trend_tables(seen)[1].rows
    far = [replace(record(n), deviations=(Deviation("rib", 1e6 + 1e-3 * n, 0.0),)) for n in range(3)]
    assert trend(far, "rib").sigma == pytest.approx(1e-3, rel=1e6 * np.finfo(float).eps / 1e-3)


def test_a_trend_counts_verdicts_and_the_parts_that_have_no_value() -> None:
    """A feature that is missing, or could not be measured, leaves no deviation; other kinds of part do not count."""
    judged = [Deviation("rib", 0.1, 0.02, verdict=verdict) for verdict in ("PASS", "FAIL", "PASS", "")]
    records = [record(n, deviations=(d,)) for n, d in enumerate(judged)]
    gone = record(4, deviations=(), verdict="FAIL", reason="rib: missing")
    seen = trend([*records, gone, record(5, part="bolt", deviations=())], "rib")
    assert seen.verdicts == {"PASS": 2, "FAIL": 1, "": 1}
    assert seen.without == (gone,)
    rows = dict(trend_tables(seen)[1].rows)
    assert rows["verdicts"] == "2 PASS, 1 FAIL, 1 not judged"
    assert rows["without a value"] == "1 of 5 records; as a whole 1 FAIL"
    assert "without a value" not in dict(trend_tables(trend(records, "rib"))[1].rows)


def test_a_trend_mixes_neither_kinds_nor_units() -> None:
    both = (Deviation("f", 0.1, 0.1), Deviation("f", 2.0, 0.1, kind="angle", unit="deg"))
    records = [record(0, deviations=both)]
    with pytest.raises(BadValue, match="kind of 'f' is not named; expected one of angle, position"):
        trend(records, "f")
    assert trend(records, "f", kind="angle").unit == "deg"
    with pytest.raises(UnknownName, match="did you mean 'stiffener'"):
        trend([record(0)], "stiffner")
    mixed = [record(0, deviations=(replace(both[0], kind="angle"), both[1]))]
    with pytest.raises(BadValue, match="unit of 'f' is deg and mm"):
        trend(mixed, "f", kind="angle")


def test_the_page_s_snippet_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/product-state.md").read_text()
    (snippet,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "docs/product-state.md", "exec"), {})
    assert (tmp_path / "parts.sqlite").exists()
