"""The log of a tracking run, one line per frame: a killed run loses no finished line, and can be continued.

The log is JSON lines. The first describes the run: {"format": "cadcam track", "version": 2, ...} with fingerprints of
part, cameras, start and options. Then comes one line per frame: {"frame", "files", "sha256", "found", "quality", "how",
"reason", "pose", "filtered": null where the part was lost}. Poses are written as by `write_part_pose`: "pose" from the
frame's photos (and, where "followed", from the texture of earlier frames), "filtered" from all frames so far. A log is
only continued with the same inputs, and by one process at a time.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, takewhile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from cadcam import __version__
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import UnreadableFile
from cadcam.files.jsontext import Place, json_line, parsed_line, split_lines
from cadcam.files.matrix import pose_as_json
from cadcam.files.pose_estimate import pose_estimate_as_json, pose_estimate_at
from cadcam.files.text import read_text, spreadsheet_rows
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_path
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.part import Part
from cadcam.locate.track.appending import append, lock, opened_to_append, write
from cadcam.locate.track.entries import Entries, check_frame
from cadcam.locate.track.frames import Frame, Frames
from cadcam.locate.track.tracker import LoggedFrame, TrackedFrame, Tracker
from cadcam.locate.views.resting import OnPlane
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange
from cadcam.whole import utf8

FORMAT, VERSION = "cadcam track", 2
_INPUTS = {  # entries of the first line, and what the caller knows them as
    "software": "version",
    "part_sha256": "part, unit, colours or crease angle",
    "cameras_sha256": "camera",
    "freedom": "--freedom",
    "views": "--seen-from, --roll, --distance, --on or --lying",
}
_SWITCHES = {"velocity": "--no-velocity", "texture": "--no-print"}  # entries that these options turn off
_MAX_BYTES = 4_000_000_000
_LONGEST_HEAD = 1_000_000  # bytes of a first line; cameras are fingerprints there
_POSE = ("x_mm", "y_mm", "z_mm", *(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))
_SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_rx_deg", "sigma_ry_deg", "sigma_rz_deg")
COLUMNS = ("frame", "files", "found", "quality", "how", *_POSE, *_SIGMAS)


def track_part_to_log(
    log: TrackLog | str | os.PathLike[str],
    part: Part,
    frames: Frames,
    start: Rigid | None = None,
    *,
    freedom: Freedom = FREE,
    velocity: bool = True,
    texture: bool = True,
    views: ViewRange = WHOLE_SPHERE,
) -> Iterator[tuple[Frame, dict[str, Any]]]:
    """Yield each frame with its line in the log, once that is on disk; frames that the log already has come first.

    Those are read again, to check their fingerprints and to learn the texture that they show, but not located. The
    log's first line states the inputs of its run (`TrackLog.open`). log: an open one, or its path (.jsonl), which then
    is open as long as this goes on. Raises `UnreadableFile` where a frame or the run differs, or a frame has another
    white, as where brighter pictures were added to those it is found from.
    """
    expect(frames, "frames", Frames)
    how: dict[str, Any] = {"freedom": freedom, "velocity": velocity, "texture": texture, "views": views}
    tracker = Tracker(part, start, **how)
    if isinstance(log, TrackLog):
        yield from _tracked(log, tracker, frames)
        return
    expect_path(log, "log")
    head = head_of(part, frames.viewpoints, start, **how)
    with TrackLog.open(log, head) as opened:
        yield from _tracked(opened, tracker, frames)


def _tracked(log: TrackLog, tracker: Tracker, frames: Frames) -> Iterator[tuple[Frame, dict[str, Any]]]:
    """Yield each frame with its line in an open log, as `track_part_to_log`."""
    rest, there = iter(frames), len(log.entries)
    for entry in log.entries:
        frame = next(rest, None)
        if frame is None:
            raise UnreadableFile(log.path, f"has {there} frames, more than there are pictures", "start a new log")
        if tuple(entry["sha256"]) != frame.sha256:
            raise UnreadableFile(
                frame.names[0], f"is not the picture of frame {frame.index} in {log.path}", "start a new log"
            )
        _check_white(log.path, entry, frame)
        tracker.recall(replace(_step(log.path, entry), photos=frame.photos))
        yield frame, entry
    for frame in rest:
        yield frame, log.append(tracker.next(frame))


class TrackLog:
    """A log that frames are appended to; made by `open`."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        file: io.FileIO,
        entries: Entries,
        table: io.FileIO | None,
        *,
        filtered: bool,
    ) -> None:
        self.path: str = os.fspath(path)
        self.entries = entries
        self._filtered = filtered
        self._file = file
        self._table = table

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        head: dict[str, Any],
        *,
        table: str | os.PathLike[str] | None = None,
        filtered: bool = False,
        overwrite: bool = False,
    ) -> TrackLog:
        """Return the log at `path`: a new one that begins with `head` (`head_of`), or one with the same head.

        An incomplete last line is removed; a log without frames is begun anew, and with `overwrite` any. table: a CSV
        file, one line per frame, rewritten from the log, with the `filtered` poses or else those of single frames.
        Raises `UnreadableFile` where the file holds another run, or with `overwrite` no log of tracked frames at all;
        `UnwritableFile` where another process has the log open.
        """
        file = opened_to_append(path)
        try:
            lock(file, path)
            entries = _continued(path, head, anew=overwrite) if Path(path).stat().st_size else Entries(path)
            if not entries:
                file.truncate(0)
                append(file, json_line(head) + "\n")
            if table is not None:
                write(table, chain([",".join(COLUMNS) + "\n"], (_row(entry, filtered) for entry in entries)))
            return cls(path, file, entries, None if table is None else opened_to_append(table), filtered=filtered)
        except BaseException:
            file.close()
            raise

    def __repr__(self) -> str:
        found = sum(bool(entry["found"]) for entry in self.entries)
        return f"TrackLog({self.path!r}, {len(self.entries)} frames, the part found in {found})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        for file in (self._file, self._table):
            if file is not None:
                file.close()

    def append(self, tracked: TrackedFrame) -> dict[str, Any]:
        """Append a frame; return its line once it is on disk."""
        entry = entry_of(tracked)
        self.entries.note(append(self._file, json_line(entry) + "\n"))
        if self._table is not None:
            append(self._table, _row(entry, self._filtered))
        return entry

    def steps(self) -> Iterator[LoggedFrame]:
        """Yield the frames in the log, without their photos, for `track_part` to continue from."""
        return (_step(self.path, entry) for entry in self.entries)


def entry_of(tracked: TrackedFrame) -> dict[str, Any]:
    """Return the log line of a frame."""
    location = tracked.location
    return {
        "frame": tracked.frame.index,
        "files": list(tracked.frame.names),
        "sha256": list(tracked.frame.sha256),
        "white": list(tracked.frame.whites),
        "found": tracked.found,
        "quality": location.quality,
        "how": tracked.how,
        "reason": location.reason,
        "pose": pose_estimate_as_json(location.pose),
        "filtered": None if tracked.filtered is None else pose_estimate_as_json(tracked.filtered),
    }


def head_of(
    part: Part,
    viewpoints: Sequence[Viewpoint],
    start: Rigid | None = None,
    *,
    freedom: Freedom = FREE,
    velocity: bool = True,
    texture: bool = True,
    views: ViewRange = WHOLE_SPHERE,
) -> dict[str, Any]:
    """Return the first line of a log: everything except the pictures that determines the results."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "software": f"cadcam {__version__}",
        "part_sha256": part.scene.sha256,
        "cameras_sha256": [_hash(_numbers(view)) for view in viewpoints],
        "start": None if start is None else pose_as_json(start),
        "freedom": {"frame": freedom.frame, "basis": freedom.basis.tolist()},
        "velocity": velocity,
        "texture": texture,
        "views": _views_as_json(views),
    }


def read_track_log(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Return the lines of a log's frames, poses as `PoseEstimate`. Raises `UnreadableFile`, naming the line."""
    lines = split_lines(read_text(path, max_bytes=_MAX_BYTES).text)
    _check_head(path, _object(path, 1, lines[0]))
    entries = [check_frame(path, number, line) for number, line in enumerate(lines[1:], 2)]
    for number, entry in enumerate(entries, 2):
        for name in ("pose", "filtered"):
            if entry[name] is not None:
                entry[name] = pose_estimate_at(Place(os.fspath(path), (f"line {number}", name), entry[name]))
    return entries


def _views_as_json(views: ViewRange) -> dict[str, Any] | None:
    """Return a range of views; None for all of them, of which logs of before say nothing."""
    said, every = (
        {"axis": v.axis.tolist(), "half_angle_deg": v.half_angle_deg, "up": v.up.tolist(), "roll_deg": v.roll_deg}
        | {"distance_mm": None if v.distance_mm is None else list(v.distance_mm)}
        | ({} if v.on is None else {"on": _plane_as_json(v.on)})
        for v in (views, WHOLE_SPHERE)
    )
    return None if said == every else said


def _plane_as_json(on: OnPlane) -> dict[str, Any]:
    down = None if on.down is None else on.down.tolist()
    plane = {"normal": on.plane.normal.tolist(), "offset_mm": float(on.plane.offset)}
    return plane | {"down": down, "within_mm": on.within_mm}


def _check_white(path: str, entry: Mapping[str, Any], frame: Frame) -> None:
    """Raise `UnreadableFile` where a frame was read with another white than the log says; older logs do not say."""
    then, now = entry.get("white", []), list(frame.whites)
    if then and then != now:
        one, other = (", ".join(f"{white:g}" for white in whites) for whites in (then, now))
        reason = f"was begun with another white: frame {frame.index} was read with {one}, now with {other}"
        brighter = len(then) > 1 or now > then  # pictures that were added exceed the white of then
        raise UnreadableFile(path, reason, f"{'' if brighter else f'--full-scale {one}, or '}start a new log")


def _continued(path: str | os.PathLike[str], head: dict[str, Any], *, anew: bool) -> Entries:
    """Return the complete lines of a log after its head, none if it is begun anew; truncate the file after them.

    A log without them is of a run that failed at its first frame, perhaps by inputs that were mended since.
    """
    if anew:
        _check_overwritable(path)
        return Entries(path)
    entries, wanted = Entries(path), json_line(head) + "\n"
    with Path(path).open("rb") as file:
        first = file.readline(_LONGEST_HEAD)
        if not first.endswith(b"\n") and utf8(wanted).startswith(first):  # killed, or the disk full, at its beginning
            return entries
        there = _object(path, 1, first.decode(errors="replace")) if first.endswith(b"\n") else {}
        _check_head(path, there)
        end = file.tell()
        lines = takewhile(lambda line: line.endswith(b"\n"), file)
        for number, line in enumerate(lines, 2):
            if number == 2:
                _check_same(path, there, json.loads(wanted))
            check_frame(path, number, line.decode(errors="replace").removesuffix("\n"))
            entries.note(end)
            end += len(line)
    if entries and end < Path(path).stat().st_size:
        os.truncate(path, end)
    return entries


def _check_overwritable(path: str | os.PathLike[str]) -> None:
    """Raise `UnreadableFile` where a file that is to be overwritten is, by its first line, no log of tracked frames."""
    with Path(path).open("rb") as file:
        first = file.readline(_LONGEST_HEAD).decode(errors="replace")
    try:
        _check_is_log(path, _object(path, 1, first))
    except UnreadableFile as error:
        kept = "what is no track log is kept, --overwrite or not; if it is one whose first line is damaged, delete it"
        raise UnreadableFile(path, error.reason, kept) from None


def _check_same(path: str | os.PathLike[str], there: dict[str, Any], head: dict[str, Any]) -> None:
    """Raise `UnreadableFile` where the first line of a log with frames is not that of this run."""
    for key, value in head.items():
        if there.get(key) != value:
            reason = f"was begun {_differs(key, there.get(key), value)}"
            raise UnreadableFile(path, reason, "name a new log, or --overwrite this one")


def _differs(key: str, there: Any, now: Any) -> str:
    """Return how an entry of a log's head differs from this run's, in terms that the user knows."""
    if key in _SWITCHES:
        return f"with{'out' if there else ''} {_SWITCHES[key]}"
    one, other = _brief(key, there), _brief(key, now)
    values = f" ({one}, now {other})" if one != other else ""
    return f"with another {_INPUTS.get(key, key)}{values}"


def _brief(key: str, value: Any) -> str:
    """Return an entry of a log's head in a few words, "" where that would not help."""
    if key == "start":
        return "none" if value is None else "at {:.4g}, {:.4g}, {:.4g} mm".format(*value["translation_mm"])
    if key in ("part_sha256", "software"):
        return str(value)[:30] if key == "software" else str(value)[:8]
    return ""


def _check_is_log(path: str | os.PathLike[str], head: dict[str, Any]) -> None:
    if head.get("format") != FORMAT:
        raise UnreadableFile(path, "is not a log of tracked frames", "name another file")


def _check_head(path: str | os.PathLike[str], head: dict[str, Any]) -> None:
    _check_is_log(path, head)
    if head.get("version") != VERSION:
        raise UnreadableFile(path, f"has version {head.get('version')!r}", f"version {VERSION} is read here")


def _object(path: str | os.PathLike[str], number: int, line: str) -> dict[str, Any]:
    return parsed_line(path, number, line).object


def _step(path: str, entry: dict[str, Any]) -> LoggedFrame:
    pose = pose_estimate_at(Place(path, (f"frame {entry['frame']}", "pose"), entry["pose"])) if entry["found"] else None
    return LoggedFrame(entry["frame"], pose, entry["how"])


def _row(entry: dict[str, Any], filtered: bool) -> str:
    """Return the table row of a frame, without the pose where the part was lost."""
    row = [entry["frame"], ";".join(entry["files"]), int(entry["found"]), entry["quality"], entry["how"]]
    if entry["found"]:
        pose = entry["filtered" if filtered else "pose"]
        T = pose["world_from_part"]
        row += [*T["translation_mm"], *(v for line in T["rotation"] for v in line)]
        row += [*pose["sigma_mm"], *pose["sigma_deg"]]
    return spreadsheet_rows([row + [""] * (len(COLUMNS) - len(row))])


def _numbers(view: Viewpoint) -> Iterable[Any]:
    """Return all numbers of a viewpoint that determine what is found."""
    yield [*view.camera.size]
    yield view.camera.K
    yield list(type(view.camera.lens).__name__.encode())
    yield [*view.camera.lens.parameters.values()]
    yield view.camera_from_world.matrix
    for source, effect in view.errors:
        yield source.covariance
        yield effect


def _hash(arrays: Iterable[Any]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(np.asarray(array, np.float64)).tobytes())
    return digest.hexdigest()
