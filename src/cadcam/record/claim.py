"""One program at a time at something with a store, by locks of the system: they end with it, however it ends."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import sqlalchemy as sql
from sqlalchemy import exc

from cadcam.whole import utf8

# What a connection raises that breaks or was closed for that; pg8000 lets some errors of sockets through as they are.
_BROKEN = (exc.DBAPIError, exc.ResourceClosedError, OSError)
_NAME_BYTES = 63  # of what PostgreSQL keeps of the name of a program
_HOLDER = """\
SELECT application_name FROM pg_locks JOIN pg_stat_activity USING (pid)
WHERE locktype = 'advisory' AND granted AND objsubid = 1 AND classid::bigint << 32 | objid::bigint = :key"""


class Claimed(Exception):
    """Another program is at it: `who` it is, as it said; "" where that is not known."""

    def __init__(self, who: str) -> None:
        super().__init__(who)
        self.who: str = who


@contextmanager
def claimed_by_file(store: str, what: str, who: str) -> Iterator[None]:
    """Hold a lock on a file beside an SQLite store while it lasts; raise `Claimed` where another program does.

    The file that a killed program leaves behind holds nobody up. Where the system has no locks, as some network drives,
    nobody is kept away.
    """
    path = Path(f"{Path(store).resolve()}.{hashlib.sha256(utf8(what)).hexdigest()[:12]}.lock")
    file = _locked(path)
    if file is None:
        yield
        return
    try:
        with suppress(OSError):  # of another user's file only the lock is ours
            os.ftruncate(file, 0)
            os.write(file, utf8(who))
        yield
    finally:
        with suppress(OSError):
            path.unlink()  # while it is locked: who opened it meanwhile finds that it is gone
        os.close(file)


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except PermissionError:  # another user's: to lock it, it need not be written to
        return os.open(path, os.O_RDONLY)


def _locked(path: Path) -> int | None:
    """Return the open file, locked; None where there are no locks."""
    try:
        import fcntl
    except ImportError:
        return None
    while True:
        try:
            file = _opened(path)
        except OSError:  # where nobody may write, there is nothing to keep anybody away from
            return None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file), path.stat()):
                return file
        except BlockingIOError:
            who = os.read(file, 1000).decode(errors="replace")
            os.close(file)
            raise Claimed(who) from None
        except FileNotFoundError:  # who held it has just ended, and taken it away: once more
            pass
        except OSError:
            os.close(file)
            return None
        os.close(file)


@contextmanager
def claimed_in_database(engine: sql.Engine, what: str, who: str) -> Iterator[Callable[[], None]]:
    """Hold a lock of PostgreSQL's while it lasts; raise `Claimed` where another program does.

    It is let go of with its connection: also where this process is killed, or the server is started anew. What is
    yielded takes it again after that, if nobody else has meanwhile; then it raises `Claimed`.
    """
    held = [_lock(engine, what, who)]

    def hold() -> None:
        try:
            held[0].execute(sql.text("SELECT 1"))
        except _BROKEN:
            _close(held[0])
            with suppress(*_BROKEN):  # a server that is away lets nobody else have it either
                held[0] = _lock(engine, what, who)

    try:
        yield hold
    finally:
        _close(held[0])


def _close(connection: sql.Connection) -> None:
    with suppress(*_BROKEN):
        connection.close()


def _lock(engine: sql.Engine, what: str, who: str) -> sql.Connection:
    """Return a connection that has the lock; raise `Claimed` where another one does."""
    key = {"key": int.from_bytes(hashlib.sha256(utf8(what)).digest()[:8], signed=True)}
    name = utf8(who)[:_NAME_BYTES].decode(errors="ignore")
    with ExitStack() as unless_held:
        connection = unless_held.enter_context(engine.connect().execution_options(isolation_level="AUTOCOMMIT"))
        connection.detach()  # at its end it is closed with lock and name; those that the store works with are others
        if not connection.execute(sql.text("SELECT pg_try_advisory_lock(:key)"), key).scalar_one():
            raise Claimed(connection.execute(sql.text(_HOLDER), key).scalar() or "")
        connection.execute(sql.text("SELECT set_config('application_name', :name, false)"), {"name": name})
        unless_held.pop_all()
        return connection
