"""The store of product state: an SQLite file at a station, a PostgreSQL database for a yard; one code for both.

A record is stored as a whole or not at all, and once `add` has returned no crash loses it: SQLite writes its journal
and its folder to the disk first (synchronous=EXTRA), PostgreSQL its log (synchronous_commit, its default). Several
programs may write at once; SQLite serialises them.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from getpass import getuser
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypedDict, Unpack, get_args

import sqlalchemy as sql
from sqlalchemy import event, exc

import cadcam
from cadcam.errors import BadValue, MissingExtra, UnknownName, UnusableStore
from cadcam.kinds import expect, expect_count, expect_each, expect_known, expect_path
from cadcam.record import schema
from cadcam.record.record import VERDICTS, Record, in_utc
from cadcam.record.rows import deviation_rows, measurement_row, record_of, source_rows
from cadcam.whole import plain

_WAIT_S = 60  # timeout of a writer that waits for others
_LOCK = 0x63616463  # PostgreSQL's advisory lock while tables are created
_DRIVERS = {"postgresql": "postgresql+pg8000", "postgres": "postgresql+pg8000"}


Named = Literal["part", "serial", "station"]
NAMED: tuple[Named, ...] = get_args(Named)


class Which(TypedDict, total=False):
    """Which records are meant: those that match all that is given and is not None.

    id_begins: the beginning of their id. verdict: "" means not judged. since, until: times with their zone, both
    included. feature: only those with a deviation of this name.
    """

    id_begins: str | None
    part: str | None
    serial: str | None
    station: str | None
    verdict: str | None
    since: datetime | None
    until: datetime | None
    feature: str | None


def open_store(where: str | os.PathLike[str], *, create: bool = True) -> Store:
    """Return the store in an SQLite file, or in the database of a URL postgresql://user:password@host:port/name.

    PostgreSQL's driver is pg8000 unless the URL names another (postgresql+psycopg://...). A new store is created where
    there is none, unless `create` is False. Raises `UnusableStore` where it cannot be opened, is not a store, or has
    another version's tables, `MissingExtra` without a driver. Use it in a `with` block, or `close` it.
    """
    expect_path(where, "store")
    url = _url(os.fspath(where))
    if url.get_backend_name() == "sqlite":
        _check_file(str(url.database), create)
    name = str(url.database) if url.get_backend_name() == "sqlite" else url.render_as_string(hide_password=True)
    try:
        store = Store(_engine(url), name)
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
        expect_each(records, "records", Record)
        with self._transaction(self._writing) as connection:
            for record in records:
                try:
                    connection.execute(schema.measurement.insert(), measurement_row(record))
                except exc.IntegrityError:
                    raise UnusableStore(self.name, f"holds a record {record.id} already", "nothing was added") from None
                for table, rows in ((schema.deviation, deviation_rows(record)), (schema.source, source_rows(record))):
                    if rows:
                        connection.execute(table.insert(), rows)

    def query(self, *, newest: int | None = None, **which: Unpack[Which]) -> list[Record]:
        """Return the records that match all arguments, oldest first; without arguments all of them.

        which: id_begins, part, serial, station, verdict, since, until, feature; see `Which`. newest: at most this many,
        the latest of them: no others are read.
        """
        if newest is not None:
            expect_count(newest, "newest")
        m = schema.measurement.c
        chosen = sql.select(m.id).where(*_wanted(which)).order_by(m.time_utc.desc(), m.id.desc()).limit(newest)
        return self._records(chosen)

    def count(self, **which: Unpack[Which]) -> int:
        """Return how many records match all arguments, which are those of `query`; none of them is read."""
        counted = sql.select(sql.func.count()).select_from(schema.measurement).where(*_wanted(which))
        with self._transaction(self._engine) as connection:
            return int(connection.execute(counted).scalar_one())

    def values(self, name: Named) -> set[str]:
        """Return the parts, serials or stations that the store holds records of."""
        with self._transaction(self._engine) as connection:
            return set(connection.execute(sql.select(schema.measurement.c[name]).distinct()).scalars())

    def reach(self) -> None:
        """Connect once. Raises `UnusableStore`, also where the driver does not know an option in the address."""
        try:
            with self._transaction(self._engine):
                pass
        except TypeError as error:  # an argument of the driver's own `connect`
            remedy = "leave it out, or name a driver that has it, such as postgresql+psycopg://"
            raise UnusableStore(self.name, f"its driver does not take all of the address ({error})", remedy) from None

    def prepare(self, *, create: bool) -> None:
        """Create the tables where there are none; refuse those of another version."""
        with self._transaction(self._writing if create else self._engine) as connection:
            if connection.dialect.name == "postgresql":  # two programs that create the tables at once
                connection.execute(sql.select(sql.func.pg_advisory_xact_lock(_LOCK)))
            there = set(sql.inspect(connection).get_table_names())
            if schema.store.name in there:
                self._check_version(connection)
            elif there & set(schema.tables.tables):
                taken = ", ".join(sorted(there & set(schema.tables.tables)))
                raise UnusableStore(self.name, f"has tables of other origin ({taken})", "give it a database of its own")
            elif not create:
                raise UnusableStore(self.name, "holds no product state", "is it the right one?")
            else:
                schema.tables.create_all(connection)
                row = {"version": schema.VERSION, "software": f"cadcam {cadcam.__version__}"}
                connection.execute(schema.store.insert(), row)

    def _records(self, chosen: sql.Select[Any]) -> list[Record]:
        """Return the records whose ids are `chosen`."""
        m = schema.measurement
        with self._transaction(self._engine) as connection:
            heads = sql.select(m).where(m.c.id.in_(chosen)).order_by(m.c.time_utc, m.c.id)
            rows = [dict(row) for row in connection.execute(heads).mappings()]
            parts = [_belonging(connection, table, chosen) for table in (schema.deviation, schema.source)]
        return [record_of(row, *(belonging[row["id"]] for belonging in parts)) for row in rows]

    def _check_version(self, connection: sql.Connection) -> None:
        row = connection.execute(sql.select(schema.store)).mappings().one()
        if row["version"] != schema.VERSION:
            raise UnusableStore(
                self.name,
                f"has tables of version {row['version']} (made by {row['software']}); cadcam {cadcam.__version__} "
                f"reads and writes version {schema.VERSION}",
                "export it with the cadcam that made it (cadcam state export all.jsonl), and add that to a new store",
            )

    @contextmanager
    def _transaction(self, engine: sql.Engine) -> Iterator[sql.Connection]:
        """Yield a connection whose work is committed as one transaction; database errors become one clear error."""
        try:
            with engine.begin() as connection:
                yield connection
        except exc.DBAPIError as error:
            raise UnusableStore(self.name, *_explained(error)) from error


def _wanted(which: Which) -> list[sql.ColumnElement[bool]]:
    """Return the conditions that records have to meet."""
    unknown = next((name for name in which if name not in Which.__annotations__), None)
    if unknown is not None:
        raise UnknownName("filter of records", unknown, Which.__annotations__)
    # a name that is no text is asked for as `Record` keeps it
    asked: dict[str, Any] = {name: plain(value) if isinstance(value, str) else value for name, value in which.items()}
    m = schema.measurement.c
    equal = {name: asked.get(name) for name in ("part", "serial", "station", "verdict")}
    if verdict := asked.get("verdict"):
        _check_known(verdict)
    wanted = [m[name] == value for name, value in equal.items() if value is not None]
    if begins := asked.get("id_begins"):
        wanted.append(m.id.startswith(begins, autoescape=True))
    if since := asked.get("since"):
        wanted.append(m.time_utc >= _utc("since", since))
    if until := asked.get("until"):
        wanted.append(m.time_utc <= _utc("until", until))
    if (feature := asked.get("feature")) is not None:
        d = schema.deviation.c
        wanted.append(sql.exists().where(d.measurement_id == m.id, d.feature == feature))
    return wanted


def _belonging(connection: sql.Connection, table: sql.Table, chosen: sql.Select[Any]) -> Mapping[str, list[Any]]:
    """Return the rows of a table by the measurement that they belong to, in order."""
    rows = sql.select(table).where(table.c.measurement_id.in_(chosen)).order_by(table.c.measurement_id, table.c.place)
    out: dict[str, list[Any]] = defaultdict(list)
    for row in connection.execute(rows).mappings():
        out[row["measurement_id"]].append(dict(row))
    return out


def _url(where: str) -> sql.URL:
    """Return the address of a database; anything without :// is the path of an SQLite file."""
    if "://" not in where:
        return sql.URL.create("sqlite", database=where)
    try:
        url = sql.make_url(where)
    except (exc.ArgumentError, ValueError):
        raise BadValue("address of a store", repr(where), "a file, or postgresql://user@host:port/name") from None
    if url.get_backend_name() not in ("sqlite", "postgresql", "postgres"):
        raise UnknownName("kind of store", url.get_backend_name(), ("sqlite", "postgresql"))
    url = url.set(drivername=_DRIVERS.get(url.drivername, url.drivername))
    if url.drivername == _DRIVERS["postgresql"] and url.username is None:
        return url.set(username=getuser())  # as PostgreSQL's own programs do; pg8000 does not
    return url


def _engine(url: sql.URL) -> sql.Engine:
    if url.get_backend_name() != "sqlite":
        return sql.create_engine(url, pool_pre_ping=True)  # a connection dropped by the network is opened again
    engine = sql.create_engine(url, connect_args={"timeout": _WAIT_S})
    event.listen(engine, "connect", _sqlite_connected)
    event.listen(engine, "begin", _sqlite_begins)
    return engine


def _sqlite_connected(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # transactions begin below: the module's own exclude the creation of tables
    for pragma in ("foreign_keys=ON", "synchronous=EXTRA"):
        connection.execute(f"PRAGMA {pragma}")


def _sqlite_begins(connection: sql.Connection) -> None:
    """Take the writers' lock at once: two that read first and then both want to write would deadlock."""
    writing = connection.get_execution_options().get("writing")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")


def _check_file(path: str, create: bool) -> None:
    file = Path(path)
    if file.is_dir():
        raise UnusableStore(path, "is a folder", "name a file in it")
    if not file.exists() and not create:
        raise UnusableStore(path, "no such file", "check the path; `cadcam state add` begins a store")
    if not file.parent.is_dir():
        raise UnusableStore(path, f"there is no folder {str(file.parent)!r}", f"make it first: mkdir -p {file.parent}")


def _explained(error: exc.DBAPIError) -> tuple[str, str]:
    """Return reason and remedy of a database error."""
    said = error.orig.args[0] if error.orig is not None and error.orig.args else error
    reason = str(said.get("M", said) if isinstance(said, dict) else said).splitlines()[0]
    if "not a database" in reason:
        return "is not an SQLite file", "name a new file, or the right one"
    if "locked" in reason:
        return f"other programs kept it busy for {_WAIT_S} s", "try again"
    if "readonly" in reason or "unable to open" in reason:
        return f"cannot be used ({reason})", "choose a place you may write to"
    return reason, "is the address right, and the server running?" if "connect" in reason.lower() else ""


def _utc(what: str, time: datetime) -> datetime:
    expect(time, what, datetime)
    if time.tzinfo is None:
        raise BadValue(what, time.isoformat(), "a time with its zone")
    return in_utc(what, time).replace(tzinfo=None)


def _check_known(verdict: str) -> None:
    expect_known(verdict, "verdict", VERDICTS)
