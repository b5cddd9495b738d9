"""`cadcam rig`: simultaneous pictures of several cameras on one mount -> their relative poses."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.arguments import (
    POINTS_OPTIONS,
    Verbs,
    add_json,
    add_points_options,
    check_in_picture,
    read_points_as_asked,
    refuse,
    size,
    verb,
)
from cadcam.cli.boards import BOARD_HELP, board_model_as_asked
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.estimating import fixed_as_asked, lens_as_asked
from cadcam.cli.output import check_target, print_json, print_tables, progress, say, working
from cadcam.cli.photos import picture_files
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.image.suffixes import READABLE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cadcam.calibrate.boards.pictures import BoardCalibration
    from cadcam.camera.camera import Camera
    from cadcam.camera.rig_estimate import RigEstimate

_POINTS = (".csv", ".txt", ".tsv", ".dat")

_EXAMPLES = f"""\
  cadcam rig --camera left=left/ --camera right=right/ --board chessboard:9x6:25mm -o rig.json
  cadcam rig --camera left='shots/left*.jpg' --camera right='shots/right*.jpg' --board chessboard:9x6:25mm
  cadcam rig --camera a=a/ --camera b=b/ --camera c=c/ --board charuco:8x11:20mm:15mm:5X5_100 --internals b=b.json
  cadcam rig --camera left=left/ --camera right=right/ --size 640x480 --lens brown-conrady:k1,k2 --fix skew=0
                                                                    folders of points files, one per frame
  cadcam measure pixels.csv --rig rig.json                          then: points in the axes of the first camera

frames: pictures (or points files) of one name in every folder were taken at the same moment, and a camera may lack
some. Where the names differ from camera to camera (left01.jpg, right01.jpg), the n-th of each are a frame, and every
camera needs as many.

points file: as for `cadcam calibrate`; the world is the board's (or the field's) and the same for all cameras.

{BOARD_HELP}"""
_DESCRIPTION = """\
Calibrate cameras that are rigidly mounted together (a stereo pair, a ring of cameras). All took pictures of a board, or
saw known points, at the same moments. Internals and lens of each camera, where each is mounted, and where the rig was
in each frame are estimated together, each with its standard deviation; the first camera's axes are those of the rig. No
starting values are needed. The cameras need not see the board in every frame, but each must share some frames with
another one, and be seen well enough to be calibrated alone (three pictures of a board, tilted differently), or be
--internals.

Frames that were not taken together (files in another order, pictures exchanged) show another relative pose than the
rest; they are refused and named. With a board that looks the same after half a turn (an even number of squares by an
even one, most circle grids) the cameras must stand roughly upright to each other: a chessboard with one side even and
one odd, or a ChArUco board, avoids this ambiguity."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "rig",
        run,
        short="pictures or points of cameras mounted together -> their relative poses, with covariance",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument(
        "--camera",
        action="append",
        default=[],
        required=True,
        metavar="NAME=FILES",
        help="a camera and its pictures or points files: a folder, or a quoted pattern; twice or more",
    )
    parser.add_argument("--board", metavar="BOARD", help="the board in the pictures, such as chessboard:9x6:25mm")
    parser.add_argument("-o", "--output", metavar="FILE", help="rig file to write (.json)")
    parser.add_argument(
        "--poses-out", metavar="FILE", help="write camera_from_world of the first camera in every frame (.txt, .csv)"
    )
    add_full_scale(parser)
    _add_camera_options(parser.add_argument_group("cameras"))
    add_points_options(parser)
    add_json(parser)


def _add_camera_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--size", type=size, metavar="WxH", help="picture size in px, for points files")
    group.add_argument(
        "--internals",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="keep the internals and lens of this camera file",
    )
    group.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter of all cameras: skew degrees, aspect, focal U0 V0 px; may be repeated",
    )
    group.add_argument(
        "--lens",
        metavar="MODEL:TERMS",
        help="lens of all cameras, as in `cadcam calibrate` (default: ideal; for boards brown-conrady:k1,k2,p1,p2)",
    )
    group.add_argument("--free-skew", action="store_true", help="boards: estimate the skew too (held at 0 otherwise)")
    group.add_argument("--keep-all", action="store_true", help="boards: keep outlier points and outlier pictures")


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, print, write."""
    from cadcam.files.poses import write_poses
    from cadcam.files.rig import rig_as_json, write_rig
    from cadcam.report.rig import rig_tables

    check_target(arguments.output, (".json",))
    check_target(arguments.poses_out, (".txt", ".csv"))
    named = _named("--camera", arguments.camera)
    frames, files = _frames({name: _files(path, arguments.board) for name, path in named.items()})
    known = _known(arguments.internals, named)
    alone = None
    if arguments.board:
        estimate, alone = _from_boards(arguments, frames, files, known)
    else:
        estimate = _from_points(arguments, frames, files, known)
    if arguments.output:
        write_rig(arguments.output, estimate)
    if arguments.poses_out:
        write_poses(arguments.poses_out, {name: estimate.frame(j) for j, name in enumerate(estimate.frames)})
    if arguments.json:
        print_json(rig_as_json(estimate))
    else:
        print_tables(rig_tables(estimate, alone))
    if arguments.output:
        say(f"wrote {arguments.output}: measure with it by cadcam measure PIXELS --rig {arguments.output}")
    if arguments.poses_out:
        say(f"wrote {arguments.poses_out}: the first camera in {len(estimate.frames)} frames")


def _from_boards(
    arguments: argparse.Namespace,
    frames: Sequence[str],
    files: Mapping[str, Sequence[str | None]],
    known: Mapping[str, Camera],
) -> tuple[RigEstimate, Mapping[str, BoardCalibration]]:
    from cadcam.calibrate.boards.pictures import BoardPicture, find_board
    from cadcam.calibrate.rig.boards import calibrate_rig_boards
    from cadcam.target.boards.pattern import parse_pattern

    refuse(arguments, "--size", why="beside --board", expected="none: the pictures say their size")
    refuse(arguments, *POINTS_OPTIONS, why="beside --board", expected="none: no points files are read")
    pattern = parse_pattern(arguments.board)
    whites = {name: white_as_asked(arguments, [file for file in row if file]) for name, row in files.items()}
    found: dict[str, list[BoardPicture | None]] = {name: [] for name in files}
    with progress("finding the board", sum(len(row) for row in files.values())) as step:
        for name, row in files.items():
            for file in row:
                found[name].append(None if file is None else find_board(file, pattern, full_scale=whites[name]))
                step()
    model = board_model_as_asked(arguments)
    with working(f"estimating a rig of {len(files)} cameras from {len(frames)} frames"):
        boards = calibrate_rig_boards(found, frames=frames, known=known, **model)
    return boards.estimate, boards.alone


def _from_points(
    arguments: argparse.Namespace,
    frames: Sequence[str],
    files: Mapping[str, Sequence[str | None]],
    known: Mapping[str, Camera],
) -> RigEstimate:
    from cadcam.calibrate.rig.adjustment import RigCamera, calibrate_rig

    pictures = "--board and pictures of it, or leave it out"
    refuse(arguments, "--free-skew", "--keep-all", "--full-scale", why="without --board", expected=pictures)
    if not arguments.size and len(known) < len(files):
        raise BadValue("the picture's size", "not given", "--size WxH, or --internals for every camera; or --board")
    lens, free_lens = lens_as_asked(arguments)
    fixed = fixed_as_asked(arguments)
    cameras = {}
    for name, row in files.items():
        views = [None if file is None else read_points_as_asked(arguments, file) for file in row]
        for view in filter(None, views):
            check_in_picture(view, known[name].size if name in known else arguments.size)
        if name in known:
            cameras[name] = RigCamera(views, known=known[name])
        else:
            cameras[name] = RigCamera(views, arguments.size, fixed, lens, free_lens)
    with working(f"estimating a rig of {len(files)} cameras from {len(frames)} frames"):
        return calibrate_rig(cameras, frames=frames)


def _frames(files: Mapping[str, Sequence[str]]) -> tuple[list[str], dict[str, list[str | None]]]:
    """Return the frames' names and each camera's file in each, None where it has none.

    Files of the same name are a frame; where no name occurs twice, the n-th files are, and each camera must have as
    many.
    """
    if len(files) < 2:
        raise BadValue(
            "--camera", f"given for {len(files)} camera", "two cameras or more; one by itself: cadcam calibrate"
        )
    stems = {name: {Path(file).stem: file for file in row} for name, row in files.items()}
    every = sorted(set().union(*stems.values()))
    if len(every) < sum(len(row) for row in stems.values()):
        for row in files.values():
            _refuse_second(row)
        return every, {name: [row.get(stem) for stem in every] for name, row in stems.items()}
    counts = {name: len(row) for name, row in files.items()}
    if len(set(counts.values())) > 1:
        from cadcam.calibrate.rig.adjustment import by_camera

        raise BadValue(
            "the number of files",
            by_camera(counts),
            "one number for all, as their names differ from camera to camera; or the same name for the same moment",
        )
    rows: dict[str, list[str | None]] = {name: list(row) for name, row in files.items()}
    return [" ".join(Path(f).stem for f in column) for column in zip(*files.values(), strict=True)], rows


def _refuse_second(row: Sequence[str]) -> None:
    """Raise `UnreadableFile` where two files of a camera have one name: only one of them could be the frame's."""
    first: dict[str, str] = {}
    for file in row:
        if (other := first.setdefault(Path(file).stem, file)) != file:
            remedy = "frames are told by the names of files: give each its own"
            raise UnreadableFile(file, f"has the name of {other}", remedy)


def _files(path: str, board: str | None) -> list[str]:
    if not Path(path).exists() and not set(path) & set("*?["):
        remedy = "check the path: a folder of points files; or pictures with --board"
        raise UnreadableFile(path, "no such file or folder", remedy)
    if board:
        return picture_files([path])
    if not Path(path).is_dir():
        raise BadValue("--camera", path, "a folder of points files; or pictures with --board")
    inside = sorted(Path(path).iterdir())
    files = [str(p) for p in inside if p.suffix.lower() in _POINTS]
    if not files and any(p.suffix.lower() in READABLE for p in inside):
        raise BadValue("--board", "not given", f"the board in the pictures in {path}, such as chessboard:9x6:25mm")
    if not files:
        raise UnreadableFile(path, "is a folder without points files", f"points files end in {' '.join(_POINTS)}")
    return files


def _known(given: Sequence[str], cameras: Mapping[str, str]) -> dict[str, Camera]:
    named = _named("--internals", given)
    for name in named:
        if name not in cameras:
            raise UnknownName("camera in --internals:", name, cameras)
    return {name: read_any_camera(path).camera for name, path in named.items()}


def _named(option: str, given: Sequence[str]) -> dict[str, str]:
    """Return the paths of NAME=PATH by name, each name once."""
    out: dict[str, str] = {}
    for text in given:
        name, equals, path = text.partition("=")
        if not (name and equals and path):
            raise BadValue(option, repr(text), "NAME=PATH such as left=left/")
        if name in out:
            raise BadValue(option, f"the name {name!r} twice", "a name of its own for each camera")
        out[name] = path
    return out
