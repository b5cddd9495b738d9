"""The parts of the command line that all verbs share."""

from __future__ import annotations

import argparse
import math
import re
import shutil
import textwrap
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from cadcam.camera.observations import Observations

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Run: TypeAlias = Callable[[argparse.Namespace], "int | None"]

NO = 3  # exit code: done, but the answer is no

_FULL = 90  # characters of a line whose sentence continues on the next: texts are written 120 wide

# No sensible length, angle, share or noise lies beyond these; their squares would overflow, or divide by zero.
_SMALLEST, _LARGEST, _MOST = 1e-12, 1e10, 10**9  # of numbers; of whole ones
_LONGEST_SIDE_PX = 1_000_000


class Parser(argparse.ArgumentParser):
    """A parser with one-message errors, like those of the library: the usage is in the help.

    Options are spelled out: a script with half a name would break as soon as another option begins alike. Empty texts,
    as from a script's unset variable, are refused: each would count as an option left out. What begins as a negative
    number is a value everywhere: -1e9 and -1,0,0,5 as well as -1, as from Python 3.14 on.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})
        self.register("type", None, _filled)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def add_subparsers(self, **kwargs: Any) -> Any:
        """Return the action that verbs are added to; arguments after a verb are left to the verb's parser."""
        verbs = super().add_subparsers(**kwargs)
        verbs.type = str
        return verbs

    def destination(self, option: str) -> str:
        """Return the name under which the value of an option is stored."""
        return self._option_string_actions[option].dest

    def has(self, option: str) -> bool:
        """Return whether there is an option of this name."""
        return option in self._option_string_actions

    def error(self, message: str) -> NoReturn:
        """Report the error in the command line and where to read more; exit with 2."""
        for action in self._actions:  # which jobs there are is what was not known
            if isinstance(action, argparse._SubParsersAction):
                message = message.replace(str(action.metavar), f"one of {', '.join(action.choices)}")
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")

    def unrecognized(self, arguments: Sequence[str]) -> NoReturn:
        """Refuse unknown arguments; for an option, name the nearest known one."""
        near = get_close_matches(arguments[0].partition("=")[0], self._option_string_actions, n=1)
        hint = f"; did you mean {near[0]}?" if near and near[0].startswith("--") else ""
        self.error(f"unrecognized arguments: {' '.join(arguments)}{hint}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is not among an action's choices, in the form of the library's own errors."""
        if action.choices is not None and value not in action.choices:
            what = "/".join(action.option_strings) or str(action.metavar or action.dest).split()[0].lower()
            raise argparse.ArgumentError(None, str(UnknownName(what, str(value), map(str, action.choices))))


def _filled(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a value, or leave it out")
    return text


class Help(argparse.RawDescriptionHelpFormatter):
    """Help texts as written, with room for the options' names; sentences fit narrower terminals too."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=min(shutil.get_terminal_size().columns, 120) - 2)

    def _split_lines(self, text: str, width: int) -> list[str]:
        """Return the lines of an option's help; dot-ring:4cm is one word."""
        wrap = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
        return wrap.wrap(" ".join(text.split()))

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Return the text with its long sentences wrapped; tables and examples unchanged."""
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


def verb(
    verbs: Verbs, name: str, run: Run | None, *, short: str, description: str, examples: str
) -> argparse.ArgumentParser:
    """Return a new verb's parser: `short` is for the list of verbs, `examples` for its own help.

    run: does the work and returns the exit code, None for 0; without `run` a verb has jobs (`add_jobs`) with their own.
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


def job(jobs: Verbs, name: str, run: Run, *, short: str, examples: str = "") -> argparse.ArgumentParser:
    """Return the parser of one of the jobs of a verb; it behaves like a verb's parser.

    Without examples of its own its help says where those of the verb are, and what its files look like.
    """
    parser = jobs.add_parser(name, help=short, description=short, formatter_class=Help)
    of_verb = f"examples, and what else there is to know: {parser.prog.rpartition(' ')[0]} --help"
    parser.epilog = f"examples:\n{examples}" if examples else of_verb
    parser.set_defaults(run=run, parser=parser)
    return parser


def add_jobs(parser: argparse.ArgumentParser) -> Verbs:
    """Return the action that the jobs of a verb are added to."""
    jobs: Verbs = parser.add_subparsers(dest="job", metavar="JOB [options]", required=True, title="jobs")
    return jobs


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of tables")


def given(arguments: argparse.Namespace, *options: str) -> list[str]:
    """Return which of a verb's options, such as "--view", were given: those that differ from their defaults."""
    parser: Parser = arguments.parser
    names = ((option, parser.destination(option)) for option in options)
    return [option for option, name in names if getattr(arguments, name) != parser.get_default(name)]


def refuse(arguments: argparse.Namespace, *options: str, why: str, expected: str) -> None:
    """Refuse the first given option that would have no effect: `BadValue`, with the way out.

    An option is given for a purpose: results that silently ignore it are wrong.
    """
    for option in given(arguments, *options):
        raise BadValue(option, f"given {why}", expected)


POINTS_OPTIONS = ("--points-unit", "--columns", "--header", "--sigma")


def add_points_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for reading a points file."""
    group = parser.add_argument_group("points file")
    group.add_argument(
        "--points-unit", metavar="U", help="unit of X Y Z where the header names none: mm (default), m ..."
    )
    group.add_argument("--columns", type=names, metavar="A,B", help="the two image columns, where there are several")
    group.add_argument("--header", type=names, metavar="A,B,...", help="column names of a file without a header line")
    group.add_argument("--sigma", type=real, metavar="PX", help="noise of one pixel coordinate, if it is known")


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
    """Refuse points well outside a picture of `size`, as when its sides or their columns are swapped.

    A twentieth of the longer side is tolerated: the centre of a mark cut off by the border may lie outside.
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
    sides = [part.strip() for part in text.lower().split("x")]
    if len(sides) == 2 and all(side.isdecimal() and 1 <= int(side) <= _LONGEST_SIDE_PX for side in sides):
        return int(sides[0]), int(sides[1])
    raise argparse.ArgumentTypeError(
        f"{text!r} is not a picture size; give WIDTHxHEIGHT in px, such as 768x576, up to {_LONGEST_SIDE_PX} a side"
    )


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


def pair(text: str) -> tuple[str, str]:
    """Return the two names in a text such as A,B."""
    given = names(text)
    if len(given) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not two names with a comma between, such as A,B")
    return given[0], given[1]


def real(text: str) -> float:
    """Return the number in a text: 0, or between 1e-12 and 1e10 in size."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{_remedy(text)}") from None
    if value != 0 and not _SMALLEST <= abs(value) <= _LARGEST:
        raise argparse.ArgumentTypeError(
            f"{text!r} is out of range; give 0, or a number between 1e-12 and 1e10 in size"
        )
    return value


def _remedy(text: str) -> str:
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        return "; write a decimal point, not a comma"
    return "; give it alone, in the unit that the help names" if re.match(r"[+-]?\.?\d", text) else ""


def reals(text: str) -> tuple[float, ...]:
    """Return the numbers in a text, separated by commas."""
    return tuple(real(value.strip()) for value in text.split(","))


def span(text: str) -> tuple[float, float]:
    """Return (least, greatest) of a text such as 0.4,0.9, or of one number for both."""
    values = reals(text)
    if len(values) not in (1, 2):
        raise argparse.ArgumentTypeError(f"{text!r} is not a range; give two numbers with a comma between, or one")
    return values[0], values[-1]


def share(text: str) -> float:
    """Return the share in a text: a number between 0 and 1, neither of them."""
    value = _float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share between 0 and 1, such as 0.01 for 1 %")
    return value


def opacity(text: str) -> float:
    """Return the opacity in a text: a number from 0 to 1."""
    value = _float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not an opacity from 0 (nothing) to 1 (opaque)")
    return value


def _float(text: str) -> float:
    """Return the number in a text; nan, which no range holds, where it is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def whole(text: str) -> int:
    """Return the whole number in a text, up to 1e9 in size."""
    return _whole(text, -_MOST, _MOST)


def seed(text: str) -> int:
    """Return the random seed in a text: a whole number from 0 to 2^63 - 1."""
    return _whole(text, 0, 2**63 - 1)


def _whole(text: str, least: int, most: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r} is out of range; give a whole number from {least} to {most}")
    return value


def number(what: str, text: str, *, form: str = "") -> float:
    """Return the number in a part of an option's text, as `real`; `BadValue` naming `what`, and the form if given."""
    try:
        return real(text)
    except argparse.ArgumentTypeError:
        expected = form or "a number: 0, or between 1e-12 and 1e9 in size"
        raise BadValue(what, repr(text), expected) from None


def numbers(what: str, text: str, count: int | None = None, *, form: str = "") -> list[float]:
    """Return the numbers in an option's text, separated by commas; `BadValue` naming `what` unless they are `count`.

    form: the right form, such as "X,Y in mm".
    """
    values = [number(what, part.strip()) for part in text.split(",")]
    if count is not None and len(values) != count:
        raise BadValue(what, repr(text), form or f"{count} numbers with commas between")
    return values
