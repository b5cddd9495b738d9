"""The address of a store, the connections to it, and what its errors mean."""

from __future__ import annotations

import logging
from getpass import getuser
from pathlib import Path
from typing import Any

import sqlalchemy as sql
from sqlalchemy import event, exc

from cadcam.errors import BadValue, UnknownName, UnusableStore

_CHANGED_KIB = 65536  # of pages that a writer holds in memory: once it has to let some go, readers wait for its end
_READ_KIB = 2000  # ... and a reader: SQLite's default
_WAIT_S = 60  # timeout of a writer that waits for others
MENDED = "take the last backup, or save what can be read by SQLite's own program: sqlite3 FILE .recover"
MEMORY = ":memory:"  # SQLite's name of what is no file, and lost with its store
_DRIVERS = {"postgresql": "postgresql+pg8000", "postgres": "postgresql+pg8000"}


def url_of(where: str) -> sql.URL:
    """Return the address of a database; anything without :// is the path of an SQLite file."""
    if "://" not in where:
        return sql.URL.create("sqlite", database=where)
    try:
        url = sql.make_url(where)
    except (exc.ArgumentError, ValueError):
        raise BadValue("address of a store", repr(where), "a file, or postgresql://user@host:port/name") from None
    if url.get_backend_name() not in ("sqlite", "postgresql", "postgres"):
        raise UnknownName("kind of store", url.get_backend_name(), ("sqlite", "postgresql"))
    if url.get_backend_name() == "sqlite" and not url.database:
        raise BadValue("address of a store", repr(where), "a file after it, as in sqlite:///parts.db")
    url = url.set(drivername=_DRIVERS.get(url.drivername, url.drivername))
    if url.drivername == _DRIVERS["postgresql"] and url.username is None:
        return url.set(username=getuser())  # as PostgreSQL's own programs do; pg8000 does not
    return url


def engine_of(url: sql.URL) -> sql.Engine:
    """Return the connections to a database."""
    if url.get_backend_name() != "sqlite":
        logging.getLogger("sqlalchemy.pool").addHandler(logging.NullHandler())  # else it prints what it mends itself
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
    connection.exec_driver_sql(f"PRAGMA cache_size=-{_CHANGED_KIB if writing else _READ_KIB}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")


def check_file(path: str, create: bool) -> None:
    """Raise `UnusableStore` where the file of a store cannot be there, or is not and shall not be created."""
    file = Path(path)
    if file.is_dir():
        raise UnusableStore(path, "is a folder", "name a file in it")
    if not file.exists() and not create:
        raise UnusableStore(path, "no such file", "check the path; `cadcam state add` begins a store")
    if not file.parent.is_dir():
        raise UnusableStore(path, f"there is no folder {str(file.parent)!r}", f"make it first: mkdir -p {file.parent}")


def explained(error: exc.DBAPIError) -> tuple[str, str]:
    """Return reason and remedy of a database error."""
    said = error.orig.args[0] if error.orig is not None and error.orig.args else error
    text = str(said.get("M", said) if isinstance(said, dict) else said).strip()
    reason = text.splitlines()[0] if text else type(error.orig or error).__name__
    if "not a database" in reason:
        return "is not an SQLite file", "name a new file, or the right one"
    if "locked" in reason:
        return f"other programs kept it busy for {_WAIT_S} s", "try again"
    if "readonly" in reason or "unable to open" in reason:
        return f"cannot be used ({reason})", "choose a place you may write to"
    if "malformed" in reason or "Could not decode" in reason:
        return f"is damaged ({reason[:60]})", MENDED
    if "is full" in reason:
        return reason, "free some space, then run it again: what was not said to be added is not"
    return reason, "is the address right, and the server running?" if "connect" in reason.lower() else ""
