"""What a store gives back is what was added; each theorem holds for SQLite and for PostgreSQL."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import fields
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sql
from sqlalchemy import exc

from cadcam.errors import BadValue, UnknownName, UnusableStore
from cadcam.record import schema
from cadcam.record.address import explained
from cadcam.record.export import write_records
from cadcam.record.record import Deviation, Finding, Record, Source
from cadcam.record.store import open_store

from .made import NOON, record


def same(one: Record, other: Record) -> None:
    """Assert that two records are equal to the last bit."""
    for name in (f.name for f in fields(Record) if f.name != "pose"):
        assert getattr(one, name) == getattr(other, name), name
    assert (one.pose is None) == (other.pose is None)
    if one.pose is not None and other.pose is not None:
        np.testing.assert_array_equal(one.pose.world_from_part.matrix, other.pose.world_from_part.matrix)
        for name in ("from_noise", "from_calibration", "freedom", "dof", "undetermined"):
            np.testing.assert_array_equal(getattr(one.pose, name), getattr(other.pose, name))


def test_a_record_comes_back_to_the_last_bit(where: str) -> None:
    full = record(1)
    bare = Record("bolt", time=NOON)
    with open_store(where) as store:
        store.add(full)
        store.add(bare)
    with open_store(where) as store:
        a, b = store.query(part="bracket"), store.query(part="bolt")
    same(a[0], full)
    same(b[0], bare)


def test_records_are_found_by_the_file_that_they_came_from(where: str) -> None:
    with open_store(where) as store:
        store.add(record(1), record(2), Record("bolt", sources=(Source("cad", "bolt.step", "12" * 32),)))
        assert [r.serial for r in store.query(sha256="0c" * 32)] == ["S001", "S002"]
        assert store.count(sha256="12" * 32) == 1
        assert store.query(sha256="ab" * 32, serial="S002")[0].serial == "S002"
        assert store.query(sha256="00" * 32) == []
        assert [r.serial for r in store.query(sha256=["0c" * 32, "12" * 32, "00" * 32])] == ["S001", "S002", ""]
        assert store.query(sha256=()) == []


@pytest.mark.parametrize(
    "made",
    [
        lambda: Record("bracket", serial=17),
        lambda: Deviation(3, 0.1, 0.2),
        lambda: Source(None, "photo.png", "0" * 64),
    ],
    ids=["serial of a record", "feature of a deviation", "role of a source"],
)
def test_what_is_to_be_a_text_is_one(made: Callable[[], object], request: pytest.FixtureRequest) -> None:
    with pytest.raises(BadValue, match=request.node.callspec.id):
        made()


def test_the_time_is_kept_in_utc_whatever_its_zone(where: str) -> None:
    east = datetime(2026, 3, 2, 23, 30, 0, 123456, tzinfo=timezone(timedelta(hours=9)))
    with open_store(where) as store:
        store.add(record(time=east))
        (back,) = store.query(since=east, until=east)
    assert back.time == east
    assert back.time.tzinfo is UTC


def test_a_query_returns_what_is_all_of_what_is_asked_oldest_first(where: str) -> None:
    records = [
        record(3, station="cell 1", verdict="FAIL"),
        record(0),
        record(2, part="bolt", verdict=""),
        record(1, deviations=()),
    ]
    with open_store(where) as store:
        for one in records:
            store.add(one)

        def serials(**asked: Any) -> list[str]:
            found = [r.serial for r in store.query(**asked)]
            asked.pop("newest", None)
            assert store.count(**asked) == len(store.query(**asked)) >= len(found)
            return found

        assert serials() == ["S000", "S001", "S002", "S003"]
        assert serials(part="bracket") == ["S000", "S001", "S003"]
        assert serials(part="bracket", verdict="FAIL") == ["S003"]
        assert serials(verdict="") == ["S002"]
        assert serials(station="cell 3", since=NOON + timedelta(minutes=1)) == ["S001", "S002"]
        assert serials(until=NOON + timedelta(minutes=1)) == ["S000", "S001"]
        assert serials(serial="S002") == ["S002"]
        assert serials(feature="stiffener", part="bracket") == ["S000", "S003"]
        assert serials(newest=2) == ["S002", "S003"]
        for newest in (0, -1, 1.5):
            with pytest.raises(BadValue, match=r"newest.*a whole number of at least 1"):
                serials(newest=newest)
        assert serials(id_begins=records[1].id[:9]) == ["S000"]
        assert serials(station="nowhere") == []
        with pytest.raises(UnknownName, match="did you mean 'FAIL'"):
            store.query(verdict="FAILED")
        with pytest.raises(BadValue, match="with its zone"):
            store.query(since=datetime(2026, 1, 1))
        with pytest.raises(UnknownName, match="did you mean 'serial'"):
            store.count(serials="S002")  # type: ignore[call-arg]
        assert store.values("part") == {"bracket", "bolt"}
        assert store.values("station") == {"cell 1", "cell 3"}


@pytest.mark.parametrize("name", ["id_begins", "part", "serial", "station", "verdict", "feature"])
def test_a_question_that_is_no_text_is_refused(tmp_path: Path, name: str) -> None:
    """A serial asked for as a number matched nothing, without a word."""
    with open_store(tmp_path / "parts.sqlite") as store:
        with pytest.raises(BadValue, match=f"{name} is 17; expected a str"):
            store.query(**{name: 17})  # type: ignore[misc]
        with pytest.raises(BadValue, match="feature is 17; expected a str"):
            store.of_feature(17)  # type: ignore[arg-type]


def test_the_case_of_an_id_counts(where: str) -> None:
    with open_store(where) as store:
        store.add(record(0, id="abc"), record(1, id="ABC"))
        assert [r.id for r in store.query(id_begins="AB")] == ["ABC"]


def test_deviations_and_sources_stay_with_their_record_and_in_their_order(where: str) -> None:
    many = tuple(Deviation(f"f{i}", float(i), 0.1) for i in (5, 3, 9, 1))
    with open_store(where) as store:
        for n in range(3):
            store.add(record(n, deviations=many[n:], sources=(Source("photo", f"{n}.png", f"{n}" * 64),)))
        back = store.query()
    features = [[d.feature for d in r.deviations] for r in back]
    assert features == [["f5", "f3", "f9", "f1"], ["f3", "f9", "f1"], ["f9", "f1"]]
    assert [r.sources[0].path for r in back] == ["0.png", "1.png", "2.png"]


def test_hostile_names_are_only_names(where: str) -> None:
    name = "x'); DROP TABLE measurement; -- \" % :a ? é 漢"
    with open_store(where) as store:
        store.add(record(part=name))
        assert [r.part for r in store.query(part=name)] == [name]


@pytest.mark.parametrize("name", ["two\nlines\t", "\u202eabc", "a\0b", "e\u0301", "\x1b[31m", "%_\\"])
def test_names_of_any_characters_are_kept_and_asked_for(where: str, name: str) -> None:
    """The character 0, which PostgreSQL does not take, is spelled out; nothing else is changed."""
    with open_store(where) as store:
        kept = record(part=name, findings=(Finding(name, reason=name),), id=f"{name} 1")
        store.add(kept, record(1))
        for found in (store.query(part=name), store.query(feature=name), store.query(id_begins=name)):
            assert [r.part for r in found] == [name.replace("\0", r"\x00")]
        assert [len(r.findings) for r in store.of_feature(name)] == [1, 0]
        same(store.query(part=name)[0], kept)


def damaged(where: str, statement: str) -> None:
    """Change what is in a store by other means."""
    engine = engine_of(where)
    with engine.begin() as connection:
        connection.exec_driver_sql(statement)
    engine.dispose()


@pytest.mark.parametrize(
    ("statement", "says"),
    [
        ("UPDATE deviation SET deviation_mm = NULL", "is damaged"),
        ("UPDATE source SET sha256 = 'x'", "is damaged .*64 hexadecimal digits"),
        ("UPDATE measurement SET uncertainty_mm_rad = '{}'", "is damaged"),
        ("UPDATE measurement SET verdict = 'x'", "is damaged .*unknown verdict"),
    ],
)
def test_a_row_that_was_not_written_here_is_no_bug_but_damage(where: str, statement: str, says: str) -> None:
    with open_store(where) as store:
        store.add(record())
        damaged(where, statement)
        with pytest.raises(UnusableStore, match=says):
            store.query()


def test_a_file_that_broke_is_called_damaged(tmp_path: Path) -> None:
    """Zeros in place of all its pages but the first few, and text in place of JSON."""
    with open_store(tmp_path / "parts.sqlite") as store:
        store.add(*(record(n) for n in range(30)))
    data = (tmp_path / "parts.sqlite").read_bytes()
    for name, broken in (
        ("zeros", data[:8192] + bytes(len(data) - 8192)),
        ("JSON", data.replace(b'{"from_noise"', b'("from_noise"')),
        ("text", data.replace(b"stiffener", b"\xfftiffener")),
    ):
        (tmp_path / f"{name}.sqlite").write_bytes(broken)
        with (
            pytest.raises(UnusableStore, match=r"is damaged .*sqlite3 FILE .recover"),
            open_store(tmp_path / f"{name}.sqlite", create=False) as store,
        ):
            store.query()


def test_the_same_record_is_not_added_twice(where: str) -> None:
    one = record()
    with open_store(where) as store:
        store.add(one)
        with pytest.raises(UnusableStore, match=f"record {one.id} already"):
            store.add(record(1), one)
        assert len(store.query()) == 1


def test_a_record_that_fails_half_way_leaves_nothing(where: str) -> None:
    """The last of its rows breaks a key: without one transaction its head and first rows would stay."""
    with open_store(where) as store, pytest.MonkeyPatch.context() as patch:
        one = record()
        rows = [{"measurement_id": "no such", "place": 0, "role": "cad", "path": "p", "sha256": "s"}]
        patch.setattr("cadcam.record.store.source_rows", lambda _: rows)
        with pytest.raises(UnusableStore):
            store.add(one)
        patch.undo()
        assert store.query() == []
        store.add(one)
        assert len(store.query()) == 1


def test_several_programs_write_at_once(where: str) -> None:
    """Four stores opened at the same moment, the tables not made yet: all records are there in the end."""
    failures: list[Exception] = []

    def write(k: int) -> None:
        try:
            with open_store(where) as store:
                for n in range(10):
                    store.add(record(10 * k + n))
                    store.query(newest=1)
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=write, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    with open_store(where) as store:
        assert [r.serial for r in store.query()] == [f"S{n:03d}" for n in range(40)]


def engine_of(where: str) -> sql.Engine:
    url = where.replace("postgresql:", "postgresql+pg8000:") if "://" in where else f"sqlite:///{where}"
    return sql.create_engine(url)


def test_tables_of_another_version_are_refused_and_left_alone(where: str) -> None:
    with open_store(where) as store:
        store.add(record())
    engine = engine_of(where)
    with engine.begin() as connection:
        connection.execute(schema.store.update().values(version=schema.VERSION + 1, software="cadcam 9.9"))
    with pytest.raises(
        UnusableStore, match=r"tables of version 3 \(made by cadcam 9.9\).*reads and writes versions up to 2"
    ):
        open_store(where)
    with engine.begin() as connection:
        assert len(connection.execute(sql.select(schema.measurement)).all()) == 1
    engine.dispose()


def test_tables_of_other_origin_are_refused(where: str) -> None:
    engine = engine_of(where)
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE measurement (what INTEGER)")
    engine.dispose()
    with pytest.raises(UnusableStore, match="tables of other origin"):
        open_store(where)


def test_a_store_to_read_from_is_not_made(where: str) -> None:
    with pytest.raises(UnusableStore, match=r"no such file|holds no product state"):
        open_store(where, create=False)


def test_columns_name_their_units() -> None:
    """Every column of numbers ends in its unit, is a pure number, or is a place in an order."""
    pure = {"k", "quality", "place", "version", *schema.ROTATION}
    for table in schema.tables.sorted_tables:
        for column in table.columns:
            if isinstance(column.type, (sql.Double, sql.Integer)):
                assert column.name in pure or column.name.endswith(("_mm", "_deg")), column.name
            if isinstance(column.type, sql.DateTime):
                assert column.name.endswith("_utc")


def test_what_is_no_text_is_spelled_out_wherever_a_name_may_stand(where: str, tmp_path: Path) -> None:
    odd = "b\udcfcgel"  # a name in Latin-1 on Linux, or the JSON of another program
    one = Deviation(odd, 0.1, 0.1, kind=odd)
    kept = Record(odd, deviations=(one,), sources=(Source(odd, odd, "0" * 64),), software=odd, id=odd)
    with open_store(where) as store:
        store.add(kept)
        assert store.query(part=odd, feature=odd, id_begins=odd) == [kept]
        assert store.count(serial=odd) == 0
    write_records(tmp_path / "all.csv", [kept])
    assert r"b\udcfcgel" in (tmp_path / "all.csv").read_text()


def test_a_time_beyond_the_calendar_of_utc_is_refused(where: str) -> None:
    early = datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=14)))
    with pytest.raises(BadValue, match="time of a record is 0001-01-01"):
        Record("bolt", time=early)
    with open_store(where) as store, pytest.raises(BadValue, match="since is 0001-01-01"):
        store.query(since=early)


def test_what_names_no_file_or_column_is_told() -> None:
    with pytest.raises(BadValue, match=r"address of a store is 'sqlite://'; expected a file after it"):
        open_store("sqlite://")
    with open_store(":memory:") as store, store.claimed("judging", "process 7"):
        assert not Path(":memory:").exists()
        assert not list(Path().glob(":memory:*"))
        with pytest.raises(UnknownName, match=r"unknown column 'parts'; did you mean 'part'\?"):
            store.values("parts")  # type: ignore[arg-type]


def test_an_error_without_words_is_named_by_its_kind() -> None:
    assert explained(exc.OperationalError("", {}, TimeoutError(""))) == ("TimeoutError", "")
