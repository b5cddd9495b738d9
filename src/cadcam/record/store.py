"""The store of product state: an SQLite file at a station, a PostgreSQL database for a yard; one code for both.

A record is stored as a whole or not at all, and once `add` has returned no crash loses it: SQLite writes its journal
and its folder to the disk first (synchronous=EXTRA), PostgreSQL its log (synchronous_commit, its default). Several
programs may write at once; SQLite serialises them.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from datetime import datetime
from types import TracebackType
from typing import Any, Literal, Self, TypedDict, Unpack, get_args

import sqlalchemy as sql
from sqlalchemy import exc

import cadcam
from cadcam.errors import BadValue, CadcamError, MissingExtra, UnknownName, UnusableStore
from cadcam.kinds import expect, expect_count, expect_each, expect_flag, expect_known, expect_path
from cadcam.record import schema
from cadcam.record.address import MEMORY, MENDED, check_file, engine_of, explained, url_of
from cadcam.record.claim import Claimed, claimed_by_file, claimed_in_database
from cadcam.record.record import VERDICTS, Record, as_kept, in_utc
from cadcam.record.rows import (
    SUMMARY,
    deviation_rows,
    finding_rows,
    measurement_row,
    record_of,
    source_rows,
    summary_of,
)
from cadcam.record.selection import Selection, batches
from cadcam.record.trend import which_stand

_LOCK = 0x63616463  # PostgreSQL's advisory lock while tables are created

_Belonging = Mapping[str, list[Mapping[str, Any]]]
Named = Literal["part", "serial", "station"]
NAMED: tuple[Named, ...] = get_args(Named)


_TEXTS = {"id_begins", *NAMED, "verdict", "feature"}  # of `Which`


class Which(TypedDict, total=False):
    """Which records are meant: those that match all that is given and is not None.

    id_begins: the beginning of their id. verdict: "" means not judged. since, until: times with their zone, both
    included. feature: only those with a deviation or a finding of this name. sha256: only those that came from a file
    of this fingerprint, or of one of these, be it photo, CAD, camera or tolerances.
    """

    id_begins: str | None
    part: str | None
    serial: str | None
    station: str | None
    verdict: str | None
    since: datetime | None
    until: datetime | None
    feature: str | None
    sha256: str | Sequence[str] | None


def open_store(where: str | os.PathLike[str], *, create: bool = True) -> Store:
    """Return the store in an SQLite file, or in the database of a URL postgresql://user:password@host:port/name.

    PostgreSQL's driver is pg8000 unless the URL names another (postgresql+psycopg://...). A new store is created where
    there is none, unless `create` is False. Raises `UnusableStore` where it cannot be opened, is not a store, or has
    another version's tables, `MissingExtra` without a driver. Use it in a `with` block, or `close` it.
    """
    expect_path(where, "store")
    expect_flag(create, "create")
    url = url_of(os.fspath(where))
    if url.get_backend_name() == "sqlite":
        check_file(str(url.database), create)
    name = str(url.database) if url.get_backend_name() == "sqlite" else url.render_as_string(hide_password=True)
    try:
        store = Store(engine_of(url), name)
    except ModuleNotFoundError as error:
        if error.name != "pg8000":
            raise UnusableStore(name, f"its driver {error.name!r} is not installed", "install it") from error
        raise MissingExtra("a store in PostgreSQL", "postgresql", "pg8000") from error
    except exc.NoSuchModuleError:
        raise UnusableStore(name, f"no driver is called {url.get_driver_name()!r}", "leave it out: pg8000") from None
    try:
        store.reach()
        store.prepare(create=create)
    except BaseException:
        store.close()
        raise
    return store


class Store:
    """An open store; created by `open_store`."""

    def __init__(self, engine: sql.Engine, name: str) -> None:
        self.name = name
        self._engine = engine
        self._writing = engine.execution_options(writing=True)
        self._version = schema.VERSION

    def __repr__(self) -> str:
        return f"Store({self.name!r})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def add(self, *records: Record) -> None:
        """Store records, all of them or none: once this returns they are on the disk.

        Raises `UnusableStore` if a record of the same id exists already.
        """
        self.add_all(expect_each(records, "records", Record))

    def add_all(self, records: Iterable[Record]) -> int:
        """Store records as `add` does, a few at a time as they are asked for; return how many there were.

        Where one cannot be had, none is stored. SQLite lets nobody else write meanwhile, and from 64 MB on (some 30 000
        records of ten deviations) nobody read either.
        """
        count = 0
        with self._transaction(self._writing) as connection:
            for some in batches(records):
                for record in some:
                    expect(record, "a record", Record)
                self._check_new(connection, [record.id for record in some])
                for table, rows in (
                    (schema.measurement, [measurement_row(record) for record in some]),
                    (schema.deviation, [row for record in some for row in deviation_rows(record)]),
                    (schema.finding, [row for record in some for row in finding_rows(record)]),
                    (schema.source, [row for record in some for row in source_rows(record)]),
                ):
                    if rows:
                        _insert(connection, table, rows)
                count += len(some)
        return count

    def query(self, *, newest: int | None = None, **which: Unpack[Which]) -> list[Record]:
        """Return the records that match all arguments, oldest first; without arguments all of them.

        which: id_begins, part, serial, station, verdict, since, until, feature, sha256; see `Which`. newest: at most
        this many, the latest of them: no others are read.
        """
        return list(self.select(newest=newest, **which))

    def select(self, *, newest: int | None = None, **which: Unpack[Which]) -> Selection:
        """Return the records that `query` returns, to go through: they are read a few at a time."""
        if newest is not None:
            expect_count(newest, "newest")
        m = schema.measurement.c
        chosen = sql.select(m.id).where(*self._wanted(which)).order_by(m.time_utc.desc(), m.id.desc()).limit(newest)
        with self._transaction(self._engine) as connection:
            ids = connection.execute(chosen).scalars().all()
        return Selection(ids[::-1], self._read, self._roles)

    def of_feature(self, name: str, **which: Unpack[Which]) -> list[Record]:
        """Return the records that `query` returns, with what was judged of one feature alone, for `trend`.

        They lack pose, quality, sources, software and all other features: they take a twentieth of the memory.
        """
        m, wanted = schema.measurement.c, self._wanted(which)
        heads = sql.select(*(m[column] for column in SUMMARY)).where(*wanted).order_by(m.time_utc, m.id)
        expect(name, "feature", str)
        with self._readable(), self._transaction(self._engine) as connection:
            judged = self._what_was_judged(connection, sql.select(m.id).where(*wanted), feature=as_kept(name))
            rows = connection.execute(heads).mappings()
            return [summary_of(dict(row), *(one.get(row["id"], ()) for one in judged)) for row in rows]

    def standing(self, **which: Unpack[Which]) -> set[str]:
        """Return the ids of the records that `query` returns and that no later one of them replaces (`trend.standing`).

        No record is read for that: of each feature kind and verdict are enough.
        """
        m, wanted = schema.measurement.c, self._wanted(which)
        heads = sql.select(m.id, m.part, m.serial, m.station).where(*wanted).order_by(m.time_utc, m.id)
        with self._transaction(self._engine) as connection:
            rows = connection.execute(heads).all()
            said: dict[str, set[tuple[str, str, str]]] = {row.id: set() for row in rows}
            for table in self._judged:
                t = table.c
                mine = sql.select(t.measurement_id, t.feature, t.kind, t.verdict)
                for one in connection.execute(mine.where(t.measurement_id.in_(sql.select(m.id).where(*wanted)))):
                    if one.measurement_id in said:  # else another station has just added it
                        said[one.measurement_id].add((one.feature, one.kind, one.verdict))
        stand = which_stand([(row.part, row.serial, row.station) for row in rows], list(said.values()))
        return {row.id for row, stands in zip(rows, stand, strict=True) if stands}

    def count(self, **which: Unpack[Which]) -> int:
        """Return how many records match all arguments, which are those of `query`; none of them is read."""
        counted = sql.select(sql.func.count()).select_from(schema.measurement).where(*self._wanted(which))
        with self._transaction(self._engine) as connection:
            return int(connection.execute(counted).scalar_one())

    def values(self, name: Named | Literal["feature"]) -> set[str]:
        """Return the parts, serials, stations or features that the store holds records of."""
        expect_known(name, "column", (*NAMED, "feature"))
        tables = self._judged if name == "feature" else [schema.measurement]
        with self._transaction(self._engine) as connection:
            return {one for t in tables for one in connection.execute(sql.select(t.c[name]).distinct()).scalars()}

    def reach(self) -> None:
        """Connect once. Raises `UnusableStore`, also where the driver does not know an option in the address."""
        try:
            with self._transaction(self._engine):
                pass
        except TypeError as error:  # an argument of the driver's own `connect`
            remedy = "leave it out, or name a driver that has it, such as postgresql+psycopg://"
            raise UnusableStore(self.name, f"its driver does not take all of the address ({error})", remedy) from None

    def prepare(self, *, create: bool) -> None:
        """Create the tables where there are none, and what those of an older version lack; refuse a newer one's.

        Who finds all as it should be has only read: it need not wait for those that write.
        """
        if create:
            with self._transaction(self._engine) as connection:
                there = set(sql.inspect(connection).get_table_names())
                if schema.store.name in there and self._checked_version(connection) == schema.VERSION:
                    return
        with self._transaction(self._writing if create else self._engine) as connection:
            if connection.dialect.name == "postgresql":  # two programs that create the tables at once
                connection.execute(sql.select(sql.func.pg_advisory_xact_lock(_LOCK)))
            there = set(sql.inspect(connection).get_table_names())
            if schema.store.name in there:
                self._version = self._checked_version(connection)
                if create and self._version < schema.VERSION:
                    _bring_up(connection)
                    self._version = schema.VERSION
            elif there & set(schema.tables.tables):
                taken = ", ".join(sorted(there & set(schema.tables.tables)))
                raise UnusableStore(self.name, f"has tables of other origin ({taken})", "give it a database of its own")
            elif not create:
                raise UnusableStore(self.name, "holds no product state", "is it the right one?")
            else:
                schema.tables.create_all(connection)
                row = {"version": schema.VERSION, "software": f"cadcam {cadcam.__version__}"}
                connection.execute(schema.store.insert(), row)

    @contextmanager
    def claimed(self, what: str, who: str) -> Iterator[Callable[[], None]]:
        """Let one program at a time do something with this store; the next gets `UnusableStore`, which says who does.

        The claim ends with the program, however it ends. what: the same text claims the same; who: this program, in
        words. With SQLite it is a lock on a file beside the store, and no claim where the system has no locks. A server
        that is started anew forgets it: what is yielded, called now and then, takes it again, or raises likewise.
        """
        try:
            if self._engine.dialect.name == "postgresql":
                with claimed_in_database(self._engine, what, who) as hold:
                    yield hold
                return
            memory = self.name == MEMORY  # which nobody else has
            with nullcontext() if memory else claimed_by_file(self.name, what, who):
                yield lambda: None
        except Claimed as other:
            reason = f"{what} is at work already: {other.who or 'another program'}"
            raise UnusableStore(self.name, reason, "let that one do it, or end it first") from None
        except exc.DBAPIError as error:
            raise UnusableStore(self.name, *explained(error)) from error

    @property
    def _judged(self) -> list[sql.Table]:
        """Return the tables of what was judged; one of version 1 that is only read has no findings."""
        return [*schema.JUDGED] if self._version > 1 else [schema.deviation]

    def _wanted(self, which: Which) -> list[sql.ColumnElement[bool]]:
        """Return the conditions that records have to meet."""
        unknown = next((name for name in which if name not in Which.__annotations__), None)
        if unknown is not None:
            raise UnknownName("filter of records", unknown, Which.__annotations__)
        asked: dict[str, Any] = dict(which)
        for name in _TEXTS & set(which):
            expect(asked[name], name, str, optional=True)
            # what is no text in a name is asked for as `Record` keeps it
            asked[name] = None if asked[name] is None else as_kept(asked[name])
        m = schema.measurement.c
        equal = {name: asked.get(name) for name in ("part", "serial", "station", "verdict")}
        if verdict := asked.get("verdict"):
            _check_known(verdict)
        wanted = [m[name] == value for name, value in equal.items() if value is not None]
        if begins := asked.get("id_begins"):
            wanted.append(sql.func.substr(m.id, 1, len(begins)) == begins)  # by `like` SQLite takes a for A
        if since := asked.get("since"):
            wanted.append(m.time_utc >= _utc("since", since))
        if until := asked.get("until"):
            wanted.append(m.time_utc <= _utc("until", until))
        if (feature := asked.get("feature")) is not None:
            # not by `exists`, for which SQLite would go through all deviations of the feature for each measurement
            having = (sql.select(t.c.measurement_id).where(t.c.feature == feature) for t in self._judged)
            wanted.append(m.id.in_(sql.union_all(*having)))
        if (sha256 := asked.get("sha256")) is not None:
            several = expect_each([sha256] if isinstance(sha256, str) else sha256, "sha256", str)
            came = schema.source.c
            having_one = came.sha256.in_([as_kept(one) for one in several])
            wanted.append(m.id.in_(sql.select(came.measurement_id).where(having_one)))
        return wanted

    def _read(self, ids: Sequence[str]) -> list[Record]:
        """Return the records of these ids, oldest first."""
        m = schema.measurement
        with self._readable(), self._transaction(self._engine) as connection:
            heads = sql.select(m).where(m.c.id.in_(ids)).order_by(m.c.time_utc, m.c.id)
            rows = connection.execute(heads).mappings().all()
            belonging = [*self._what_was_judged(connection, ids), _belonging(connection, schema.source, ids)]
            records = [record_of(dict(row), *(one.get(row["id"], ()) for one in belonging)) for row in rows]
        if len(rows) < len(ids):
            raise UnusableStore(self.name, f"lost {len(ids) - len(rows)} records while it was read", "try again")
        return records

    def _what_was_judged(
        self, connection: sql.Connection, ids: Sequence[str] | sql.Select[Any], *, feature: str | None = None
    ) -> list[_Belonging]:
        """Return the deviations and the findings of these records, of one feature or all."""
        tables = self._judged
        return [_belonging(connection, t, ids, feature=feature) if t in tables else {} for t in schema.JUDGED]

    def _roles(self, ids: Sequence[str]) -> set[str]:
        """Return the roles of the sources of these records."""
        s = schema.source.c
        with self._transaction(self._engine) as connection:
            return set(connection.execute(sql.select(s.role).where(s.measurement_id.in_(ids)).distinct()).scalars())

    def _check_new(self, connection: sql.Connection, ids: Sequence[str]) -> None:
        """Raise `UnusableStore` where one of these records is here already, or twice among them."""
        m = schema.measurement.c
        there = set(connection.execute(sql.select(m.id).where(m.id.in_(ids))).scalars())
        for one in ids:
            if one in there:
                raise UnusableStore(self.name, f"holds a record {one} already", "nothing was added")
            there.add(one)

    def _checked_version(self, connection: sql.Connection) -> int:
        row = connection.execute(sql.select(schema.store)).mappings().one()
        if not 1 <= row["version"] <= schema.VERSION:
            raise UnusableStore(
                self.name,
                f"has tables of version {row['version']} (made by {row['software']}); cadcam {cadcam.__version__} "
                f"reads and writes versions up to {schema.VERSION}",
                "export it with the cadcam that made it (cadcam state export -o all.jsonl); add that to a new store",
            )
        return int(row["version"])

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Raise `UnusableStore` where what is read cannot have been written by `add`: the disk, or other programs."""
        try:
            yield
        except UnusableStore:
            raise
        except (CadcamError, ValueError, TypeError, KeyError) as error:
            raise UnusableStore(self.name, f"is damaged ({error})", MENDED) from error

    @contextmanager
    def _transaction(self, engine: sql.Engine) -> Iterator[sql.Connection]:
        """Yield a connection whose work is committed as one transaction; database errors become one clear error."""
        try:
            with engine.begin() as connection:
                yield connection
        except exc.DBAPIError as error:
            raise UnusableStore(self.name, *explained(error)) from error


def _belonging(
    connection: sql.Connection,
    table: sql.Table,
    ids: Sequence[str] | sql.Select[Any],
    *,
    feature: str | None = None,
) -> _Belonging:
    """Return the rows of a table by the measurement that they belong to, in order; feature: only those of this one."""
    of = table.c.measurement_id
    rows = sql.select(table).where(of.in_(ids), *([] if feature is None else [table.c.feature == feature]))
    out: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for row in connection.execute(rows.order_by(of, table.c.place)).mappings():
        out[row["measurement_id"]].append(dict(row))
    return out


def _bring_up(connection: sql.Connection) -> None:
    """Add what tables of an older version lack; what is in them stays as it is."""
    schema.tables.create_all(connection)
    for table in schema.tables.sorted_tables:
        for index in table.indexes:
            index.create(connection, checkfirst=True)
    connection.execute(schema.store.update().values(version=schema.VERSION))


def _utc(what: str, time: datetime) -> datetime:
    expect(time, what, datetime)
    if time.tzinfo is None:
        raise BadValue(what, time.isoformat(), "a time with its zone")
    return in_utc(what, time).replace(tzinfo=None)


def _check_known(verdict: str) -> None:
    expect_known(verdict, "verdict", VERDICTS)


def _insert(connection: sql.Connection, table: sql.Table, rows: list[dict[str, Any]]) -> None:
    """Insert rows, many in one statement where the driver would send one at a time and wait for each, as PostgreSQL's.

    That is what asking for their keys brings about; nobody reads them.
    """
    many = table.insert()
    connection.execute(many.returning(*table.primary_key) if connection.dialect.name == "postgresql" else many, rows)
