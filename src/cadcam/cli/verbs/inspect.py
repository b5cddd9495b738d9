"""`cadcam inspect`: folders of photos of parts -> a verdict for each part, kept in a store; charts over the parts."""

from __future__ import annotations

import argparse
import hashlib
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from cadcam.cli.arguments import Verbs, add_json, verb
from cadcam.cli.arrivals import Arrival, Arrivals, Source
from cadcam.cli.cameras import hash_of
from cadcam.cli.judging import (
    TOLERANCES_HELP,
    add_judging_options,
    judged_by,
    options_as_asked,
    origin_of,
    part_to_judge,
    tolerances_as_asked,
)
from cadcam.cli.locating import (
    FREEDOM_HELP,
    START_FILE_HELP,
    VIEWS_HELP,
    add_start_option,
    add_view_options,
    freedom_as_asked,
    located,
    pose_in_file,
    views_as_asked,
)
from cadcam.cli.models import add_model_options, check_order, load_as_asked
from cadcam.cli.output import check_folder, refuse_own_folder, say, say_written, working
from cadcam.cli.photos import Shots, add_photo_options, camera_sources, shots_by, viewpoints_of
from cadcam.cli.stopping import stopped_as_by_ctrl_c
from cadcam.cli.stores import STORE_HELP, add_store_option, judging_alone, store_address
from cadcam.cli.telling import Telling
from cadcam.cli.whites import white_as_asked
from cadcam.errors import BadValue, CadcamError, UnreadableFile, UnusableStore
from cadcam.image.suffixes import READABLE
from cadcam.whole import utf8

if TYPE_CHECKING:
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.part import Part
    from cadcam.locate.views.view_range import ViewRange
    from cadcam.record.record import Record
    from cadcam.record.store import Store
    from cadcam.verify.inspection import InspectionOptions
    from cadcam.verify.judge import Verification
    from cadcam.verify.tolerances.tolerance import Tolerances

_EVERY_S = 1.0  # between looks at the folders; photos that are the same in two of them are complete
_REST = 4.0  # times as long as a look takes that passes before the next: one at tens of thousands of photos takes long
_LATE_S = 10.0  # that a part waits for its photos before this is told: cameras do not write at the same moment
_PAGE_S = 10.0  # between writings of the page while there is more to do
_ASKED_FOR_WHITE = 20  # photos of a camera from which is told what is white in those of more than 8 bits
_ASKED_AT_ONCE = 20  # parts of which is asked in one go whether they were judged before
_PAGE = "index.html"
_NAME_BYTES, _BEGINS_BYTES = 240, 120  # of a report's name at most, and what is left of a longer one
_CHARTED = 300  # parts on the page: the latest
_DESCRIPTION = """\
Judge one part after the other, as `cadcam verify` judges one: a folder of photos in, for each part a verdict, a record
in the store (`cadcam state`) and a report; over all parts a page with a chart of each feature. With --watch it goes on
with whatever arrives, until it is stopped."""
_EXAMPLES = f"""\
  cadcam inspect photos/ part.step --camera camera.json --tolerances tolerances.yaml --reports inspected/
  cadcam inspect photos/ part.step --camera camera.json --tolerances tolerances.yaml --start near.json --watch
  cadcam inspect left/ right/ part.step --rig rig.json --tolerances tolerances.yaml --station "cell 3"
  cadcam inspect 'left=in/*_L.png' 'right=in/*_R.png' part.step --rig rig.json --tolerances tolerances.yaml

photos: of each camera a folder, or a pattern with one * in the name of the file. A photo's serial number is its name
without the suffix, or what stands for *. Photos of one serial number show one part; with several cameras a part is
judged when all of them have a photo of it.

A part is judged once: when its record is in the store, with the same photos, model, camera, tolerances and start by
their contents, it is left out. So the same command goes on where it was, and judges anew what was judged by other
limits. After a change of other options, --again judges all anew.
A photo that is, byte for byte, one of another serial number in the store is not judged: the camera may have stopped.

--reports FOLDER gets index.html, the page of all parts, and parts/SERIAL.html, the report of each.

--watch is ended by Ctrl-C or SIGTERM (systemd, docker stop); page and exit code are those of the parts until then.
--json prints one document at the end; with --watch one a line, of each part as it is judged. A second `inspect` of
photos in the same folder, into the same store, is refused while the first one runs.

{TOLERANCES_HELP}
start:    --start FILE    about where all parts are; it may be off by some 20 degrees, 40 px and 10 % of the distance.
                          Without it each is searched for, which takes longer
{START_FILE_HELP}
{FREEDOM_HELP}
{VIEWS_HELP}
{STORE_HELP}
exit codes: 2 where photos could not be judged (unreadable, another part's, without one of each camera, or with two of
one; the others were), else 1 where a part
FAILs, else 3 where one is UNDECIDED or not found, else 0. Without --tolerances nothing is judged: 3 where a part was
not found, else 0. 130 where it was stopped before its end without --watch."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "folders of photos + CAD + tolerances -> a verdict for each part, kept; charts over the parts"
    parser = verb(verbs, "inspect", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("photos", nargs="+", metavar="PHOTOS", help="folder or pattern of photos; one per camera")
    add_model_options(parser)
    add_photo_options(parser)
    parser.add_argument("--tolerances", metavar="FILE", help="tolerance file (see below)")
    add_start_option(parser)
    add_view_options(parser)
    add_judging_options(parser)
    group = parser.add_argument_group("results")
    group.add_argument("--part", metavar="NAME", help="kind of part, in store and reports (default: the model's name)")
    group.add_argument("--station", metavar="NAME", help="where it is measured, in store and reports")
    add_store_option(group)
    group.add_argument("--reports", metavar="FOLDER", help="write the page of all parts and the report of each")
    group.add_argument("--watch", action="store_true", help="go on with photos that arrive, until Ctrl-C or SIGTERM")
    group.add_argument("--again", action="store_true", help="judge anew what was judged before, too")
    parser.set_defaults(resumes=True, points=None)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Judge what is there, and what arrives; return the exit code."""
    from cadcam.record.store import open_store

    check_order(arguments.photos, arguments.model, frames=True)
    check_folder(arguments.reports)
    arrivals = Arrivals([Source.of(text) for text in arguments.photos])
    refuse_own_folder(arguments.reports, [str(source.folder / "photo") for source in arrivals.sources])
    if not arguments.watch and not arrivals.there():
        raise BadValue(f"number of parts in {', '.join(arguments.photos)}", 0, _wanted(arrivals))
    with stopped_as_by_ctrl_c():
        cell = _cell(arguments)
        with open_store(store_address(arguments)) as store, judging_alone(store, cell.name, arrivals.sources) as hold:
            line = _Line(cell, store)
            try:
                for some in _arriving(arrivals, line.told) if arguments.watch else [arrivals.there()]:
                    hold()
                    line.take(some)
                    if not some:
                        line.write_page()
            except KeyboardInterrupt:
                if not arguments.watch:
                    raise
            finally:
                line.write_page()
            line.end(arrivals)
    return line.told.exit_code


def _arriving(arrivals: Arrivals, told: Telling) -> Iterator[list[Arrival]]:
    """Yield what arrives, [] where nothing does, for ever: a folder that is not there may come back."""
    away, due = "", 0.0
    while True:
        with working("waiting for photos; Ctrl-C ends"):
            time.sleep(max(due - time.monotonic(), 0.0))  # also after parts that took no time: who writes needs it
            begun = time.monotonic()
            try:
                new, away = arrivals.new(), ""
            except UnreadableFile as error:
                new = []
                if str(error) != away:
                    away = str(error)
                    say(f"{away}; waiting for it")
            due = max(begun + _EVERY_S, time.monotonic() + _REST * (time.monotonic() - begun))
        for serial, why in arrivals.overdue(time.monotonic(), _LATE_S).items():
            told.waits(serial, why)
        yield new


def _wanted(arrivals: Arrivals) -> str:
    if lacking := next(iter(arrivals.incomplete()), None):
        return f"of each camera one photo of the same serial number, which {lacking!r} has not"
    return f"pictures ({' '.join(READABLE)}), or --watch to wait for them"


@dataclass(frozen=True, slots=True, eq=False)
class _Cell:
    """What is the same for all parts: cameras, part, tolerances, where to look; and the files that say so."""

    arguments: argparse.Namespace
    viewpoints: Sequence[Viewpoint]
    camera_from_world: Rigid | None
    start: Rigid | None
    freedom: Freedom
    views: ViewRange
    options: InspectionOptions
    part: Part
    tolerances: Tolerances
    cameras: Sequence[tuple[str, str, str]]
    files: Sequence[tuple[str, str, str]]

    @property
    def name(self) -> str:
        """The kind of part."""
        return str(self.arguments.part or Path(self.arguments.model).stem)

    def prints(self, arrival: Arrival) -> tuple[str, set[str]]:
        """Return the hash of a part's first photo, and those of all files that its verdict comes from."""
        photos = [hash_of(file) for file in arrival.files]
        return photos[0], {*photos, *(digest for _, _, digest in (*self.cameras, *self.files))}

    def shots(self, arrival: Arrival, whites: Sequence[float | None]) -> Shots:
        """Return the photos of a part; each is called by its file's name where that tells them apart."""
        names = [Path(file).name for file in arrival.files]
        if self.arguments.rig or len(set(names)) < len(names):
            names = [view.name for view in self.viewpoints]
        views = [replace(view, name=name) for view, name in zip(self.viewpoints, names, strict=True)]
        return shots_by(views, self.camera_from_world, arrival.files, whites, self.cameras)

    def judged(self, shots: Shots) -> Verification:
        """Return what is found of a part."""
        from cadcam.verify.judge import verify_part

        place = located(self.part, shots, self.start, self.freedom, self.views)
        how: dict[str, Any] = {"options": self.options, "freedom": self.freedom}
        with working("judging"):
            return verify_part(self.part, shots.photos, place, self.tolerances, **how)


def _cell(arguments: argparse.Namespace) -> _Cell:
    viewpoints, said = viewpoints_of(arguments.photos, arguments.camera, arguments.rig)
    freedom = freedom_as_asked(arguments, posed=arguments.start is not None)
    views, start, placed_by = views_as_asked(arguments, said, "--start"), None, []
    if arguments.start is not None:
        start = pose_in_file(arguments, arguments.start, viewpoints, said)
        placed_by = [("start", arguments.start, hash_of(arguments.start))]  # a wrong one, mended, is another question
    tolerances, cameras = tolerances_as_asked(arguments), camera_sources(arguments)
    mesh, report = load_as_asked(arguments)
    part, tolerances = part_to_judge(arguments, mesh, tolerances)
    how = (start, freedom, views, options_as_asked(arguments), part, tolerances)
    return _Cell(arguments, viewpoints, said, *how, cameras, [*judged_by(arguments, report), *placed_by])


class _Line:
    """The parts one after the other: what was found of each is printed, reported, and kept."""

    def __init__(self, cell: _Cell, store: Store) -> None:
        self._cell, self._store, self.arguments = cell, store, cell.arguments
        self.folder = None if cell.arguments.reports is None else Path(cell.arguments.reports)
        self._whites: list[float | None] = []
        self._page_due, self._unwritten = 0.0, False
        self.told = Telling(json=cell.arguments.json, lines=cell.arguments.watch)
        self.latest: deque[Record] = deque(maxlen=_CHARTED)
        self._earlier = self._reported()

    def _reported(self) -> list[Record]:
        """Return the latest records of parts whose reports an earlier run has written into the folder."""
        if self.folder is None:
            return []
        there = self._store.query(part=self._cell.name, station=self.arguments.station, newest=_CHARTED)
        return [record for record in there if (self.folder / _report_of(record.serial)).exists()]

    def take(self, arrivals: Sequence[Arrival]) -> None:
        """Judge some parts, or find that they were."""
        self._whites = self._whites or self._find_whites(arrivals)
        before: dict[str, Record] = {}
        for place, arrival in enumerate(arrivals):
            if place % _ASKED_AT_ONCE == 0:
                before = self._before(arrivals[place : place + _ASKED_AT_ONCE])
            self.told.begin(arrival.serial)
            number = f"{place + 1}/{len(arrivals)}"
            if known := before.get(arrival.serial):
                self._note(known, number, None)
            else:
                self._judge(arrival, number)
            if time.monotonic() > self._page_due:
                self.write_page()

    def _judge(self, arrival: Arrival, number: str) -> None:
        """Judge a part, keep and tell what was found; or say why its photos cannot be judged."""
        begun = time.monotonic()
        try:
            shots = self._cell.shots(arrival, self._whites or [None] * len(arrival.files))
            self._check_own(arrival, shots)
            found = self._cell.judged(shots)
        except UnusableStore:
            raise
        except CadcamError as error:  # of these photos: there are others
            self.told.failed(arrival.serial, str(error))
            self._unwritten = True
            return
        self._note(self._keep(arrival, found, shots), number, time.monotonic() - begun)

    def _check_own(self, arrival: Arrival, shots: Shots) -> None:
        """Raise `UnreadableFile` where a photo was another part's first: noise alone makes any two photos differ."""
        from cadcam.record.record import as_kept

        for info in shots.read:
            of = self._store.query(part=self._cell.name, sha256=info.sha256)
            first = next((record.serial for record in of if record.serial), None)
            if first not in (None, as_kept(arrival.serial)):
                said = f"is the same photo, byte for byte, as that of {first}"
                raise UnreadableFile(info.path, said, "has the camera stopped?")

    def _find_whites(self, arrivals: Sequence[Arrival]) -> list[float | None]:
        """Return what is white in the photos of each camera, by the first that can be read; [] where none can."""
        sample = list(islice(filter(_is_readable, arrivals), _ASKED_FOR_WHITE))
        columns = list(zip(*(arrival.files for arrival in sample), strict=True))
        if self.arguments.rig or not columns:
            return [white_as_asked(self.arguments, files) for files in columns]
        return [white_as_asked(self.arguments, [file for files in columns for file in files])] * len(columns)

    def _before(self, arrivals: Sequence[Arrival]) -> dict[str, Record]:
        """Return by serial number the records of parts that were judged before, of the same photos by the same files.

        Many are asked for at once: one at a time, a folder of thousands would take minutes to go through.
        """
        from cadcam.record.record import as_kept

        if self.arguments.again:
            return {}
        of: dict[str, tuple[str, set[str]]] = {}  # the hash of its first photo, and those of all files, by serial
        for arrival in arrivals:
            with suppress(CadcamError):  # who judges it says why it cannot be read
                of[arrival.serial] = self._cell.prints(arrival)
        photos = [first for first, _ in of.values()]
        known = {
            (record.serial, frozenset(source.sha256 for source in record.sources)): record  # the latest of equal ones
            for record in self._store.query(part=self._cell.name, sha256=photos)
        }
        each = {serial: known.get((as_kept(serial), frozenset(prints))) for serial, (_, prints) in of.items()}
        return {serial: record for serial, record in each.items() if record is not None}

    def _keep(self, arrival: Arrival, found: Verification, shots: Shots) -> Record:
        from cadcam.report.verify.json import record_of
        from cadcam.report.verify.page import write_verification_page

        cell = self._cell
        origin = origin_of(self.arguments, shots, cell.files, part=cell.name, serial=arrival.serial)
        if self.folder is not None:
            page = self.folder / _report_of(arrival.serial)
            write_verification_page(page, found, shots.photos, origin, scene=cell.part.scene)
        record = record_of(found, origin)
        self._store.add(record)
        return record

    def _note(self, record: Record, number: str, took_s: float | None) -> None:
        self.latest.append(record)
        self._unwritten = True
        self.told.judged(record, number, took_s)

    def write_page(self) -> None:
        """Write the page of the latest parts, if there is one and it lacks any."""
        from cadcam.report.state.page import write_state_page

        if self.folder is None or not self._unwritten or not self.latest:
            return
        last = {record.serial: record for record in (*self._earlier, *self.latest)}  # of this run, what it found last
        records = sorted(last.values(), key=lambda record: record.time)[-_CHARTED:]
        there = {r.id: _report_of(r.serial) for r in records if (self.folder / _report_of(r.serial)).exists()}
        links = {i: quote(name) for i, name in there.items()}
        write_state_page(self.folder / _PAGE, records, links=links, failed=self.told.errors | self.told.incomplete)
        self._page_due, self._unwritten = time.monotonic() + _PAGE_S, False  # now, not if it was interrupted

    def end(self, arrivals: Arrivals) -> None:
        """Tell what all parts come to."""
        with suppress(UnreadableFile):  # a folder may be gone: told already
            self.told.incomplete = arrivals.incomplete()
        self._unwritten |= bool(self.told.incomplete)
        self.write_page()
        self.told.end(self.latest, self._store.name)
        if self.folder is not None and self.latest and not self.arguments.json:
            say_written(str(self.folder / _PAGE))


def _is_readable(arrival: Arrival) -> bool:
    from cadcam.image.camera_picture import is_deep

    try:
        _ = [is_deep(file) for file in arrival.files]
    except CadcamError:
        return False
    return True


def _report_of(serial: str) -> str:
    """Return the file of a part's report: its serial number, as the store keeps it, where that can name a file.

    Else, as of one that is too long with what is added to it, its beginning and a fingerprint.
    """
    from cadcam.record.record import as_kept

    name = as_kept(serial)
    if len(utf8(name)) > _NAME_BYTES or "\\" in name:  # as of bytes that are no text
        begins = utf8(name.replace("\\", "_"))[:_BEGINS_BYTES].decode(errors="ignore")
        name = f"{begins}~{hashlib.sha256(utf8(name)).hexdigest()[:16]}"
    return f"parts/{name}.html"
