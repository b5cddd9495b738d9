"""A store of any size: records are read and written a few at a time, each question costs what it has to, and an older
version's tables are brought up; for SQLite and for PostgreSQL.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sql

from cadcam.errors import UnknownName, UnreadableFile, UnusableStore
from cadcam.record import schema
from cadcam.record.export import each_record, read_records, record_as_json, write_records
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.store import Store, open_store
from cadcam.record.trend import trend
from cadcam.report.state.tables import record_tables, trend_tables

from .made import record
from .test_store import engine_of, same

GONE = Finding("stiffener", "presence", "FAIL", "missing: 0 of 9 edges that should show are seen")
THERE = Finding("stiffener", "presence", "PASS", "9 of 9 edges that should show are seen")
UNSEEN = Finding("stiffener", "position", "UNDECIDED", "it is missing: nothing of it to measure")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two records are read and written at once."""
    monkeypatch.setattr("cadcam.record.selection.AT_ONCE", 2)


@pytest.mark.usefixtures("few")
def test_records_are_read_a_few_at_a_time(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    reading = Store._read

    def counted(self: Store, ids: Any) -> list[Record]:
        read.extend(ids)
        return reading(self, ids)

    monkeypatch.setattr(Store, "_read", counted)
    with open_store(where) as store:
        store.add(*(record(n) for n in range(5)))
        selection = store.select()
        assert (len(selection), read) == (5, [])
        next(iter(selection))
        assert len(read) == 2
        assert [r.serial for r in selection] == [f"S{n:03d}" for n in range(5)]
        assert selection.roles() == {"photo", "cad"}
        assert len(list(store.select(newest=3))) == 3


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("suffix", [".csv", ".json", ".jsonl"])
def test_an_export_keeps_no_writer_waiting_and_is_that_of_its_moment(where: str, tmp_path: Path, suffix: str) -> None:
    """Another program adds after each record that is read, SQLite's included: none of those is in the file."""
    records = [record(n, findings=(THERE,)) for n in range(5)]
    with open_store(where) as store, open_store(where) as other:
        store.add(*records)
        selection = store.select()
        for _ in selection:
            other.add(Record("bracket"))
        write_records(tmp_path / f"streamed{suffix}", selection)
    write_records(tmp_path / f"listed{suffix}", records)
    assert (tmp_path / f"streamed{suffix}").read_bytes() == (tmp_path / f"listed{suffix}").read_bytes()


def test_a_record_lost_while_it_is_exported_leaves_the_old_file(where: str, tmp_path: Path) -> None:
    (tmp_path / "all.csv").write_text("old")
    with open_store(where) as store:
        store.add(record(sources=(), deviations=()))
        selection = store.select()
        engine = engine_of(where)
        with engine.begin() as connection:
            connection.execute(schema.measurement.delete())
        engine.dispose()
        with pytest.raises(UnusableStore, match="lost 1 records while it was read"):
            write_records(tmp_path / "all.csv", selection)
    assert [p.name for p in tmp_path.iterdir() if "all" in p.name] == ["all.csv"]
    assert (tmp_path / "all.csv").read_text() == "old"


@pytest.mark.usefixtures("few")
def test_what_cannot_be_had_in_full_is_not_stored(where: str) -> None:
    """Neither where a later record cannot be read, nor where one of a later batch is there already, or given twice."""

    def cut() -> Iterator[Record]:
        yield from (record(n) for n in range(3))
        raise UnreadableFile("all.jsonl", "line 4 is not JSON")

    with open_store(where) as store:
        one = record()
        store.add(one)
        with pytest.raises(UnreadableFile):
            store.add_all(cut())
        for last in (one, replace(one, id="new")):
            new = [replace(record(n), id=f"{last.id} {n}") for n in range(4)]
            with pytest.raises(UnusableStore, match=f"record {last.id} already; nothing was added"):
                store.add_all([replace(one, id="new"), *new, last])
        assert store.add_all(replace(one, id=f"{n}") for n in range(5)) == 5
        assert store.count() == 6


def test_who_reads_does_not_wait_for_an_import(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite keeps readers out from the moment at which a writer's pages do not fit in its cache, by default 2 MB."""
    monkeypatch.setattr("cadcam.record.address._WAIT_S", 0)
    seen = []

    def some() -> Iterator[Record]:
        for n in range(600):
            yield Record("bracket", reason=str(n) * 5000)  # 8 MB
        with open_store(where) as another:  # it might make one: to find that it need not is reading, too
            seen.append([r.part for r in another.query()])

    with open_store(where) as store:
        store.add(Record("bolt"))
        store.add_all(some())
        assert (seen, store.count()) == ([["bolt"]], 601)


def test_lines_are_read_one_by_one(tmp_path: Path) -> None:
    records = [record(n) for n in range(3)]
    write_records(tmp_path / "all.jsonl", records)
    lines = (tmp_path / "all.jsonl").read_bytes()
    (tmp_path / "all.jsonl").write_bytes(lines + b"{")
    rest = each_record(tmp_path / "all.jsonl")
    same(next(rest), records[0])
    with pytest.raises(UnreadableFile, match="line 4 is not JSON"):
        list(rest)
    (tmp_path / "wide.jsonl").write_bytes(lines.decode().encode("utf-16"))
    for one, back in zip(records, read_records(tmp_path / "wide.jsonl"), strict=True):
        same(back, one)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b'{"part": "p", "deviations": []}\n\xff\n', "byte 0 of line 2 is 0xff; give a text file in UTF-8"),
        (b"[" * 300, "line 1 has more than 200 bytes"),
    ],
)
def test_what_is_no_file_of_lines_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: bytes, says: str
) -> None:
    monkeypatch.setattr("cadcam.files.text.MAX_BYTES", 200)
    (tmp_path / "bad.jsonl").write_bytes(data)
    with pytest.raises(UnreadableFile, match=says):
        read_records(tmp_path / "bad.jsonl")
    with pytest.raises(UnreadableFile, match="no such file"):
        read_records(tmp_path / "none.jsonl")
    (tmp_path / "folder.jsonl").mkdir()
    with pytest.raises(UnreadableFile, match="is a folder"):
        read_records(tmp_path / "folder.jsonl")


def test_no_question_is_asked_of_every_record_for_every_record(tmp_path: Path) -> None:
    """SQLite's plans: a subquery that is correlated costs the square of the records, one serial takes no scan."""
    plans: list[str] = []

    def explained(connection: sql.Connection, _: Any, statement: str, given: Any, *__: Any) -> None:
        if statement.startswith("SELECT"):
            cursor = connection.connection.cursor()
            plans.extend(row[3] for row in cursor.execute(f"EXPLAIN QUERY PLAN {statement}", given))

    with open_store(tmp_path / "parts.sqlite") as store:
        store.add(*(record(n) for n in range(3)))
        sql.event.listen(store._engine, "before_cursor_execute", explained)
        store.query(feature="stiffener")
        store.of_feature("stiffener")
        assert plans
        assert not [plan for plan in plans if "CORRELATED" in plan]
        plans.clear()
        store.query(serial="S001", part="bracket")
        store.count(serial="S001")
        assert not [plan for plan in plans if plan.startswith("SCAN measurement")]


def as_version_1(where: str) -> None:
    """Make a store what cadcam made before there were findings."""
    engine = engine_of(where)
    with engine.begin() as connection:
        schema.finding.drop(connection)
        next(i for i in schema.measurement.indexes if i.name == "measurement_by_serial").drop(connection)
        connection.execute(schema.store.update().values(version=1))
    engine.dispose()


def test_a_store_of_version_1_is_read_as_it_is_and_brought_up_when_it_is_written(where: str) -> None:
    old, new = record(1), record(2, findings=(GONE, UNSEEN))
    with open_store(where) as store:
        store.add(old)
    as_version_1(where)
    for _ in range(2):  # to read changes nothing
        with open_store(where, create=False) as store:
            same(store.query(feature="stiffener")[0], old)
            assert [len(r.deviations) for r in store.of_feature("stiffener")] == [1]
            assert store.values("feature") == {"stiffener", "face"}
    with open_store(where) as store:
        store.add(new)
    engine = engine_of(where)
    indices = {index["name"] for index in sql.inspect(engine).get_indexes("measurement")}
    engine.dispose()
    assert "measurement_by_serial" in indices
    with open_store(where, create=False) as store:
        for one, back in zip((old, new), store.query(), strict=True):
            same(back, one)
        (back,) = store.query(serial=new.serial, feature="stiffener")
        same(back, new)


@pytest.mark.parametrize("suffix", [".json", ".jsonl"])
def test_findings_are_exported_and_come_back(tmp_path: Path, suffix: str) -> None:
    one = record(findings=(THERE, UNSEEN))
    write_records(tmp_path / f"one{suffix}", [one])
    same(read_records(tmp_path / f"one{suffix}")[0], one)
    write_records(tmp_path / "one.csv", [one])
    assert "stiffener,presence,,,,,,,,,,PASS,9 of 9 edges" in (tmp_path / "one.csv").read_text()
    assert ("stiffener", "presence", "PASS", THERE.reason) in record_tables(one)[3].rows
    assert record_as_json(one)["findings"][1]["verdict"] == "UNDECIDED"


def test_a_trend_of_presence_says_since_when_it_is_missing(where: str) -> None:
    """It was there, gone once, and is gone since the fifth; asked for without its kind the trend is that in mm."""
    found = [THERE, THERE, GONE, THERE, GONE, GONE]
    records = [
        record(n, findings=(f,) if f is THERE else (f, UNSEEN), deviations=record(n).deviations if f is THERE else ())
        for n, f in enumerate(found)
    ]
    with open_store(where) as store:
        store.add(*records, record(9, deviations=()))
        of_it = store.of_feature("stiffener", part="bracket")
    seen = trend(of_it, "stiffener", kind="presence")
    assert [r.serial for r in seen.unchanged] == ["S004", "S005"]
    assert seen.verdicts == {"PASS": 3, "FAIL": 3}
    assert (len(seen), seen.points, seen.unit, len(seen.without)) == (6, (), "", 1)
    lines, over_all = trend_tables(seen, newest=4)
    assert lines.title == "stiffener, 4 records, the latest of 6"
    assert lines.rows[-1] == ("2026-03-02 12:05:00", "bracket", "S005", GONE.reason, "FAIL")
    assert dict(over_all.rows)["at the end"] == "FAIL since 2026-03-02 12:04:00 S004, 2 records"
    in_mm = trend(of_it, "stiffener")
    assert [d.deviation for _, d in in_mm.points] == [r.deviations[0].deviation for r in records if r.deviations]
    assert [r.serial for r in in_mm.unchanged] == ["S004", "S005"]
    assert dict(trend_tables(in_mm)[1].rows)["could not be measured"] == "3 of 6 records"
    assert trend(records, "stiffener").mean == in_mm.mean
    with pytest.raises(UnknownName, match="did you mean 'presence'"):
        trend(of_it, "stiffener", kind="presense")


def test_what_a_trend_needs_is_little(where: str) -> None:
    with open_store(where) as store:
        store.add(record(1, findings=(THERE, Finding("face"))))
        (light,) = store.of_feature("stiffener")
    assert light.deviations == (record(1).deviations[0],)
    assert (light.findings, light.pose, light.sources) == ((THERE,), None, ())
    assert (light.serial, light.time, light.verdict) == ("S001", record(1).time, "PASS")


def test_a_verdict_that_is_none_is_no_finding() -> None:
    with pytest.raises(UnknownName, match="verdict of 'rib'"):
        Finding("rib", verdict="GONE")
    assert Deviation("rib", 0.0, 0.1).verdict == Finding("rib").verdict == ""


def test_postgresql_gets_many_rows_in_one_statement(where: str) -> None:
    """Its driver sends those of an executemany one at a time, and waits for each: minutes of 20 000 records."""
    parameters: list[object] = []

    def sent(*call: Any) -> None:
        if "INSERT" in call[2]:
            parameters.append(call[3])

    meant = [record(n, findings=(THERE, UNSEEN)) for n in range(5)]
    with open_store(where) as store:
        sql.event.listen(store._writing, "before_cursor_execute", sent)
        store.add(*meant)
        assert len(parameters) == 4  # tables
        assert any(isinstance(p, list) for p in parameters) == ("://" not in where)  # a list: of rows, one at a time
        for found, one in zip(store.select(), meant, strict=True):
            same(found, one)
