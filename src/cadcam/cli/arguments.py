"""What the verbs' command lines share."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.observations import Observations

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Run: TypeAlias = Callable[[argparse.Namespace], "int | None"]

_FULL = 90  # characters of a line that its sentence goes on behind: texts are written 120 wide


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one message, as those of the library are: the usage stands in the help.

    Empty texts, as a script's unset variable leaves them, are refused: each would count as an option left out.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.register("type", None, _filled)

    def add_subparsers(self, **kwargs: Any) -> Any:
        """Return the action that verbs are added to; what stands behind a verb is that verb's to judge."""
        verbs = super().add_subparsers(**kwargs)
        verbs.type = str
        return verbs

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the command line and where more is to be read; exit with 2."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


def _filled(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a value, or leave it out")
    return text


class Help(argparse.RawDescriptionHelpFormatter):
    """Help texts as they are written, with room for the options' names; sentences fit narrower terminals too."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=min(shutil.get_terminal_size().columns, 120) - 2)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Return the text, its sentences broken anew where they are too long; tables and examples stay as they are."""
        if max(map(len, text.splitlines()), default=0) <= width + 2:
            return text
        lines: list[str] = []
        goes_on = False
        for line in text.splitlines():
            if goes_on and _is_sentence(line):
                lines[-1] += f" {line}"
            else:
                lines.append(line)
            goes_on = _is_sentence(line) and len(line) > _FULL
        wrap = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
        return "\n".join(wrap.fill(line) if _is_sentence(line) else line for line in lines)


def _is_sentence(line: str) -> bool:
    """Return whether a line of help is neither empty nor part of an example or a table."""
    return bool(line) and not line[0].isspace() and "  " not in line


def verb(verbs: Verbs, name: str, run: Run, *, short: str, description: str, examples: str) -> argparse.ArgumentParser:
    """Return a new verb's parser: `short` stands in the list of verbs, `examples` below its own help.

    run: does the work and returns the exit code, None for 0.
    """
    parser = verbs.add_parser(
        name,
        help=short,
        description=description,
        epilog=f"examples:\n{examples}",
        formatter_class=Help,
    )
    parser.set_defaults(run=run, parser=parser)
    return parser


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON document in place of tables")


def given(arguments: argparse.Namespace, *options: str) -> list[str]:
    """Return those of a verb's options, such as "--view", that were given: that are not what they are by default."""
    usual = arguments.parser.get_default
    names = ((option, option.lstrip("-").replace("-", "_")) for option in options)
    return [option for option, name in names if getattr(arguments, name) != usual(name)]


def refuse(arguments: argparse.Namespace, *options: str, why: str, expected: str) -> None:
    """Refuse the first of the options that was given though it would change nothing: `BadValue`, with the way out.

    Whoever gives an option means it: results that quietly leave it out are wrong results.
    """
    for option in given(arguments, *options):
        raise BadValue(option, f"given {why}", expected)


POINTS_OPTIONS = ("--points-unit", "--columns", "--header", "--sigma")


def add_points_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a points file is to be read."""
    group = parser.add_argument_group("points file")
    group.add_argument(
        "--points-unit", metavar="U", help="unit of X Y Z where the header names none: mm (default), m ..."
    )
    group.add_argument("--columns", type=names, metavar="A,B", help="the two image columns, where there are several")
    group.add_argument("--header", type=names, metavar="A,B,...", help="column names of a file without a header line")
    group.add_argument("--sigma", type=float, metavar="PX", help="noise of one pixel coordinate, if it is known")


def read_points_as_asked(arguments: argparse.Namespace, path: str) -> Observations:
    """Return the observations in a points file, read by the options of `add_points_options`."""
    from cadcam.files.points import read_points

    return read_points(
        path,
        unit=arguments.points_unit,
        columns=arguments.columns,
        header=arguments.header,
        sigma_px=arguments.sigma,
    )


def check_in_picture(observations: Observations, size: tuple[int, int]) -> None:
    """Refuse points seen well outside a picture of `size`, as they are where its sides or their columns are swapped.

    A twentieth of the longer side is let pass: the centre of a mark that the border cuts off may lie outside.
    """
    import numpy as np

    q, half = observations.q, np.array(size) / 2
    far = np.flatnonzero((np.abs(q + 0.5 - half) - half).max(axis=1) > max(size) / 20)
    if far.size:
        x, y = q[far[0]]
        swapped = "" if (q > size[::-1]).any() else "; are width and height, or the columns x and y, swapped?"
        raise BadValue(
            f"{observations.source}: point {observations.names[far[0]]!r}",
            f"at x = {x:.6g}, y = {y:.6g} px",
            f"points in the picture of {size[0]} x {size[1]} px ({far.size} of {len(q)} are outside){swapped}",
        )


def size(text: str) -> tuple[int, int]:
    """Return (width, height) of a text such as 768x576."""
    width, cross, height = text.lower().partition("x")
    if cross and width.strip().isdigit() and height.strip().isdigit() and int(width) and int(height):
        return int(width), int(height)
    raise argparse.ArgumentTypeError(f"{text!r} is not a picture size; give WIDTHxHEIGHT in px, such as 768x576")


def color(text: str) -> tuple[float, float, float]:
    """Return RGB in [0, 1] of a text such as #ff8800 (the # may be left out), white or black."""
    digits = {"white": "ffffff", "black": "000000"}.get(text.lower(), text.removeprefix("#"))
    if len(digits) != 6 or not set(digits.lower()) <= set("0123456789abcdef"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a colour; give red, green and blue as '#rrggbb'")
    red, green, blue = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return red, green, blue


def named_color(text: str) -> tuple[str, tuple[float, float, float]]:
    """Return (name, RGB) of a text such as bolt*=#ff8800."""
    name, equals, value = text.rpartition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=#rrggbb, such as 'bolt*=#ff8800'")
    return name, color(value)


def names(text: str) -> tuple[str, ...]:
    """Return the names in a text separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def number(what: str, text: str) -> float:
    """Return the number in a text; `BadValue` naming `what`."""
    try:
        return float(text)
    except ValueError:
        raise BadValue(what, repr(text), "a number") from None
