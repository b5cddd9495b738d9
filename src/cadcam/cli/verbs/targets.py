"""`cadcam targets`: marks to print, and their positions in pictures."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.arguments import NO, Verbs, add_jobs, add_json, job, real, reals, refuse, verb, whole
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.output import check_target, print_json, print_tables, progress, say, say_written
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.errors import BadValue
from cadcam.image.suffixes import WRITABLE

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.target.marks.find import FoundMark
    from cadcam.target.marks.mark import Mark

_SHEETS = (".pdf", ".svg")
_METHODS = ("auto", "spots", "correlation", "blobs")
_RULES = ("photometric", "parabola", "centroid", "autocorrelation", "autocorrelation-grid")
MARK_HELP = """\
marks (diameters, with their unit; light- before a mark: white on black):
  dot:30mm                         a disc
  ring:20mm:30mm                   a ring, by its two borders
  dot-ring:30mm:60mm:90mm          a disc in a ring: disc, white, ring
  bullseye:20mm:40mm:60mm          borders from the middle: black inside the first, white to the second ...
  angle:30mm:60mm:90mm             a disc in a ring that is open where its x axis points
  chess:60mm                       two black and two white quarters
  coded:37:30mm:45mm:60mm          a disc in a ring of coded sectors: number, disc, white, ring
"""
_EXAMPLES = """\
  cadcam targets print dot-ring:40mm:80mm:120mm -o mark.pdf --page a4
  cadcam targets find photo.png --mark dot-ring:40mm:80mm:120mm -o found.png

`cadcam targets find --help` and `cadcam targets print --help` list the marks.
"""
_DESCRIPTION = """\
Marks in pictures: each is found by itself and fitted to the grey values, in the plane or through a camera, to
hundredths of a pixel, with standard deviations. Or on paper, at true scale, alone or many to a plate."""
_FIND_EXAMPLES = f"""\
  cadcam targets find photo.png --mark dot-ring:40mm:80mm:120mm --csv marks.csv -o found.png
  cadcam targets find photo.png --mark dot-ring:40mm:80mm:120mm --radius 46 --count 8
  cadcam targets find photo.png --mark bullseye:20mm:40mm:60mm --camera camera.json
  cadcam targets find 'images/*.png' --mark coded:37:30mm:45mm:60mm --any-number --json

{MARK_HELP}
--radius is that of the outermost border in the picture. With it the fast search is used (eight directions, a few
milliseconds); without it the size is measured, at any tilt. --camera fits each mark's pose, so that perspective and
lens do not shift its centre: a mark of 27 px radius at 30 degrees is otherwise off by a quarter of a pixel.

x, y: pixels, (0, 0) the centre of the top-left one; +-: standard deviations by the grey values. score: correlation of
the fitted mark with the picture. flags: saturated, covered, cut, tilt open (two poses explain the mark alike).

exit codes: 0 found; 3 no marks, or fewer than --count, in a picture.
"""
_PRINT_EXAMPLES = f"""\
  cadcam targets print dot-ring:40mm:80mm:120mm -o mark.pdf --page a4
  cadcam targets print dot:12mm -o plate.pdf --grid 8x6:30mm --page a3 --csv places.csv
  cadcam targets print coded:5:20mm:30mm:40mm -o codes.svg --grid 4x3:55mm --numbers 12

{MARK_HELP}
Print without "fit to page" and measure what is printed below the marks. --csv writes each mark's place in mm
(id,x_mm,y_mm,z_mm), x to the right, y down the print.
"""


def add_to(verbs: Verbs) -> None:
    """Add the verb and its two jobs."""
    short = "marks: find them in pictures to hundredths of a pixel; print them at true scale"
    parser = verb(verbs, "targets", None, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    jobs = add_jobs(parser)
    _add_find(jobs)
    _add_print(jobs)


def _add_find(jobs: Verbs) -> None:
    find = job(jobs, "find", run_find, short="pictures -> marks, with standard deviations", examples=_FIND_EXAMPLES)
    find.add_argument("pictures", nargs="+", metavar="PICTURE", help="pictures, patterns ('images/*.png'), or folders")
    find.add_argument("--mark", required=True, metavar="MARK", help="what is looked for, such as dot-ring:4cm:8cm:12cm")
    find.add_argument(
        "--radius",
        type=reals,
        metavar="PX[,PX]",
        help="radius of a mark's outermost border in the picture, or its range",
    )
    find.add_argument("--count", type=whole, metavar="N", help="how many there are in each picture")
    find.add_argument(
        "--method",
        default=_METHODS[0],
        choices=_METHODS,
        help="how marks are searched for (default auto: spots where --radius is known, else blobs)",
    )
    find.add_argument(
        "--subpixel", default=_RULES[0], choices=_RULES, help="rule for the position; all but the first for comparison"
    )
    find.add_argument("--camera", metavar="FILE", help="camera file: fit poses through it")
    find.add_argument("--perspective", action="store_true", help="no camera: fit the perspective of several borders")
    find.add_argument("--any-number", action="store_true", help="coded marks: whichever number is read")
    find.add_argument(
        "--margin",
        type=real,
        default=0.7,
        metavar="M",
        help="ground around a mark that is fitted with it, by its radius (default 0.7)",
    )
    find.add_argument(
        "--least-score", type=real, default=0.8, metavar="S", help="least score of a mark, 0 to 1 (default 0.8)"
    )
    find.add_argument("--csv", metavar="FILE", help="write all marks: .csv")
    find.add_argument("-o", "--output", metavar="FILE", help="write the (one) picture with its marks: .png or .jpg")
    add_full_scale(find)
    add_json(find)


def _add_print(jobs: Verbs) -> None:
    draw = job(jobs, "print", run_print, short="a mark, or a plate of them, as PDF or SVG", examples=_PRINT_EXAMPLES)
    draw.add_argument("mark", metavar="MARK", help="the mark, such as dot-ring:40mm:80mm:120mm (see below)")
    draw.add_argument("-o", "--output", required=True, metavar="FILE", help="sheet to write: .pdf or .svg")
    draw.add_argument("--page", metavar="SIZE", help="paper: a4, a3 ... letter (default: the marks with a margin)")
    draw.add_argument("--grid", metavar="CxR:MM", help="columns x rows and their distance, such as 4x3:55mm")
    draw.add_argument("--numbers", type=whole, metavar="N", help="coded marks: as many, from the mark's number on")
    draw.add_argument("--csv", metavar="FILE", help="write the places of the marks: .csv")


def run_print(arguments: argparse.Namespace) -> None:
    """Write the sheet, and the plan."""
    from cadcam.target.marks.mark import MarkSheet, parse_mark
    from cadcam.target.sheet import write_sheet
    from cadcam.whole import write_whole

    check_target(arguments.output, _SHEETS)
    check_target(arguments.csv, (".csv",))
    if arguments.grid is None:
        refuse(arguments, "--numbers", why="without --grid", expected="both: a sheet of one mark has one number")
    columns, rows, spacing = _grid(arguments.grid)
    marks = _marks(parse_mark(arguments.mark), arguments.numbers, columns * rows)
    plate = MarkSheet.grid(marks, columns, rows, spacing)
    width, height = write_sheet(arguments.output, plate, page=arguments.page)
    if arguments.csv:
        coded = arguments.numbers is not None
        names = [m.number if coded else i for i, m in enumerate(plate.marks)]
        lines = [f"{n},{x:.6g},{y:.6g},0" for n, (x, y) in zip(names, plate.places.tolist(), strict=True)]
        write_whole(arguments.csv, ("\n".join(["id,x_mm,y_mm,z_mm", *lines]) + "\n").encode())
    across, down = plate.size_mm
    print(
        f"wrote {arguments.output}: {plate} on {width:.4g} x {height:.4g} mm; print it without scaling: the black area "
        f"must measure {across:.2f} x {down:.2f} mm"
    )


def _grid(text: str | None) -> tuple[int, int, float]:
    from cadcam.target.boards.board import length_mm

    if text is None:
        return 1, 1, 1.0
    form = "COLUMNSxROWS:DISTANCE, such as 4x3:55mm"
    count, colon, spacing = text.partition(":")
    columns, cross, rows = count.lower().partition("x")
    if not (colon and cross and columns.isdecimal() and rows.isdecimal()):
        raise BadValue("--grid", text, form)
    return int(columns), int(rows), length_mm(spacing, "--grid", text, form)


def _marks(mark: Mark, numbers: int | None, places: int) -> tuple[Mark, ...]:
    """Return one mark, or as many coded ones as there are places."""
    from cadcam.target.marks.mark import renumbered, ring_numbers
    from cadcam.target.marks.ring_code import code_bits

    if numbers is None:
        return (mark,)
    if mark.number is None:
        raise BadValue("--numbers", numbers, f"a coded mark; {mark} has no number")
    free = [n for n in ring_numbers(code_bits(mark)) if n >= mark.number]
    if numbers != places or numbers > len(free):
        wanted = f"{places}, as the grid has places; there are {len(free)} numbers from {mark.number} on"
        raise BadValue("--numbers", numbers, wanted)
    return tuple(renumbered(mark, n) for n in free[:numbers])


def run_find(arguments: argparse.Namespace) -> int:
    """Find, write, report."""
    from cadcam.cli.photos import picture_files
    from cadcam.errors import TooFewMarks
    from cadcam.target.marks.mark import parse_mark

    check_target(arguments.csv, (".csv",))
    check_target(arguments.output, WRITABLE)
    if arguments.camera:
        either = "one of the two: through a camera the perspective is fitted anyway"
        refuse(arguments, "--perspective", why="beside --camera", expected=either)
    mark, files = parse_mark(arguments.mark), picture_files(arguments.pictures)
    if arguments.output and len(files) > 1:
        raise BadValue("--output", arguments.output, "left out for several pictures")
    white = white_as_asked(arguments, files)
    found: dict[str, list[FoundMark]] = {}
    short: list[str] = []
    with progress("finding marks", len(files)) as step:
        for file in files:
            try:
                found[file] = _find(arguments, mark, file, white)
            except TooFewMarks as error:
                found[file] = []
                short.append(f"{file}: {error}")
            step()
    _report(arguments, mark, found)
    for message in short:
        say(message)
    return 0 if all(found.values()) else NO


def _find(arguments: argparse.Namespace, mark: Mark, file: str, white: float | None) -> list[FoundMark]:
    from cadcam.errors import SizeMismatch
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.image.picture import to_gray
    from cadcam.target.marks.find import MarkOptions, find_marks

    gray = to_gray(read_camera_picture(file, full_scale=white))
    camera = None
    if arguments.camera:
        camera = read_any_camera(arguments.camera).camera
        if camera.size != gray.shape[::-1]:
            raise SizeMismatch(file, gray.shape[::-1], camera.size)
    radius = arguments.radius
    if radius and (len(radius) > 2 or min(radius) <= 0 or radius[0] > radius[-1]):
        raise BadValue("--radius", repr(",".join(f"{r:g}" for r in radius)), "one radius in px, or least,greatest")
    options = MarkOptions(
        method=arguments.method,
        subpixel=arguments.subpixel,
        perspective=arguments.perspective,
        least_score=arguments.least_score,
        margin=arguments.margin,
        any_number=arguments.any_number,
    )
    marks = find_marks(
        gray,
        mark,
        radius_px=None if not radius else radius[0] if len(radius) == 1 else (radius[0], radius[1]),
        count=arguments.count,
        camera=camera,
        options=options,
    )
    if arguments.output:
        _write_overlay(arguments.output, gray, mark, marks)
    return marks


def _report(arguments: argparse.Namespace, mark: Mark, found: dict[str, list[FoundMark]]) -> None:
    from cadcam.report.targets import marks_as_json, marks_csv, marks_table
    from cadcam.whole import utf8, write_whole

    if arguments.csv:
        write_whole(arguments.csv, utf8(marks_csv(found)))
    if arguments.json:
        print_json(marks_as_json(str(mark), found))
    else:
        print_tables([marks_table(f"{file}: {len(marks)} x {mark}", marks) for file, marks in found.items()])
    say_written(arguments.csv, arguments.output)


def _write_overlay(path: str, gray: Picture, mark: Mark, marks: list[FoundMark]) -> None:
    """Write the picture with each mark's outermost border, its centre and its place in the list."""
    from cadcam.image.draw import draw_points, draw_polylines, draw_text
    from cadcam.image.picture import write_picture

    thick = max(1.0, max(gray.shape) / 900)
    sure = [one for one in marks if not one.flags]
    doubtful = [one for one in marks if one.flags]
    picture = gray
    for some, color in ((sure, (0.1, 0.9, 0.2)), (doubtful, (1.0, 0.6, 0.0))):
        picture = draw_polylines(picture, [one.outline(mark.radius) for one in some], color=color, width=1.2 * thick)
        if some:
            centres = [one.pixel for one in some]
            picture = draw_points(picture, centres, color=(1, 0, 0), mark="plus", size=7 * thick, width=thick)
    for i, one in enumerate(marks if len(marks) <= 200 else []):
        text = str(i + 1) if one.number is None else f"#{one.number}"
        at = one.pixel + (one.size + 3) * math.sqrt(0.5)
        picture = draw_text(picture, at, text, color=(1.0, 0.85, 0.0), height=11 * thick)
    write_picture(Path(path), picture)
