"""The command line. One file per verb; imports happen when a verb runs, so that help stays fast.

Exit codes: 0 done; 1 FAIL, of `verify` alone; 2 an error that the caller can correct, in one message; 3 done, but the
answer is no: the part is not in the picture; 70 a bug of ours, with a traceback; 130 interrupted; 141 nobody read the
results. Results go to stdout, messages and progress to stderr.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from cadcam import __version__
from cadcam.cli.arguments import Help, Parser
from cadcam.cli.verbs import (
    board,
    calibrate,
    compare,
    convert,
    dataset,
    decompose,
    demo,
    doctor,
    handeye,
    inspect,
    layout,
    lens,
    locate,
    match,
    measure,
    overlay,
    pick,
    render,
    rig,
    sensor,
    state,
    station,
    targets,
    track,
    variability,
    verify,
)
from cadcam.cli.wording import worded
from cadcam.errors import CadcamError, UnwritableFile

VERBS = (
    pick,
    calibrate,
    board,
    targets,
    rig,
    variability,
    handeye,
    measure,
    overlay,
    match,
    locate,
    track,
    verify,
    inspect,
    render,
    sensor,
    lens,
    layout,
    decompose,
    convert,
    compare,
    dataset,
    station,
    state,
    demo,
    doctor,
)

_DESCRIPTION = """\
The virtual camera: calibrate cameras from points or boards, alone, mounted together or on a robot; measure with them;
render CAD as they see it; lay its wireframe over the photo. Every estimate comes with its uncertainty."""
_EPILOG = """\
the usual way:
  cadcam pick photo.png part.step -o pick.html
  cadcam calibrate points.csv --photo photo.png -o camera.json
  cadcam overlay photo.png part.step --camera camera.json -o overlay.png

conventions: lengths in mm; pixels (x, y) = (column, row) with (0, 0) the centre of the top-left pixel;
camera axes x right, y down, z forward. Help on a verb: cadcam VERB --help
"""


_WRITTEN = ("output", "csv", "plot", "diagram", "pose_out", "poses_out")  # arguments that name files to be written anew
_RESULTS = (*_WRITTEN, "log", "store")  # ... and those that a run may continue from
_TAKEN_UP = {"pose_out": ("start",)}  # what may be written over: where the part was found is where to look next
_UNREAD = 141  # as shells say of any program whose pipe was closed; 0 would say PASS, or found, of what may be neither
_BUG = 70  # EX_SOFTWARE of sysexits.h: a production line must not take a crash for a failed part


def parser(asked: str = "") -> argparse.ArgumentParser:
    """Return the parser of all verbs; of the one asked for alone, if it is one: all together take ten times as long."""
    top = Parser(prog="cadcam", description=_DESCRIPTION, epilog=_EPILOG, formatter_class=Help)
    top.add_argument("--version", action="version", version=f"cadcam {__version__}")
    verbs = top.add_subparsers(dest="verb", metavar="VERB [options]", required=True, title="verbs")
    for verb in [verb for verb in VERBS if verb.__name__.rpartition(".")[2] == asked] or VERBS:
        verb.add_to(verbs)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    _open_streams()
    words = sys.argv[1:] if argv is None else argv
    arguments, unknown = parser(*words[:1]).parse_known_args(words)
    if unknown:  # the help of this verb is the relevant one
        arguments.parser.unrecognized(unknown)
    try:
        _refuse_own_input(arguments)
        code: int = arguments.run(arguments) or 0
        sys.stdout.flush()
    except CadcamError as error:
        print(f"{arguments.parser.prog}: {worded(error, arguments)}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"{arguments.parser.prog}: {_too_much(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        goes_on = "; the same command goes on where it was" if getattr(arguments, "resumes", False) else ""
        print(f"{arguments.parser.prog}: interrupted{goes_on}", file=sys.stderr)
        return 130
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            return _bug(arguments.parser.prog)
        # only stdout can raise these here: files are read and written with errors of our own
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno == errno.EPIPE:  # the reader of a pipe has closed it: cadcam ... | head
            return _UNREAD
        print(f"{arguments.parser.prog}: stdout cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    except Exception:
        return _bug(arguments.parser.prog)
    return code


def _refuse_own_input(arguments: argparse.Namespace) -> None:
    """Refuse an output that is one of the input files: it would be overwritten."""
    given = vars(arguments)
    for written in _WRITTEN:
        unread = (*_RESULTS, *_TAKEN_UP.get(written, ()))
        read = [path for dest, value in given.items() if dest not in unread for path in _files(value)]
        for out in _texts(given.get(written)):
            if any(_same_file(out, path) for path in read):
                raise UnwritableFile(out, "is an input of this command, which would be lost", "give another name")


def _texts(value: object) -> list[str]:
    listed = value if isinstance(value, (list, tuple)) else [value]
    return [text for text in listed if isinstance(text, str)]


def _files(value: object) -> list[str]:
    """Return the possible file names in an argument: FILE, VIEW=FILE, VIEW=OF:FILE."""
    return [file for text in _texts(value) for file in (text, text.partition("=")[2], text.rpartition(":")[2]) if file]


def _same_file(one: str, other: str) -> bool:
    try:
        return Path(one).is_file() and Path(one).samefile(other)
    except (OSError, ValueError):
        return False


def _open_streams() -> None:
    """Redirect stdout and stderr to nowhere where closed, as in some services: else files get their numbers.

    What stdout has no characters for, as umlauts in ASCII, is spelled out as on stderr: it is no reason to stop.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  open to the end
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _too_much(error: MemoryError) -> str:
    reason = f" ({error})" if str(error) else ""
    return f"there is not enough memory for what was asked{reason}; ask for less, or for fewer things at a time"


def _bug(prog: str) -> int:
    traceback.print_exc()
    print(
        f"{prog}: this is a bug in cadcam {__version__}; please report it with the lines above",
        file=sys.stderr,
    )
    return _BUG
