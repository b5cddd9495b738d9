"""A PostgreSQL server of the tests' own, where the machine has the programs; stopped when the tests end."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

NOBODY = "nobody"  # PostgreSQL refuses to run as root


@contextmanager
def postgres_server() -> Iterator[str]:
    """Yield the URL of a new server's database; skip with the reason where there can be none."""
    programs = {name: _program(name) for name in ("initdb", "pg_ctl")}
    with tempfile.TemporaryDirectory(prefix="cadcam_pg_") as folder:  # not pytest's: those only their owner may enter
        data, log = Path(folder) / "data", Path(folder) / "log"
        as_user = _as_user(Path(folder))
        _run([*as_user, programs["initdb"], "-D", str(data), "-A", "trust", "-U", "tester", "-E", "UTF8", "--no-sync"])
        port = _free_port()
        options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder}"
        control = [*as_user, programs["pg_ctl"], "-D", str(data), "-w", "-l", str(log)]
        _run([*control, "-o", options, "start"])
        try:
            yield f"postgresql://tester@127.0.0.1:{port}/postgres"
        finally:
            _run([*control, "-m", "immediate", "stop"])


def _program(name: str) -> str:
    versions = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    found = shutil.which(name) or (str(versions[-1]) if versions else None)
    if found is None:
        pytest.skip(f"PostgreSQL's {name} is not on this machine")
    return found


def _as_user(folder: Path) -> list[str]:
    """Return what runs a command as a user who owns the folder and is not root."""
    if os.geteuid() != 0:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("PostgreSQL refuses to run as root, and there is no setpriv to become another user")
    user = pwd.getpwnam(NOBODY)
    os.chown(folder, user.pw_uid, user.pw_gid)
    return ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"]


def _free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def _run(command: list[str]) -> None:
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/")
    if ran.returncode:
        pytest.skip(f"PostgreSQL does not start here: {(ran.stderr or ran.stdout).strip()[-300:]}")
