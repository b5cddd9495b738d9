"""One program at a time at something with a store; one that was killed holds nobody up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from cadcam.errors import UnusableStore
from cadcam.record.store import open_store

_HOLDER = """
import sys, time
from cadcam.record.store import open_store
with open_store(sys.argv[1]) as store, store.claimed("judging in/", "process 7 on cell"):
    print("claimed", flush=True)
    time.sleep(600)
"""

pytestmark = pytest.mark.skipif(os.name != "posix", reason="elsewhere nobody is kept away from a store in a file")


def test_the_second_is_told_who_the_first_is_until_that_is_killed(where: str) -> None:
    with open_store(where) as store:
        holder = subprocess.Popen([sys.executable, "-c", _HOLDER, where], stdout=subprocess.PIPE, text=True)
        try:
            assert holder.stdout is not None
            assert holder.stdout.readline() == "claimed\n"
            with (
                pytest.raises(UnusableStore, match="judging in/ is at work already: process 7 on cell; let that one"),
                store.claimed("judging in/", "process 8"),
            ):
                pytest.fail("it was let in")
            with store.claimed("judging other/", "process 8"):
                assert store.count() == 0  # the others of this program's connections do as ever
        finally:
            holder.send_signal(signal.SIGKILL)
            holder.wait()
            holder.communicate()
        for left in reversed(range(100)):  # PostgreSQL notices a little later that the other end is gone
            with suppress(*[UnusableStore] * (left > 0)), store.claimed("judging in/", "process 9"):
                break
            time.sleep(0.1)


_FORGOTTEN = """
import sys
import sqlalchemy as sql
from sqlalchemy import exc
from cadcam.errors import UnusableStore
from cadcam.record import claim
from cadcam.record.store import open_store

other = sql.create_engine(sys.argv[1].replace("postgresql:", "postgresql+pg8000:"))

def forget():
    with other.connect() as connection:
        connection.exec_driver_sql("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")

def away(*_):
    raise exc.OperationalError("connect", None, Exception("refused"))

with open_store(sys.argv[1]) as store:
    with store.claimed("judging in/", "process 7") as hold:
        forget()
        lock, claim._lock = claim._lock, away
        hold()
        hold()
        claim._lock = lock
        hold()
        try:
            with store.claimed("judging in/", "process 8"):
                print("let in")
        except UnusableStore as error:
            print(error)
    try:
        with store.claimed("judging in/", "process 7") as hold:
            forget()
            with store.claimed("judging in/", "process 8"):
                hold()
    except UnusableStore as error:
        print(error)
"""


def test_a_claim_that_the_server_forgot_is_taken_again(where: str) -> None:
    """As by one that is started anew, away for two looks; where another program has it by then, it is told so.

    In a process of its own: pg8000 leaves the sockets of connections that broke to the collector, which warns of them.
    """
    if "postgresql" not in where:
        pytest.skip("a file's lock ends with its program alone")
    ran = subprocess.run([sys.executable, "-c", _FORGOTTEN, where], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    held, taken = ran.stdout.splitlines()
    assert "judging in/ is at work already: process 7" in held
    assert "judging in/ is at work already: process 8" in taken


def test_as_much_as_one_likes_can_be_claimed_at_once(where: str) -> None:
    """More than a database's connections that are kept for other work."""
    with open_store(where) as store, ExitStack() as claims:
        for number in range(20):
            claims.enter_context(store.claimed(f"judging {number}/", "process 7"))
        assert store.count() == 0


def test_what_was_claimed_and_let_go_leaves_nothing(tmp_path: Path) -> None:
    where = tmp_path / "parts.sqlite"
    with open_store(where) as store:
        for _ in range(2):
            with store.claimed("judging in/", "process 7"):
                assert len(list(tmp_path.iterdir())) == 2
            assert list(tmp_path.iterdir()) == [where]


@pytest.mark.skipif(os.name == "posix" and os.getuid() != 0, reason="only root can be another user")
def test_another_user_is_kept_away_too() -> None:
    """Its lock file is not ours to write to: to lock it, it need not be."""
    with TemporaryDirectory() as folder, open_store(Path(folder) / "parts.sqlite") as store:
        Path(folder).chmod(0o755)
        with store.claimed("judging in/", "process 7"):
            child = os.fork()
            if not child:
                os.setuid(65534)
                with suppress(UnusableStore), store.claimed("judging in/", "process 8"):
                    os._exit(1)
                os._exit(0)
            assert os.waitpid(child, 0)[1] == 0
