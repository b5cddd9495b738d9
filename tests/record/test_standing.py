"""Each part counts once: a later record of it replaces an earlier one, and kinds of part are not mixed."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest
import sqlalchemy as sql

from cadcam.errors import BadValue
from cadcam.record import schema
from cadcam.record.record import Deviation, Finding
from cadcam.record.store import Store, open_store
from cadcam.record.trend import standing, trend, trends
from cadcam.report.state.json import trend_as_json
from cadcam.report.state.tables import drift_words, features_table, trend_tables

from .made import record

HOUR = timedelta(hours=1)
DRIFTING = [record(n) for n in range(12)]  # by 0.1 mm a part
ANEW = [replace(one, id=f"{one.id}x", time=one.time + HOUR) for one in DRIFTING]


def test_parts_that_are_judged_anew_drift_as_they_did() -> None:
    """By other limits, say: 24 records of 12 parts hid the drift, and a verdict that was replaced still counted."""
    once, twice = trend(DRIFTING, "stiffener"), trend([*DRIFTING, *ANEW], "stiffener")
    assert twice.drift == once.drift == (pytest.approx(0.1), pytest.approx(0.0, abs=1e-12))
    assert drift_words(twice) == drift_words(once) != ""
    assert (len(twice), twice.replaced, once.replaced) == (12, 12, 0)
    assert {r.id for r, _ in twice.judged} == {one.id for one in ANEW}
    assert ("left out", "12 records: later ones of the same parts count") in trend_tables(twice)[1].rows
    assert [t.replaced for t in trends([*DRIFTING, *ANEW])] == [12, 12]
    assert features_table([*DRIFTING, *ANEW]).title == "Features, 12 parts"


def test_what_replaces_a_record_says_all_that_it_said() -> None:
    first, later = record(1), replace(record(1), id="later", time=record(1).time + HOUR)
    assert standing([first, later]) == [later]
    lost = replace(
        first, pose=None, deviations=(), findings=(Finding("stiffener", "position", "UNDECIDED", "not found"),)
    )
    assert standing([lost, later]) == [later]
    other = replace(later, deviations=(Deviation("rib", 0.1, 0.2, verdict="PASS"),))
    for beside in (
        other,
        lost,
        replace(later, station="cell 4"),
        replace(later, serial="S9"),
        replace(later, part="x"),
    ):
        assert standing([first, replace(beside, id="beside")]) != [beside]
        assert len(standing([first, replace(beside, id="beside")])) == (1 if beside is lost else 2)
    unnamed = [replace(one, serial="") for one in (first, later)]
    assert standing(unnamed) == unnamed


def test_kinds_of_part_are_not_mixed() -> None:
    """Of two that do not drift, the one made after the other seemed to."""
    brackets = [replace(record(n), deviations=(Deviation("rib", 0.0, 0.2, verdict="PASS"),)) for n in range(10)]
    plates = [
        replace(record(n), part="plate", deviations=(Deviation("rib", 0.5, 0.2, verdict="PASS"),)) for n in range(10)
    ]
    with pytest.raises(BadValue, match="part of 'rib' is not named; expected records of one of bracket, plate"):
        trend([*brackets, *plates], "rib")
    assert [(t.judged[0][0].part, t.mean) for t in trends([*brackets, *plates])] == [("bracket", 0.0), ("plate", 0.5)]


def test_json_of_a_trend_has_drift_and_limits() -> None:
    said = trend_as_json(trend([*DRIFTING[:5], *ANEW], "stiffener"))
    assert (said["kind"], said["replaced"]) == ("position", 5)
    assert said["drift_a_part_mm"] == pytest.approx(0.1)
    assert said["drift_sigma_mm"] == pytest.approx(0.0, abs=1e-12)
    assert said["drift"].endswith("now beyond its limit")
    assert said["parts_left"] == 0
    point = said["points"][0]
    assert {name: point[name] for name in ("part", "k", "upper_mm")} == {"part": "bracket", "k": 2.0, "upper_mm": 1.0}
    few = trend_as_json(trend(DRIFTING[:2], "stiffener"))
    assert (few["drift"], few["drift_a_part_mm"], few["parts_left"]) == ("", None, None)


def test_what_was_measured_without_limits_is_replaced_by_what_measures_it_again() -> None:
    rib, boss = (Deviation(name, 0.1, 0.2) for name in ("rib", "boss"))
    one = replace(record(1), verdict="", deviations=(rib,))
    nothing = replace(one, id="lost", pose=None, deviations=())
    for later in (replace(one, id="boss", deviations=(boss,)), nothing):
        assert standing([one, later]) == [one, later]
    again = replace(one, id="again", deviations=(rib, boss))
    assert standing([one, nothing, again]) == [again]
    assert standing([nothing, one]) == [one]


def test_a_store_says_which_records_stand_as_their_records_do(where: str) -> None:
    """Of one that judges another feature a trend reads nothing else: it seemed to be replaced."""
    boss = replace(record(1), id="boss", deviations=(Deviation("boss", 0.1, 0.2, verdict="PASS"),))
    rib = replace(
        record(1), id="rib", time=record(1).time + HOUR, findings=(Finding("rib", "presence", "PASS", "seen"),)
    )
    every = [*DRIFTING, boss, *ANEW, replace(rib, deviations=())]
    with open_store(where) as store:
        store.add(*every)
        assert store.standing() == {one.id for one in standing(store.query())}
        assert store.standing(serial="S001") == {one.id for one in standing(store.query(serial="S001"))}
        assert {"boss", "rib"} <= store.standing()


def test_a_record_that_is_added_while_it_is_asked_is_no_error(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """PostgreSQL shows each statement what was committed by then: judgements of a record that was not there before."""
    if "postgresql" not in where:
        pytest.skip("SQLite lets nobody write while it is read")
    with open_store(where) as store, open_store(where) as other:
        store.add(*DRIFTING[:2])

        def meanwhile(_: Store) -> list[sql.Table]:
            if other.count() == 2:
                other.add(DRIFTING[5])
            return [*schema.JUDGED]

        monkeypatch.setattr(Store, "_judged", property(meanwhile))
        assert store.standing() == {one.id for one in DRIFTING[:2]}
        assert store.count() == 3
