"""`cadcam handeye`: robot poses and pictures taken there -> the camera's pose on or beside the robot, with sigmas."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cadcam.cli.arguments import (
    POINTS_OPTIONS,
    Verbs,
    add_json,
    add_points_options,
    names,
    read_points_as_asked,
    refuse,
    verb,
)
from cadcam.cli.boards import BOARD_HELP, found_boards
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written, working
from cadcam.cli.photos import picture_files
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.errors import BadValue, CadcamError, UnknownName, UnreadableFile
from cadcam.image.suffixes import READABLE

if TYPE_CHECKING:
    from cadcam.calibrate.handeye.estimate import HandEyeEstimate
    from cadcam.camera.camera import Camera
    from cadcam.camera.estimate import CameraEstimate
    from cadcam.camera.observations import Observations
    from cadcam.files.robot_poses import RobotNumbers
    from cadcam.geometry.rigid import Rigid

Seen = TypeVar("Seen")

_DESCRIPTION = """\
Find where a camera sits on a robot's flange (eye-in-hand) or stands in its cell (eye-to-hand), from ten or more robot
poses and the pictures of one target taken there. No starting values are needed. Beforehand it is tested whether robot
and camera moved alike: wrong order, direction, rotation convention, unit or single poses, and motions that leave a
direction open, are refused with the evidence. The robot's own noise is estimated: every pose may be off by as much, so
that its errors are not charged to the camera. Good poses turn the flange by 20 to 40 deg about at least two axes."""

_EXAMPLES = f"""\
  cadcam handeye r.csv --convention ur --mounting eye-in-hand --camera c.json --views shots/ --board chessboard:9x6:25mm
  cadcam handeye robot.csv --convention kuka --mounting eye-in-hand --camera camera.json --views seen/ -o handeye.json
  cadcam handeye robot.txt --mounting eye-in-hand --camera camera.json --views seen/*.csv       which convention fits?
  cadcam handeye poses/ --convention ros --mounting eye-to-hand --camera-poses target.csv       poses, no pixels

robot poses: base_from_flange, one per line, with or without column names and a name in front; or JSON; or a folder
  name,X,Y,Z,A,B,C                       kuka    mm, deg: A about Z, B about Y', C about X''
  p1,512.31,-20.9,402.2,178.1,1.2,-90.3  fanuc yaskawa staubli kawasaki  mm, deg      abb  mm, quaternion w first
                                         ur  m, rotation vector    ros  m, quaternion w last
                                         rotation-vector quaternion-wxyz quaternion-xyzw matrix   say --robot-unit
views: one picture of the --board a pose, or one points file, X Y Z on the target and x_px y_px in its picture (cadcam
calibrate --help); paired with the robot's poses by name (file p1.png or p1.csv, pose p1), or in order where the poses
have no names. Poses whose picture does not show the board are not used.
camera poses: camera_from_world, the target being the world, one per line as in `cadcam render --poses`

{BOARD_HELP}"""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "handeye",
        run,
        short="robot poses and what the camera saw there -> where the camera is mounted",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    _add_robot(parser)
    _add_camera(parser)
    add_full_scale(parser)
    parser.add_argument("--leave-out", type=names, default=(), metavar="A,B", help="names of poses not to use")
    parser.add_argument("-o", "--output", metavar="FILE", help="result to write (.json)")
    add_points_options(parser)
    add_json(parser)


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "robot", nargs="+", metavar="ROBOT", help="file or folder of robot poses, or files of one pose each"
    )
    parser.add_argument(
        "--mounting", required=True, choices=("eye-in-hand", "eye-to-hand"), help="camera on the flange, or in the cell"
    )
    parser.add_argument(
        "--convention",
        metavar="NAME",
        help="how the robot writes poses (below); if left out, list those that fit and stop",
    )
    parser.add_argument("--robot-unit", metavar="U", help="unit of the robot's positions: mm, m ... (default: its own)")
    parser.add_argument("--inverted", action="store_true", help="the file holds flange_from_base")


def _add_camera(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--camera", metavar="FILE", help="camera file; its internals are held")
    parser.add_argument(
        "--adjust-internals", action="store_true", help="let the internals move within the camera file's own covariance"
    )
    seen = parser.add_mutually_exclusive_group(required=True)
    seen.add_argument(
        "--views", nargs="+", metavar="FILE", help="pictures of the --board, or points files: one per pose, or a folder"
    )
    seen.add_argument(
        "--camera-poses", metavar="FILE", help="poses of the target in the camera frame, instead of pixels"
    )
    parser.add_argument("--board", metavar="BOARD", help="the board in the pictures, such as chessboard:9x6:25mm")


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, print, write."""
    from cadcam.calibrate.handeye.document import hand_eye_as_json, write_hand_eye
    from cadcam.report.handeye import hand_eye_tables

    check_target(arguments.output, (".json",))
    estimate = _estimate(arguments)
    if arguments.output:
        write_hand_eye(arguments.output, estimate)
    if arguments.json:
        print_json(hand_eye_as_json(estimate))
    else:
        print_tables(hand_eye_tables(estimate))
    say_written(arguments.output)


def _estimate(arguments: argparse.Namespace) -> HandEyeEstimate:
    from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye, calibrate_hand_eye_from_poses, target_poses
    from cadcam.files.poses import read_poses
    from cadcam.files.robot_poses import read_robot_numbers
    from cadcam.geometry.rigid import Rigid

    robot = read_robot_numbers(*arguments.robot)
    if arguments.camera_poses:
        unused = ("--board", "--camera", "--adjust-internals", "--full-scale", *POINTS_OPTIONS)
        poses_alone = "none: poses need no camera and no pictures"
        refuse(arguments, *unused, why="beside --camera-poses", expected=poses_alone)
        labels, robot, poses = _paired(arguments, robot, read_poses(arguments.camera_poses))
        seen = Rigid.stack(poses)
        flange = _base_from_flange(arguments, robot, lambda: seen)
        with working(f"estimating from {len(labels)} poses"):
            return calibrate_hand_eye_from_poses(flange, seen, mounting=arguments.mounting, names=labels)
    if arguments.board:
        refuse(arguments, *POINTS_OPTIONS, why="beside --board", expected="none: no points files are read")
    else:
        refuse(arguments, "--full-scale", why="without --board", expected="--board and pictures of it, or leave it out")
    camera = _camera(arguments)
    found = _boards(arguments, camera) if arguments.board else _views(arguments)
    labels, robot, views = _paired(arguments, robot, found)
    flange = _base_from_flange(arguments, robot, lambda: target_poses(views, _held(camera), names=labels))
    with working(f"estimating from {len(labels)} poses and their pictures"):
        return calibrate_hand_eye(flange, views, camera, mounting=arguments.mounting, names=labels)


def _base_from_flange(arguments: argparse.Namespace, robot: RobotNumbers, seen: Callable[[], Rigid]) -> Rigid:
    """Return the robot's poses in the named convention; without one, print which fit, and refuse."""
    if arguments.convention is not None:
        poses = robot.poses(arguments.convention, unit=arguments.robot_unit)
        return poses.inv if arguments.inverted else poses
    from cadcam.calibrate.handeye.conventions import conventions_that_fit
    from cadcam.report.handeye import convention_table

    poses, stated = seen(), arguments.robot_unit or robot.unit
    readings, units = _readings(robot, dict.fromkeys(robot.possible, stated))
    fits = conventions_that_fit(readings, poses, mounting=arguments.mounting)
    guessed = {f.convention: _nearest_unit(f.scale) for f in fits if f.fits and not units[f.convention]}
    if guessed:  # the camera's lengths determine the unit of the robot's
        readings, units = _readings(robot, dict.fromkeys(robot.possible, stated) | guessed)
        fits = conventions_that_fit(readings, poses, mounting=arguments.mounting)
    print_tables([convention_table(fits, units)])
    good = [_as_options(f.convention, f.inverted, guessed.get(f.convention)) for f in fits if f.fits]
    raise BadValue(
        "--convention",
        "not given",
        f"one that the camera's motion allows: {', '.join(good)}"
        if good
        else "one that the camera's motion allows, but none does: are pictures and poses paired rightly?",
    )


def _readings(robot: RobotNumbers, stated: Mapping[str, str | None]) -> tuple[dict[str, Rigid], dict[str, str]]:
    """Return the poses by convention, and the unit of each: as stated, else the convention's own, else "" (for mm)."""
    from cadcam.files.robot_conventions import CONVENTIONS

    readings, units = {}, {}
    for name, unit in stated.items():
        units[name] = unit or CONVENTIONS[name].unit
        with suppress(CadcamError):  # an invalid matrix, a unit out of range: not this convention
            readings[name] = robot.poses(name, unit=units[name] or "mm")
    return readings, units


def _nearest_unit(scale: float) -> str:
    """Return the unit of lengths that were read as mm and come out `scale` times as long as the camera's."""
    import math

    from cadcam.cad.units import MM

    return min(("mm", "cm", "m", "in"), key=lambda unit: abs(math.log(max(scale, 1e-9) * MM[unit])))


def _as_options(convention: str, inverted: bool, unit: str | None) -> str:
    return f"{convention}{f' --robot-unit {unit}' if unit else ''}{' --inverted' * inverted}"


def _held(camera: Camera | CameraEstimate) -> Camera:
    from cadcam.camera.estimate import CameraEstimate

    return camera.camera if isinstance(camera, CameraEstimate) else camera


def _camera(arguments: argparse.Namespace) -> Camera | CameraEstimate:
    from cadcam.camera.extended_pinhole import EXTERNALS

    if not arguments.camera:
        raise BadValue("--camera", "not given", "the camera file of the camera that took the views")
    file = read_any_camera(arguments.camera)
    if not arguments.adjust_internals:
        return file.camera
    if file.estimate is None:
        raise UnreadableFile(arguments.camera, "has no estimate, so no covariance to adjust internals within")
    if not set(file.estimate.free) - set(EXTERNALS):
        raise BadValue(
            "--adjust-internals",
            f"beside {arguments.camera}, of which only the pose was estimated",
            "the camera file of a calibration, or left out: its internals have no covariance to move within",
        )
    return file.estimate


def _boards(arguments: argparse.Namespace, camera: Camera | CameraEstimate) -> dict[str, Observations | None]:
    """Return the detection of the board in each picture, by the stem of its file, None where it is not visible."""
    from cadcam.calibrate.boards.pictures import board_views
    from cadcam.target.boards.pattern import parse_pattern

    pattern = parse_pattern(arguments.board)
    files = _by_stem([Path(file) for file in picture_files(arguments.views)])
    named = [str(file) for file in files.values()]
    found = found_boards(named, pattern, white_as_asked(arguments, named))
    for picture in found:
        if picture.detection is None:
            say(f"{picture.name}: {picture.problem}; its pose is not used")
    if pattern.turns > 1:
        say(f"{pattern} looks the same after a turn: it is taken as upright in every picture, so keep the camera so")
    return dict(zip(files, board_views(found, _held(camera)), strict=True))


def _by_stem(files: Sequence[Path]) -> dict[str, Path]:
    """Return the files by their stems, in the order of the last numbers in them."""
    stems: dict[str, Path] = {}
    for file in sorted(files, key=_by_number):
        if file.stem in stems:
            raise UnreadableFile(file, f"is the second file called {file.stem!r}", "give each pose one")
        stems[file.stem] = file
    return stems


def _views(arguments: argparse.Namespace) -> dict[str, Observations | None]:
    """Return the observations by the stem of their files."""
    files = [Path(v) for v in arguments.views]
    if pictures := [f for f in files if f.suffix.lower() in READABLE]:
        raise BadValue("points file", f"the picture {pictures[0]}", "a text file; or --board BOARD for pictures of one")
    if len(files) == 1 and files[0].is_dir():
        folder = files[0]
        files = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".csv", ".txt"))
        if not files:
            raise UnreadableFile(folder, "holds no points file (.csv, .txt)", "name the right folder; or --board BOARD")
    return {stem: read_points_as_asked(arguments, str(file)) for stem, file in _by_stem(files).items()}


def _paired(
    arguments: argparse.Namespace, robot: RobotNumbers, seen: Mapping[str, Seen | None]
) -> tuple[tuple[str, ...], RobotNumbers, list[Seen]]:
    """Return names, the robot's poses and the observations, row by row, without those to leave out or unseen."""
    rows = _rows(robot, list(seen))
    for name in arguments.leave_out:
        if name not in rows:
            raise UnknownName("pose to leave out", name, rows)
    kept = {name: what for name in rows if name not in arguments.leave_out and (what := seen[name]) is not None}
    return tuple(kept), robot.some([rows[name] for name in kept]), list(kept.values())


def _rows(robot: RobotNumbers, seen: list[str]) -> dict[str, int]:
    """Return the robot's row of each picture: by name, by the number in the names, or in order where there are none."""
    count = len(robot.numbers)
    if not any(robot.names):
        if count != len(seen):
            remedy = f"give one of each picture, {len(seen)} in all; or name the picture of each"
            raise UnreadableFile(robot.path, f"has {count} poses", remedy)
        return dict(zip(seen, range(count), strict=True))
    by_name = {name: i for i, name in enumerate(robot.names)}
    if not set(by_name) & set(seen) and (rows := _rows_by_number(robot, seen)):
        say("poses and pictures have no names in common; paired by the numbers in them")
        return rows
    lost = next((name for name in seen if name not in by_name), None)
    if lost is not None:
        raise UnreadableFile(robot.path, f"has no pose {lost!r}", f"its poses are {', '.join(list(by_name)[:8])} ...")
    if len(seen) < count:
        say(f"{count - len(seen)} of {count} robot poses have no picture and are not used")
    return {name: by_name[name] for name in seen}


def _rows_by_number(robot: RobotNumbers, seen: Sequence[str]) -> dict[str, int]:
    """Return the row of each picture by the last numbers in the names; empty where these do not pair all of them."""
    rows = {_by_number(Path(name))[0]: row for row, name in enumerate(robot.names)}
    own = {name: _by_number(Path(name))[0] for name in seen}
    unique = len(rows) == len(robot.names) and len(set(own.values())) == len(own)
    return {name: rows[n] for name, n in own.items()} if unique and set(own.values()) <= set(rows) else {}


def _by_number(path: Path) -> tuple[int, str]:
    """Sort key: the last number in a name, then the name."""
    digits = re.findall(r"\d+", path.stem)
    return (int(digits[-1]) if digits else -1, path.stem)
