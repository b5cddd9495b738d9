"""A table of text, shown with colour and rules on a terminal and as aligned plain text everywhere else."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from rich.console import Console

_STEERING = {*range(0x20), *range(0x7F, 0xA0), *range(0x2028, 0x202F), *range(0x2066, 0x206A)}
_SPELLED = {code: ascii(chr(code))[1:-1] for code in _STEERING}


def spelled(text: str) -> str:
    r"""Return a text in one line, what steers a terminal in it spelled out: line ends, colours, changes of direction.

    A name may hold them: of a file, a part, or in the JSON of another program.
    """
    return text if text.isprintable() else text.translate(_SPELLED)


@dataclass(frozen=True, slots=True)
class Table:
    """A title, column heads and rows of text; columns named in `left` are aligned to the left, all others right."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", spelled(self.title))
        object.__setattr__(self, "rows", tuple(tuple(map(spelled, row)) for row in self.rows))

    @property
    def headed(self) -> bool:
        """Whether the columns have heads that are worth a line."""
        return bool(self.rows) and any(self.columns)

    def lines(self) -> list[str]:
        """Return the table as aligned plain text."""
        headed = self.headed
        rows = [self.columns, *self.rows] if headed else list(self.rows)
        widths = [max((len(row[i]) for row in rows), default=0) for i in range(len(self.columns))]
        body = ["  " + "  ".join(self._cell(i, row[i], widths[i]) for i in range(len(widths))).rstrip() for row in rows]
        if headed:
            rule = ("-" * w if head else " " * w for head, w in zip(self.columns, widths, strict=True))
            body.insert(1, ("  " + "  ".join(rule)).rstrip())
        return [self.title, *body, *(f"  {note}" for note in self.notes)]

    def narrow(self, width: int) -> Table | None:
        """Return the table without its last column, each of whose texts follows its row; None if it fits a width.

        None, too, where the last column holds no sentences: its cells are no longer than the others'.
        """
        longest = [max(len(row[i]) for row in (self.columns, *self.rows)) for i in range(len(self.columns))]
        sentences = self.columns[-1] in self.left and longest[-1] > max(longest[:-1], default=0)
        if not self.rows or not sentences or sum(longest) + 3 * len(longest) <= width:
            return None
        return Table(self.title, self.columns[:-1], tuple(row[:-1] for row in self.rows), self.left)

    def _cell(self, column: int, text: str, width: int) -> str:
        return text.ljust(width) if self.columns[column] in self.left else text.rjust(width)


def show(tables: Iterable[Table], file: TextIO) -> None:
    """Print the tables to a file: with rich where it is a terminal, else as plain text."""
    if file.isatty():
        _show_rich(tables, file)
        return
    for table in tables:
        print(*table.lines(), sep="\n", end="\n\n", file=file)


def _show_rich(tables: Iterable[Table], file: TextIO) -> None:
    from rich.console import Console
    from rich.markup import escape

    console = Console(file=file, highlight=False)
    for table in tables:
        console.print(f"[bold]{escape(table.title)}[/bold]")
        if (narrow := table.narrow(console.width)) is not None:
            _show_followed(narrow, [row[-1] for row in table.rows], console)
        elif table.rows:
            _show_grid(table, console)
        for note in table.notes:
            console.print(f"  {escape(note)}")
        console.print()


def _show_grid(table: Table, console: Console) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table as RichTable

    rich = RichTable(box=box.SIMPLE_HEAD, show_header=table.headed, pad_edge=False)
    for column in table.columns:
        rich.add_column(escape(column), justify="left" if column in table.left else "right", overflow="fold")
    for row in table.rows:
        rich.add_row(*(escape(cell) for cell in row))
    console.print(rich)


def _show_followed(table: Table, texts: Sequence[str], console: Console) -> None:
    """Print rows, each with a text of its own below it: in columns beside each other, words would be cut."""
    from rich.padding import Padding
    from rich.text import Text

    _, *lines = table.lines()
    head = 2 if table.headed else 0
    for line in lines[:head]:
        console.print(Text(line), soft_wrap=True)
    for line, text in zip(lines[head:], texts, strict=True):
        console.print(Text(line), soft_wrap=True)
        if text:
            console.print(Padding(Text(text, "dim"), (0, 0, 0, 6)))


def plain(value: float, digits: int = 6) -> str:
    """Return a number with about `digits` significant digits, without an exponent where that stays readable."""
    if not np.isfinite(value):
        return str(value)
    if value == 0:
        return "0"
    size = int(np.floor(np.log10(abs(value))))
    if -5 <= size < 15:
        return f"{value:.{max(0, digits - 1 - size)}f}"
    return f"{value:.{digits - 1}e}"


def counted(number: int, what: str) -> str:
    """Return a count in words: 1 record, 2 records."""
    return f"{number} {what}{'s' * (number != 1)}"


def with_sigma(value: float, sigma: float) -> tuple[str, str]:
    """Return value and standard deviation to two digits of the latter; a value with sigma 0 as it was given."""
    if sigma == 0:
        return f"{value:.10g}", ""
    if not np.isfinite(sigma):
        return plain(value), "unknown"
    size = int(np.floor(np.log10(sigma)))
    decimals = max(0, 1 - size)
    if decimals > 12:
        return f"{value:.12g}", f"{sigma:.1e}"
    return f"{value:.{decimals}f}", f"{sigma:.{decimals}f}"


def matrix_rows(matrix: npt.ArrayLike) -> tuple[tuple[str, ...], ...]:
    """Return the cells of a matrix."""
    return tuple(tuple(plain(float(v)) if abs(v) > 1e-12 else "0" for v in row) for row in np.asarray(matrix))
