"""`cadcam calibrate --board`: pictures of a calibration board -> camera file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import refuse
from cadcam.cli.estimating import fixed_as_asked, lens_as_asked
from cadcam.cli.output import (
    check_folder,
    check_target,
    print_json,
    print_tables,
    progress,
    refuse_own_folder,
    say,
    working,
)
from cadcam.cli.photos import picture_files
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.calibrate.boards.pictures import BoardCalibration, BoardPicture
    from cadcam.target.boards.board import Pattern

BOARD_HELP = """\
boards (cadcam board prints one):
  chessboard:9x6:25mm               inner corners (one less than squares each way): side of a square
  charuco:8x11:20mm:15mm:5X5_100    squares: side of a square: side of a marker: OpenCV's dictionary[:legacy]
  circles:7x6:30mm[:12mm]           discs: distance of centres[: diameter; measured if it is left out]
  staggered-circles:4x11:20mm       discs, every second row shifted: distance of rows (OpenCV's asymmetric grid)
"""


def add_board_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for calibrating from pictures of a board."""
    group = parser.add_argument_group("pictures of a board")
    group.add_argument("--board", metavar="BOARD", help="the board in the pictures, such as chessboard:9x6:25mm")
    add_full_scale(group)
    group.add_argument("--free-skew", action="store_true", help="estimate the skew too (held at 0 otherwise)")
    group.add_argument("--keep-all", action="store_true", help="keep outlier points and outlier pictures")
    group.add_argument(
        "--pictures", metavar="FOLDER", help="write each picture with the points found in it there, and coverage.png"
    )


def run_boards(arguments: argparse.Namespace) -> None:
    """Find the board in all pictures, calibrate, print, write."""
    from cadcam.calibrate.boards.coverage import coverage
    from cadcam.calibrate.boards.next_view import next_views
    from cadcam.calibrate.boards.pictures import calibrate_boards
    from cadcam.calibrate.joint.nested import nested_advice
    from cadcam.report.boards import board_tables, boards_as_json
    from cadcam.target.boards.pattern import parse_pattern

    _check_options(arguments)
    pattern, files = parse_pattern(arguments.board), picture_files(arguments.points)
    refuse_own_folder(arguments.pictures, files)
    model = board_model_as_asked(arguments)
    white = white_as_asked(arguments, files)
    found = found_boards(files, pattern, white)
    if arguments.pictures:
        _write_found(arguments.pictures, found, white)
    with working(f"estimating one camera from {len(files)} pictures"):
        calibration = calibrate_boards(found, bend=arguments.bend, **model)
        seen, views = coverage(calibration), next_views(calibration)
        nested = None if arguments.no_advice else nested_advice(calibration.fit)
    written = _written(arguments, calibration)
    if arguments.json:
        advice = {} if nested is None else {"advice": [q.verdict for q in nested.questions]}
        print_json(boards_as_json(calibration, seen, views) | advice)
    else:
        print_tables(board_tables(calibration, seen, views, nested))
    for line in written:
        say(line)


def board_model_as_asked(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return fixed, lens, free_lens and keep_all, as for `calibrate_boards`: no skew unless --free-skew."""
    lens, free_lens = lens_as_asked(arguments)
    fixed = fixed_as_asked(arguments)
    return {
        "fixed": fixed if arguments.free_skew else {"skew": 0.0} | fixed,
        "lens": lens,
        "free_lens": None if lens is None else free_lens,
        "keep_all": arguments.keep_all,
    }


def found_boards(files: Sequence[str], pattern: Pattern, white: float | None) -> list[BoardPicture]:
    """Return the detection of the board in each picture; white: as `white_as_asked` gives it."""
    from cadcam.calibrate.boards.pictures import find_board

    found = []
    with progress("finding the board", len(files)) as step:
        for file in files:
            found.append(find_board(file, pattern, full_scale=white))
            step()
    return found


def _check_options(arguments: argparse.Namespace) -> None:
    check_target(arguments.output, (".json",))
    check_target(arguments.poses_out, (".csv", ".txt"))
    beside = "beside --board"
    pictures_say = "neither: the pictures say their size, and all is estimated"
    refuse(arguments, "--size", "--photo", "--internals", why=beside, expected=pictures_say)
    by_rule = "none: strays and outliers are left out by rule (--keep-all)"
    refuse(arguments, "--loss", why=beside, expected=by_rule)
    if arguments.method != "reprojection":
        raise BadValue("--method", arguments.method, "'reprojection' beside --board")
    check_folder(arguments.pictures)


def _write_found(folder: str, found: Sequence[BoardPicture], white: float | None) -> None:
    """Write each picture with its points: first ones red, a line along the rows."""
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.image.draw import draw_points, draw_polylines
    from cadcam.image.picture import write_picture

    for number, one in enumerate(found):
        picture = read_camera_picture(one.name, full_scale=white)
        if one.detection is not None:
            thick = max(one.size) / 640
            q = one.detection.q
            picture = draw_polylines(picture, [q], color=(1.0, 0.85, 0.0), width=thick, opacity=0.6)
            picture = draw_points(picture, q, color=(0.1, 0.9, 0.2), size=9 * thick, width=1.5 * thick)
            picture = draw_points(picture, q[:1], color=(1, 0, 0), mark="circle", size=14 * thick, width=2 * thick)
        state = "found" if one.detection is not None else "not-found"
        write_picture(Path(folder) / f"{number:03d}_{Path(one.name).stem}_{state}.png", picture)


def _written(arguments: argparse.Namespace, calibration: BoardCalibration) -> list[str]:
    """Write the files of -o, --pictures and --poses-out; return what was written, one line each."""
    from cadcam.calibrate.boards.coverage import coverage_picture
    from cadcam.files.camera import write_camera
    from cadcam.files.poses import write_poses
    from cadcam.image.picture import write_picture

    estimate, said = calibration.estimate, []
    if arguments.output:
        write_camera(arguments.output, estimate.view(0))
        said.append(f"wrote {arguments.output} (the pose in it is that of {estimate.views[0].source})")
    if arguments.pictures:
        write_picture(Path(arguments.pictures) / "coverage.png", coverage_picture(calibration))
        said.append(f"wrote {len(calibration.pictures)} pictures and coverage.png into {arguments.pictures}")
    if arguments.poses_out:
        names = [Path(view.source).name for view in estimate.views]
        if len(set(names)) < len(names):  # pictures of one name in several folders
            names = list(estimate.names)
        write_poses(arguments.poses_out, {name: estimate.pose(j) for j, name in enumerate(names)})
        said.append(f"wrote {arguments.poses_out}: {len(names)} poses")
    return said
