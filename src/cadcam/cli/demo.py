"""`cadcam overlay`."""

from __future__ import annotations

from cadcam.cli.arguments import Verbs


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
