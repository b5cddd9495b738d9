"""Which store of measured parts is meant, for verbs that read or fill one."""

from __future__ import annotations

import argparse
import os

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
