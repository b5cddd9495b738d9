"""`cadcam doctor`: the capabilities of this machine, what "auto" chose and why, what to install for more."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from cadcam.cli.arguments import Verbs, add_json, verb
from cadcam.cli.output import print_json, print_tables

_EXAMPLES = """\
  cadcam doctor           a table; send it along when something does not work
  cadcam doctor --json    the same for programs
"""
_DESCRIPTION = """\
Say what this installation can do on this machine: Python, CPU, the compiled core of the raster renderer and its
instruction set, optional packages, and which renderer "auto" is. What is missing is named with what to do about it.
The exit code is always 0: a missing feature is a result, too."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "what works on this machine, and what to install for more"
    add_json(verb(verbs, "doctor", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES))


def run(arguments: argparse.Namespace) -> None:
    """Examine, report."""
    from cadcam import __version__
    from cadcam.report.doctor import doctor_table, examine

    findings = examine()
    if arguments.json:
        print_json({"cadcam": __version__, "findings": [asdict(finding) for finding in findings]})
    else:
        print_tables([doctor_table(findings)])
