"""The position of the camera and the time of a picture: in the picture's header, beside it, or in one list.

PGM and PPM pictures carry it in their header's comments, as the thesis' grabber wrote them (Prog 3):

    P5
    #Camera pos: 8175.40 21616.90 # grab: Fri Jul 21 09:28:08 1995
    # camera: 12
    720 575
    255

Any other picture has a sidecar beside it, photo.png.json, or a line in a list of positions:

    {"camera": "12", "x_mm": 8175.4, "y_mm": 21616.9, "time": "1995-07-21T09:28:08+00:00"}

    picture,   camera, x_mm,   y_mm,    time
    photo.png, 12,     8175.4, 21616.9, 1995-07-21T09:28:08+00:00

Positions are those reported by the controller, mm. A time without a zone is taken as UTC. Where several of these cover
a picture, they must agree.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.jsontext import parsed
from cadcam.files.points import header_line
from cadcam.files.text import TextFile, check_cells, lines_of_cells, number_in, read_text, rows_of_cells
from cadcam.image.picture import to_gray
from cadcam.whole import write_whole

AGREE_MM, AGREE_S = 0.01, 1.0  # headers are written with two decimals and whole seconds
_HEADER_BYTES = 4096
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_POSITION = re.compile(r"camera\s+pos(?:ition)?\s*:\s*([-+\d.eE]+)[\s,]+([-+\d.eE]+)", re.IGNORECASE)
_GRAB = re.compile(r"(?:grab|time)\s*:\s*([^#\n]+)", re.IGNORECASE)
_CAMERA = re.compile(r"#\s*camera\s*:\s*([^#\n]+)", re.IGNORECASE)
_CTIME = re.compile(r"\w{3}\.?,?\s+(\w{3})\s+(\d{1,2})\s+(\d{1,2}):(\d{2}):(\d{2})\s+(\d{4})")
_COLUMNS = ("picture", "camera", "x_mm", "y_mm", "time")


@dataclass(frozen=True, slots=True)
class ShotPosition:
    """The controller's position (x, y) in mm while a picture was taken; its camera and time, if known."""

    x: float
    y: float
    camera: str = ""
    time: datetime | None = None

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            if not np.isfinite(getattr(self, name)):
                raise BadValue(f"camera position {name}", getattr(self, name), "a finite number of mm")
        if self.time is not None and self.time.tzinfo is None:
            object.__setattr__(self, "time", self.time.replace(tzinfo=UTC))


def read_shot(
    picture: str | os.PathLike[str],
    positions: Mapping[str, ShotPosition] | None = None,
    *,
    positions_from: str = "positions",
) -> ShotPosition:
    """Return position and time of a picture: by its header, its sidecar, and a list of positions by file name.

    positions: of `read_positions`, read from the file `positions_from`. Raises `UnreadableFile` where none of them
    covers the picture, or two of them disagree.
    """
    path = Path(picture)
    stated: list[tuple[str, ShotPosition]] = []
    if (header := header_shot(path)) is not None:
        stated.append((f"the header of {path}", header))
    sidecar = path.with_name(path.name + ".json")
    if sidecar.is_file():
        stated.append((str(sidecar), read_sidecar(sidecar)))
    if positions is not None and (listed := positions.get(path.name)) is not None:
        stated.append((positions_from, listed))
    if not stated:
        raise UnreadableFile(
            path, "has no camera position", f"write it into {sidecar.name}, a list of positions, or a PGM's header"
        )
    (first, shot), *others = stated
    for where, other in others:
        _refuse_other(path, (first, shot), (where, other))
        shot = ShotPosition(shot.x, shot.y, shot.camera or other.camera, shot.time or other.time)
    return shot


def header_shot(picture: str | os.PathLike[str]) -> ShotPosition | None:
    """Return position and time from the header of a PGM or PPM picture; None for others and without it."""
    path = Path(picture)
    try:
        with path.open("rb") as file:
            data = file.read(_HEADER_BYTES)
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error), "check the path") from error
    if data[:2] not in (b"P2", b"P3", b"P5", b"P6"):
        return None
    text = _comments(data)
    found = _POSITION.search(text)
    if found is None:
        return None
    try:
        x, y = float(found[1]), float(found[2])
    except ValueError:
        raise UnreadableFile(path, f"its header says {found[0]!r}, no position", "write two numbers in mm") from None
    camera, grab = _CAMERA.search(text), _GRAB.search(text)
    time = None if grab is None else _time(path, grab[1].strip(" ?\t\r"))
    try:
        return ShotPosition(x, y, "" if camera is None else camera[1].strip(), time)
    except BadValue as error:
        raise UnreadableFile(path, f"its header says {found[0]!r}: {error}") from None


def read_sidecar(path: str | os.PathLike[str]) -> ShotPosition:
    """Return the shot in a sidecar file (layout: see this module)."""
    place = parsed(read_text(path))
    place.only("camera", "x_mm", "y_mm", "time")
    camera = place.at("camera").text() if "camera" in place.object else ""
    time = _time(path, place.at("time").text()) if "time" in place.object else None
    return place.build(lambda: ShotPosition(place.at("x_mm").number(), place.at("y_mm").number(), camera, time))


def read_positions(path: str | os.PathLike[str]) -> dict[str, ShotPosition]:
    """Return the shots by file name in a list of positions (layout: see this module); camera and time may be left out.

    Raises `UnreadableFile` naming line and column.
    """
    file = read_text(path)
    lines = list(lines_of_cells(file))
    header = [cell.lower() for cell in header_line(file, lines)]
    for name in ("picture", "x_mm", "y_mm"):
        if name not in header:
            raise UnreadableFile(path, f"has no column {name}", f"name the columns {', '.join(_COLUMNS)}")
    out: dict[str, ShotPosition] = {}
    for line in lines[1:]:
        check_cells(file, line, header)
        row = dict(zip(header, line.cells, strict=True))
        name = Path(row["picture"]).name
        if name in out:
            raise UnreadableFile(path, f"line {line.number} names {name!r} a second time", "give each picture one line")
        out[name] = _row(file, line.number, row)
    return out


def write_positions(path: str | os.PathLike[str], shots: Mapping[str, ShotPosition]) -> None:
    """Write a list of positions by file name."""
    rows = (
        [name, s.camera, repr(float(s.x)), repr(float(s.y)), "" if s.time is None else s.time.isoformat()]
        for name, s in shots.items()
    )
    write_whole(path, rows_of_cells(_COLUMNS, rows))


def write_pgm(path: str | os.PathLike[str], gray: npt.ArrayLike, shot: ShotPosition | None = None) -> None:
    """Write a grey picture (H, W) in [0, 1] as raw PGM of 8 bits, the shot in its header (Prog 3).

    Raises `BadValue` for a camera's name that such a header cannot hold.
    """
    values = to_gray(gray)
    height, width = values.shape
    comment = "" if shot is None else _comment(shot)
    data = (np.clip(values, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)
    write_whole(path, f"P5\n{comment}{width} {height}\n255\n".encode() + data.tobytes())


def _comment(shot: ShotPosition) -> str:
    if "#" in shot.camera or len(shot.camera.splitlines()) > 1:
        raise BadValue("camera", repr(shot.camera), "one line without #, as a PGM's header holds")
    grab = "" if shot.time is None else f" # grab: {_ctime(shot.time.astimezone(UTC))}"
    camera = f"# camera: {shot.camera}\n" if shot.camera else ""
    return f"#Camera pos: {_mm(shot.x)} {_mm(shot.y)}{grab}\n{camera}"


def _mm(value: float) -> str:
    return f"{value:.2f}" if round(value, 2) == value else repr(float(value))


def _ctime(time: datetime) -> str:
    day = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")[time.weekday()]
    return f"{day} {_MONTHS[time.month - 1]} {time.day} {time:%H:%M:%S} {time.year}"


def _time(path: str | os.PathLike[str], text: str) -> datetime:
    """Return the time in a text, ISO 8601 or in the form of C's ctime; without a zone it is UTC."""
    found = _CTIME.match(text)
    try:
        if found is not None:
            month = _MONTHS.index(found[1].capitalize()) + 1
            day, hour, minute, second, year = (int(found[i]) for i in (2, 3, 4, 5, 6))
            return datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        time = datetime.fromisoformat(text)
    except ValueError:
        remedy = "write it as 1995-07-21T09:28:08+00:00"
        raise UnreadableFile(path, f"says the time {text[:40]!r}, which is none", remedy) from None
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def _comments(header: bytes) -> str:
    """Return the comment lines of a PGM's header, those before its fourth number or word; UTF-8, or Latin-1 of old."""
    out, words = [], 0
    for line in header.splitlines():
        before, hash_, after = line.partition(b"#")
        words += len(before.split())
        if hash_:
            out.append(b"#" + after)
        if words >= 4:
            break
    comments = b"\n".join(out)
    try:
        return comments.decode()
    except UnicodeDecodeError:
        return comments.decode("latin-1")


def _row(file: TextFile, number: int, row: Mapping[str, str]) -> ShotPosition:
    x, y = (number_in(file, number, f"column {name}", row[name]) for name in ("x_mm", "y_mm"))
    time = _time(file.path, row["time"]) if row.get("time") else None
    return ShotPosition(x, y, row.get("camera", ""), time)


def _refuse_other(picture: Path, one: tuple[str, ShotPosition], other: tuple[str, ShotPosition]) -> None:
    (first, a), (second, b) = one, other
    if max(abs(a.x - b.x), abs(a.y - b.y)) > AGREE_MM:
        said = f"the camera at ({b.x:.2f}, {b.y:.2f}) mm, {first} at ({a.x:.2f}, {a.y:.2f})"
    elif a.camera and b.camera and a.camera != b.camera:
        said = f"camera {b.camera!r}, {first} camera {a.camera!r}"
    elif a.time and b.time and abs((a.time - b.time).total_seconds()) > AGREE_S:
        said = f"the time {b.time.isoformat()}, {first} {a.time.isoformat()}"
    else:
        return
    remedy = "one of them belongs to another picture: put it right or remove it"
    raise UnreadableFile(second, f"has for {picture.name} {said}", remedy)
