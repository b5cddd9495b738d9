"""A program that is killed between or within writes loses no record that it was told is kept."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cadcam.record.store import open_store

ROOT = Path(__file__).resolve().parents[2]
WRITER = """
import sys
sys.path.insert(0, {tests!r})
from record.made import record
from cadcam.record.store import open_store
with open_store({where!r}) as store:
    for n in range(10_000):
        store.add(record(n))
        print(n, flush=True)
"""


@pytest.mark.parametrize("kept", [1, 20])
def test_a_kill_loses_no_committed_record(where: str, kept: int) -> None:
    """The writer says a number once `add` returned; killed at once, the store holds all of those, and whole ones."""
    code = WRITER.format(tests=str(ROOT / "tests"), where=where)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for n in range(kept):
            assert writer.stdout.readline() == f"{n}\n"
        os.kill(writer.pid, signal.SIGKILL)
        said = kept + len(writer.stdout.read().splitlines())
    with open_store(where, create=False) as store:
        records = store.query()
        assert [r.serial for r in records[:said]] == [f"S{n:03d}" for n in range(said)]
        assert len(records) <= said + 1  # committed, but killed before it could say so
        assert all(len(r.deviations) == 2 and len(r.sources) == 2 for r in records)
        store.add(records[0].__class__("next"))
        assert len(store.query()) == len(records) + 1
