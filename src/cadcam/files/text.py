"""Text files as bytes, hash and lines of cells; every error names the file, and the line where there is one."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from cadcam.arrays import LARGEST
from cadcam.errors import BadValue, UnreadableFile
from cadcam.kinds import expect_path
from cadcam.whole import utf8

MAX_BYTES = 64_000_000  # a points file of a million lines; anything longer is the wrong file
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_EMPTY = "is empty", "copy it again from its source"
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\uff1d", "\uff0b", "\uff0d", "\uff20")  # the last four are full-width
_DELIMITERS = ("\t", ";", ",")


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text file as it was on disk: path as given, content, hash of its bytes."""

    path: str
    text: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Line:
    """One line that is not empty: its number in the file, counted from 1, and its cells, stripped."""

    number: int
    cells: tuple[str, ...]


def read_text(path: str | os.PathLike[str], *, max_bytes: int = MAX_BYTES) -> TextFile:
    """Return the UTF-8 text of a file; `UnreadableFile` with the reason if it is missing, empty, huge or not text."""
    expect_path(path)
    return text_of(path, read_bytes(path, max_bytes=max_bytes))


def read_bytes(path: str | os.PathLike[str], *, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file; `UnreadableFile` with the reason if it is missing or huge."""
    try:
        size = Path(path).stat().st_size
        if size > max_bytes:
            raise UnreadableFile(path, f"is {size} bytes long, more than {max_bytes}", "is it the right file?")
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: str | os.PathLike[str], error: OSError | ValueError) -> UnreadableFile:
    """Return the error that says why the system gave no bytes of a file."""
    if isinstance(error, FileNotFoundError):
        return UnreadableFile(path, "no such file", "check the path")
    if isinstance(error, IsADirectoryError):
        return UnreadableFile(path, "is a folder", "name a file in it")
    return UnreadableFile(path, getattr(error, "strerror", None) or str(error))


def lines_of_text(path: str | os.PathLike[str]) -> Iterator[tuple[int, str]]:
    """Yield number, from 1, and text of each line of a UTF-8 file of any length, cut at line feeds alone.

    Raises `UnreadableFile` as `read_text` does, and for a line longer than `MAX_BYTES`.
    """
    expect_path(path)
    number, blank = 0, True
    try:
        with Path(path).open("rb") as file:
            if file.peek(2)[:2] in _UTF16:  # as PowerShell writes them; a line feed is two bytes there
                yield from enumerate(read_text(path).text.removesuffix("\n").split("\n"), 1)
                return
            while line := file.readline(MAX_BYTES):
                number += 1
                if len(line) == MAX_BYTES:
                    raise UnreadableFile(
                        path, f"line {number} has more than {MAX_BYTES} bytes", "is it the right file?"
                    )
                blank = blank and not line.strip()
                yield number, line.decode("utf-8-sig" if number == 1 else "utf-8").removesuffix("\n")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} of line {number} is {error.object[error.start]:#04x}"
        raise UnreadableFile(path, f"is not text: {byte}", "give a text file in UTF-8") from None
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if blank:
        raise UnreadableFile(path, *_EMPTY)


def text_of(path: str | os.PathLike[str], data: bytes) -> TextFile:
    """Return the content of a file as UTF-8 text; `UnreadableFile` with the reason if it is empty or not text."""
    try:
        text = data.decode("utf-16" if data[:2] in _UTF16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableFile(
            path, f"is not text: byte {error.start} is {data[error.start]:#04x}", "give a text file in UTF-8"
        ) from None
    if "\0" in text:
        raise UnreadableFile(path, "is not text: it contains zero bytes", "give a text file in UTF-8")
    if not text.strip():
        raise UnreadableFile(path, *_EMPTY)
    return TextFile(os.fspath(path), text, sha256(data).hexdigest())


def lines_of_cells(file: TextFile) -> Iterator[Line]:
    """Yield every line that is not blank or a comment (#), cut into cells.

    The first such line determines the separator: a tab, a semicolon, a comma, else any blanks. Raises
    `UnreadableFile` for JSON.
    """
    delimiter = None
    first = True
    for number, raw in enumerate(file.text.splitlines(), start=1):
        text = raw.strip(" \r\n")
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        if first and text.lstrip()[0] == "{":
            raise UnreadableFile(file.path, "is JSON, no table", "give a text file with a line of column names")
        if first:
            delimiter, first = next((d for d in _DELIMITERS if d in text), None), False
        if delimiter is None:
            yield Line(number, tuple(text.split()))
        else:
            cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
            yield Line(number, tuple(c.strip() for c in cells))


def check_cells(file: TextFile, line: Line, columns: Sequence[str]) -> None:
    """Raise `UnreadableFile` naming the line unless it has a cell for each column."""
    if len(line.cells) != len(columns):
        counts = f"line {line.number} has {len(line.cells)} cells, the header {len(columns)} ({', '.join(columns)})"
        remedy = "give one cell for each column; decimals are written with a point, not a comma"
        raise UnreadableFile(file.path, counts, remedy)


def rows_of_cells(header: Sequence[str], rows: Iterable[Sequence[str]]) -> bytes:
    """Return a header and rows, each starting with a name, as the CSV that `lines_of_cells` reads back.

    Raises `BadValue` for an empty name, and for a cell that could not be read back: of several lines, or with blanks
    around it.
    """
    lines = [header, *rows]
    if not all(name for name, *_ in lines):
        raise BadValue("name", "''", "one line of text")
    return utf8("".join(",".join(map(_cell, line)) + "\n" for line in lines))


def spreadsheet_rows(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV that is read by people in spreadsheets, and not by us.

    There a cell that begins as a formula is one, whatever it was meant to be: a text gets an apostrophe before it,
    which says "text". Numbers stay numbers. Files that we read back (`rows_of_cells`) keep names as they are.
    """
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n").writerow
    for row in rows:
        write([f"'{cell}" if isinstance(cell, str) and _is_formula(cell) else cell for cell in row])
    return out.getvalue()


def _is_formula(text: str) -> bool:
    return text.startswith(_FORMULAS) and not is_number(text)


def _cell(text: str) -> str:
    if text != text.strip() or len(text.splitlines()) > 1:
        raise BadValue("name", repr(text), "one line of text, without blanks around it")
    quoted = text.startswith("#") or any(c in text for c in ',"')  # a line that begins with # would be a comment
    return '"' + text.replace('"', '""') + '"' if quoted else text


def comments_of(file: TextFile) -> list[str]:
    """Return the comment lines without their #, stripped."""
    return [line.lstrip().lstrip("#").strip() for line in file.text.splitlines() if line.lstrip().startswith("#")]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, of whatever size."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def number_in(file: TextFile, line: int, what: str, cell: str) -> float:
    """Return the finite number in a cell; `UnreadableFile` naming file, line, `what` and the cell otherwise."""
    place = f"line {line}, {what}"
    if not cell:
        raise UnreadableFile(file.path, f"{place} is empty", "give a number, or remove the line")
    try:
        value = float(cell)
    except ValueError:
        remedy = "write a decimal point, not a comma" if "," in cell else "give a number, or remove the line"
        raise UnreadableFile(file.path, f"{place} is {cell[:40]!r}, not a number", remedy) from None
    if not abs(value) <= LARGEST:
        remedy = f"give a finite number, at most {LARGEST:g} in size, or remove the line"
        raise UnreadableFile(file.path, f"{place} is {cell[:40]!r}", remedy)
    return value
