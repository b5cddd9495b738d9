"""`cadcam calibrate`: points files or pictures of a board -> camera file; with known internals, the pose."""

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
    verb,
)
from cadcam.cli.boards import BOARD_HELP, add_board_options, run_boards
from cadcam.cli.estimating import (
    add_estimate_options,
    estimate_as_asked,
    fixed_as_asked,
    lens_as_asked,
    size_as_asked,
)
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written, working
from cadcam.errors import BadValue
from cadcam.image.suffixes import READABLE

if TYPE_CHECKING:
    from cadcam.camera.joint_estimate import JointEstimate

_OF_PICTURES = ("--free-skew", "--keep-all", "--pictures", "--full-scale")
_EXAMPLES = f"""\
  cadcam calibrate points.csv --photo photo.png -o camera.json
  cadcam calibrate points.csv --size 768x576 --fix skew=0 --fix aspect=1 --lens brown-conrady:k1 -o camera.json
  cadcam calibrate points.csv --internals camera.json -o posed.json        only that camera's new pose
  cadcam calibrate left.csv front.csv right.csv --size 768x576 --fix skew=0 --lens brown-conrady:k1 -o camera.json
                                                                           one camera from three positions
  cadcam calibrate images/*.png --board chessboard:9x6:25mm -o camera.json        pictures of a board
  cadcam calibrate images/ --board circles:7x6:30mm --pictures found --poses-out poses.csv
  cadcam calibrate table_2_7.csv --columns U2,V2 --size 768x576            a file with two image points per line

points file (CSV, tabs or blanks; # comments):
  name,X,Y,Z,x_px,y_px          X Y Z in mm (or X_m, X_in ..., or --points-unit); x_px the column, y_px the row,
  A1,0,80,-1040,159.0,187.1     (0, 0) the centre of the top-left pixel; U,V instead: U the row, V the column

{BOARD_HELP}"""
_DESCRIPTION = """\
Estimate a camera from world points and the pixels where they were seen: the eleven parameters of the extended pinhole
(position, three angles, focal length, aspect, skew, principal point), lens coefficients if asked for, and the standard
deviation of each. No starting values are needed; the global minimum of the reprojection error is found. A full
calibration takes six or more points that are not all in one plane; a pose with known internals takes four.

Several points files are several positions of one camera, or several poses of one board: internals and lens are shared,
each has its own pose. Flat boards suffice if they are seen tilted in different directions. The table then also says how
the views scatter, which of them are outliers, and which parameters they determine.

Pictures of a calibration board (--board), three at least: the board is found in each, and all are calibrated together.
Tilt it by 20 to 45 degrees in different directions, fill the picture, reach its corners; the last table says which
picture to add. The lens is Brown-Conrady with k1, k2, p1, p2 unless --lens says otherwise, the skew 0 unless
--free-skew."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "calibrate",
        run,
        short="points files, or pictures of a board -> camera file",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument(
        "points", nargs="+", metavar="POINTS", help="points file; several: one per position; with --board: pictures"
    )
    add_estimate_options(parser, required=False)
    parser.add_argument("-o", "--output", metavar="FILE", help="camera file to write (.json)")
    joint = parser.add_argument_group("several positions, or pictures of a board")
    joint.add_argument("--poses-out", metavar="FILE", help="write camera_from_world of every position (.txt, .csv)")
    joint.add_argument("--bend", action="store_true", help="the flat board is bowed: estimate by how much, in x and y")
    joint.add_argument(
        "--loss",
        choices=("huber", "cauchy", "tukey"),
        help="robust loss that tolerates outliers (default: least squares)",
    )
    joint.add_argument("--no-advice", action="store_true", help="do not check which parameters the views determine")
    add_board_options(parser)
    add_points_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, print, write."""
    if arguments.board:
        refuse(arguments, *POINTS_OPTIONS, why="beside --board", expected="none: no points files are read")
        run_boards(arguments)
        return
    if pictures := [path for path in arguments.points if Path(path).suffix.lower() in READABLE]:
        raise BadValue("points file", f"the picture {pictures[0]}", "a text file; or --board BOARD for pictures of one")
    of_a_board = "--board and pictures of it, or leave it out"
    refuse(arguments, *_OF_PICTURES, why="without --board", expected=of_a_board)
    if not (arguments.size or arguments.photo or arguments.internals):
        raise BadValue(
            "the picture's size", "not given", "one of --size WxH, --photo FILE, --internals FILE; or --board"
        )
    if len(arguments.points) > 1:
        _run_jointly(arguments)
        return
    several = "points files of several positions"
    refuse(arguments, "--poses-out", "--bend", "--loss", "--no-advice", why="for one points file", expected=several)
    _run_alone(arguments, arguments.points[0])


def _run_jointly(arguments: argparse.Namespace) -> None:
    from cadcam.calibrate.joint.adjustment import estimate_of, fit_jointly
    from cadcam.calibrate.joint.nested import nested_advice
    from cadcam.files.joint import joint_as_json
    from cadcam.fit.robust import Loss
    from cadcam.report.joint import joint_tables

    one = "one points file at a time"
    refuse(arguments, "--internals", "--method", why="for several points files", expected=one)
    check_target(arguments.output, (".json",))
    check_target(arguments.poses_out, (".txt", ".csv"))
    views, size = [read_points_as_asked(arguments, path) for path in arguments.points], size_as_asked(arguments)
    for view in views:
        check_in_picture(view, size)
    lens, free_lens = lens_as_asked(arguments)
    with working(f"estimating one camera from {len(views)} positions"):
        fit = fit_jointly(
            views,
            size,
            fixed=fixed_as_asked(arguments),
            lens=lens,
            free_lens=free_lens,
            bend=arguments.bend,
            loss=Loss(arguments.loss) if arguments.loss else None,
        )
        advice = None if arguments.no_advice or arguments.loss else nested_advice(fit)
    estimate = estimate_of(fit)
    written = _written(arguments, estimate)
    if arguments.json:
        advice_part = {} if advice is None else {"advice": [q.verdict for q in advice.questions]}
        print_json(joint_as_json(estimate) | advice_part)
    else:
        print_tables(joint_tables(estimate, advice))
    for line in written:
        say(line)


def _written(arguments: argparse.Namespace, estimate: JointEstimate) -> list[str]:
    """Write the files of -o and --poses-out; return what was written, one line each."""
    from cadcam.files.camera import write_camera
    from cadcam.files.poses import write_poses

    said = []
    if arguments.output:
        write_camera(arguments.output, estimate.view(0))
        said.append(f"wrote {arguments.output}: the camera with the joint covariance, posed as in {estimate.names[0]}")
    if arguments.poses_out:
        write_poses(arguments.poses_out, {name: estimate.pose(j) for j, name in enumerate(estimate.names)})
        said.append(f"wrote {arguments.poses_out}: {len(estimate.names)} poses")
    return said


def _run_alone(arguments: argparse.Namespace, path: str) -> None:
    from cadcam.calibrate.points.held import held_against
    from cadcam.files.camera import camera_as_json, write_camera
    from cadcam.report.camera import estimate_tables, held_words

    check_target(arguments.output, (".json",))
    observations = read_points_as_asked(arguments, path)
    with working(f"estimating a camera from {len(observations)} points"):
        estimate = estimate_as_asked(arguments, observations)
        held = held_against(estimate, [text.partition("=")[0] for text in arguments.fix]) if arguments.fix else None
    if arguments.output:
        write_camera(arguments.output, estimate)
    if held is not None and held.contradicted:
        say(f"{path}: warning: {held_words(estimate, held)}")
    if arguments.json:
        print_json(camera_as_json(estimate))
    else:
        print_tables(estimate_tables(estimate))
    say_written(arguments.output)
