"""Which store of measured parts is meant, for verbs that read or fill one."""

from __future__ import annotations

import argparse
import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cadcam.cli.arrivals import Source
    from cadcam.record.store import Store

DEFAULT_STORE = "parts.sqlite"
STORE_HELP = """\
the store: --store FILE|URL, else $CADCAM_STORE, else parts.sqlite in this folder. A file is SQLite and needs nothing
else; PostgreSQL needs cadcam[postgresql]. Give a password in $CADCAM_STORE rather than on the command line.
"""


def add_store_option(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add --store."""
    parser.add_argument(
        "--store", metavar="FILE|URL", help=f"SQLite file, or postgresql://... (default $CADCAM_STORE, {DEFAULT_STORE})"
    )


def store_address(arguments: argparse.Namespace) -> str:
    """Return the file or URL of the store."""
    return arguments.store or os.environ.get("CADCAM_STORE", "").strip() or DEFAULT_STORE


@contextmanager
def judging_alone(store: Store, part: str, sources: Iterable[Source]) -> Iterator[None]:
    """Be the one on this computer that judges parts of a kind by the photos from these sources, or say who is."""
    where = ", ".join(str(replace(source, folder=source.folder.resolve())) for source in sources)
    what = f"`cadcam inspect` of {part} in {where} on {socket.gethostname()}"
    with store.claimed(what, f"process {os.getpid()}, since {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"):
        yield
