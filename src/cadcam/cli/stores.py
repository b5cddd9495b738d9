"""Which store of measured parts is meant, for verbs that read or fill one."""

from __future__ import annotations

import argparse
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
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
def judging_alone(store: Store, part: str, sources: Iterable[Source]) -> Iterator[Callable[[], None]]:
    """Be the one on this computer that judges parts of a kind by the photos in these folders, or say who is.

    Each folder is claimed as a whole: one that is named and patterns in it may stand for the same photos. What is
    yielded, called now and then, holds the claims where the store's server has been started anew.
    """
    who = f"process {os.getpid()}, since {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    folders = {str(source.folder.resolve()) for source in sources}
    held: list[Callable[[], None]] = []

    def hold() -> None:
        for each in held:
            each()

    with ExitStack() as claims:
        for folder in sorted(folders):  # in one order: of two that begin at once, one goes on
            what = f"`cadcam inspect` of {part} in {folder} on {socket.gethostname()}"
            held.append(claims.enter_context(store.claimed(what, who)))
        yield hold
