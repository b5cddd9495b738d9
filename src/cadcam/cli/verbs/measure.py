"""`cadcam measure`: pixels seen by calibrated cameras -> points in space with their uncertainty."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, names, numbers, pair, real, refuse, verb
from cadcam.cli.cameras import CameraFiles
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written
from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.camera.estimate import CameraEstimate
    from cadcam.camera.measurement import Measurement
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.files.camera import CameraFile
    from cadcam.files.pixels import ListedPixels
    from cadcam.geometry.plane import Plane

_EXAMPLES = """\
  cadcam measure pixels.csv --camera left=left.json --camera right=right.json -o points.csv
  cadcam measure pixels.csv --camera left.json --camera right.json --between A,B     views named as their files
  cadcam measure pixels.csv --rig rig.json                     cameras mounted together, in the axes of the first one
  cadcam measure pixels.csv --camera home=cam.json --moved away=home:motion.txt --motion-sigma 0.1,0.01
  cadcam measure pixels.csv --camera home=cam.json --placed away=home:posed.json     where points located it since
  cadcam measure pixels.csv --camera cam.json --plane 0,0,1,-1250 --plane-sigma 0.5   one camera, points on a plane

pixels file (CSV, tabs or blanks; # comments), a line for each point that a view saw:
  name,view,x_px,y_px          x_px the column, y_px the row, (0, 0) the centre of the top-left pixel;
  A,left,356.0,367.2           U,V instead: U the row, V the column
  A,right,369.8,360.0

motion file: a first line '# new_from_old, mm' (or old_from_new; or m, in ...), then a 3x4 or 4x4 matrix: where the
motion takes whatever is fixed to the camera, in world coordinates. A robot whose flange says base_from_flange moves it
by base_from_flange(new) x inverse of base_from_flange(old), if the world is its base.
"""
_DESCRIPTION = """\
Measure points in space. Each camera comes from `cadcam calibrate`, with its covariance; it stands where it was
calibrated, was moved from there by a known motion, or was placed anew. A point needs two views, or one and the plane it
lies on. Every point gets its standard deviations from the noise of its pixels, from the calibrations and from the
motions, including errors that they share: a distance between two points is usually known better than either point.
Camera files of the same content are one calibration, also under two names.
The gap between rays is compared with what these uncertainties allow; an input that must have been swapped, mirrored,
inverted or wrongly scaled is named."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "measure",
        run,
        short="pixels seen by calibrated cameras -> points in space, with covariance",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("pixels", metavar="PIXELS", help="pixels file (see below)")
    _add_view_options(parser)
    _add_point_options(parser)
    parser.add_argument("--columns", type=names, metavar="A,B", help="the two image columns, where there are several")
    parser.add_argument("-o", "--output", metavar="FILE", help="points to write: .csv, or .json with every covariance")
    parser.add_argument("--joint", action="store_true", help="in JSON, the covariance of all points together as well")
    add_json(parser)


def _add_view_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("views")
    group.add_argument(
        "--camera",
        action="append",
        default=[],
        metavar="VIEW=FILE",
        help="camera file (.json) with its pose; a view of that name, by default the file's; may be repeated",
    )
    group.add_argument(
        "--rig",
        metavar="FILE",
        help="rig file of `cadcam rig`: its cameras are views, the world is the first one's axes",
    )
    group.add_argument(
        "--moved",
        action="append",
        default=[],
        metavar="VIEW=OF:FILE",
        help="view of camera OF after the motion in a motion file",
    )
    group.add_argument(
        "--placed",
        action="append",
        default=[],
        metavar="VIEW=OF:FILE",
        help="view of camera OF where a pose file says, or a camera file from `calibrate --internals`",
    )
    group.add_argument(
        "--motion-sigma",
        metavar="MM,DEG",
        help="how well --moved and pose files of --placed are known: position and rotation, each axis (default exact)",
    )
    group.add_argument(
        "--sigma",
        type=real,
        metavar="PX",
        help="noise of one pixel coordinate (default: that of each camera's calibration)",
    )


def _add_point_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("points in space")
    group.add_argument(
        "--plane",
        metavar="NX,NY,NZ,D",
        help="the points lie on the plane NX X + NY Y + NZ Z = D, mm",
    )
    group.add_argument(
        "--plane-sigma",
        type=real,
        default=0.0,
        metavar="MM",
        help="how well the plane's height is known (default exact)",
    )
    group.add_argument(
        "--between",
        action="append",
        type=pair,
        default=[],
        metavar="A,B",
        help="distance between two points; may be repeated",
    )
    group.add_argument(
        "--method",
        default="reprojection",
        choices=("reprojection", "rays"),
        help="least weighted reprojection error (default), or the point nearest to all rays (for two, their middle)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Measure, print, write."""
    from cadcam.calibrate.measure.points import measure_points
    from cadcam.files.pixels import measurement_as_json, read_pixels, write_measurement
    from cadcam.report.measure import measurement_tables

    check_target(arguments.output, (".csv", ".json"))
    _check_options(arguments)
    pixels = read_pixels(arguments.pixels, columns=arguments.columns)
    viewpoints = _rig_viewpoints(arguments, pixels) if arguments.rig else _viewpoints(arguments, pixels)
    measured = measure_points(
        viewpoints,
        pixels.q,
        names=pixels.names,
        plane=_plane(arguments.plane),
        plane_sigma_mm=arguments.plane_sigma,
        method=arguments.method,
    )
    tables = measurement_tables(measured, viewpoints, arguments.between)
    if arguments.output:
        write_measurement(arguments.output, measured, pixels=pixels, joint=arguments.joint)
    if arguments.json:
        document = measurement_as_json(measured, pixels=pixels, joint=arguments.joint)
        print_json(document | {"distances_mm": _distances(measured, arguments.between)})
    else:
        print_tables(tables)
    if measured.refused:
        say(f"{len(measured.refused)} of {len(pixels.names)} points could not be measured")
    say_written(arguments.output)


def _distances(measured: Measurement, pairs: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    return [
        {"of": list(ends), "value": d.value, "sigma": d.sigma, "half_width_95": d.half_width}
        for ends, d in zip(pairs, measured.distances(pairs), strict=True)
    ]


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse uncertainties of absent inputs, and results that only JSON holds if none is written."""
    if arguments.sigma is not None and not arguments.sigma > 0:
        raise BadValue("--sigma", arguments.sigma, "a positive number of px")
    if not (arguments.moved or arguments.placed):
        moved = "--moved or --placed beside it: nothing else was moved"
        refuse(arguments, "--motion-sigma", why="without a motion", expected=moved)
    if arguments.plane is None:
        refuse(arguments, "--plane-sigma", why="without --plane", expected="both, or neither")
    if not (arguments.json or (arguments.output or "").lower().endswith(".json")):
        json = "--json or -o FILE.json: no table has room for it"
        refuse(arguments, "--joint", why="where no JSON is written", expected=json)


def _rig_viewpoints(arguments: argparse.Namespace, pixels: ListedPixels) -> list[Viewpoint]:
    """Return the rig's cameras in the order of the pixels file's views."""
    from cadcam.files.rig import read_rig

    views = "none: the rig's cameras are the views"
    refuse(arguments, "--camera", "--moved", "--placed", why="beside --rig", expected=views)
    known = {v.name: v for v in read_rig(arguments.rig).viewpoints(sigma_px=arguments.sigma)}
    for view in pixels.views:
        if view not in known:
            raise UnknownName(f"view in {pixels.source} (no camera of the rig has this name):", view, known)
    return [known[view] for view in pixels.views]


def _viewpoints(arguments: argparse.Namespace, pixels: ListedPixels) -> list[Viewpoint]:
    """Return the viewpoints in the order of the pixels file's views; each must be given."""
    files = CameraFiles()
    cameras = _cameras(arguments.camera, files)
    known = {
        name: _fixed(name, path, file, arguments.sigma)
        for name, (path, file) in cameras.items()
        if name in pixels.views
    }
    for option, make in (("--moved", _moved), ("--placed", _placed)):
        for text in getattr(arguments, option[2:]):
            view, home, path = _of(option, text)
            if view in known:
                raise BadValue(option, f"the view {view!r} a second time", "a name of its own for each view")
            if home not in cameras:
                raise UnknownName(f"camera in {option} {text}:", home, cameras)
            known[view] = make(view, _estimate(*cameras[home]), path, arguments, files)
    placed = [_of("--placed", text)[2] for text in arguments.placed]
    if not arguments.moved and all(path.lower().endswith(".json") and files.read(path).estimate for path in placed):
        why, poses = "where every file of --placed states how well it is known", "none, or a file that is a pose alone"
        refuse(arguments, "--motion-sigma", why=why, expected=poses)
    for view in pixels.views:
        if view not in known:
            raise UnknownName(
                f"view in {pixels.source} (no --camera, --moved or --placed gives it):", view, known or cameras
            )
    return [known[view] for view in pixels.views]


def _cameras(given: Sequence[str] | None, files: CameraFiles) -> dict[str, tuple[str, CameraFile]]:
    """Return path and content of each view's camera file; views of one file share the errors of its calibration."""
    if not given:
        raise BadValue("--camera", "not given", "a camera file for each view, or --rig FILE")
    cameras: dict[str, tuple[str, CameraFile]] = {}
    for text in given:
        name, path = _named(text)
        if name in cameras:
            raise BadValue("--camera", f"the view {name!r} twice", "one file for each view")
        cameras[name] = path, files.read(path)
    return cameras


def _fixed(name: str, path: str, file: CameraFile, sigma: float | None) -> Viewpoint:
    from cadcam.camera.viewpoint import Viewpoint

    if file.estimate is not None:
        return Viewpoint.fixed(name, file.estimate, sigma_px=sigma)
    if file.camera_from_world is None:
        raise BadValue(f"the pose in {path}", "missing", "a camera file with camera_from_world")
    if sigma is None:
        raise BadValue("--sigma", "not given", f"the pixels' noise in px: {path} holds no calibration that tells it")
    return Viewpoint.exact(name, file.camera, file.camera_from_world, sigma_px=sigma)


def _moved(view: str, home: CameraEstimate, path: str, arguments: argparse.Namespace, _files: CameraFiles) -> Viewpoint:
    from cadcam.camera.viewpoint import KnownMotion, Viewpoint
    from cadcam.files.matrix import read_motion

    motion = KnownMotion(read_motion(path))
    mm, rad = _sigmas(arguments.motion_sigma)
    motion = motion.known_to(mm, rad, about=home.camera_from_world.origin)
    return Viewpoint.moved(view, home, motion, sigma_px=arguments.sigma)


def _placed(view: str, home: CameraEstimate, path: str, arguments: argparse.Namespace, files: CameraFiles) -> Viewpoint:
    from cadcam.camera.viewpoint import KnownMotion, Viewpoint
    from cadcam.files.matrix import read_pose

    if path.lower().endswith(".json"):
        found = files.read(path).estimate
        if found is home:  # where it was calibrated: the pose errs with the internals, not once more by itself
            return Viewpoint.fixed(view, home, sigma_px=arguments.sigma)
        if found is not None:
            return Viewpoint.located(view, home, found, sigma_px=arguments.sigma)
    pose = read_pose(path)
    at_centre = KnownMotion(pose).known_to(*_sigmas(arguments.motion_sigma), about=pose.origin)
    return Viewpoint.placed(view, home, pose, pose_covariance=at_centre.covariance, sigma_px=arguments.sigma)


def _estimate(path: str, file: CameraFile) -> CameraEstimate:
    if file.estimate is None:
        raise BadValue(f"the calibration in {path}", "missing", "a camera file that `cadcam calibrate` wrote")
    return file.estimate


def _named(text: str) -> tuple[str, str]:
    from pathlib import Path

    name, equals, path = text.partition("=")
    return (name, path) if equals else (Path(text).stem, text)


def _of(option: str, text: str) -> tuple[str, str, str]:
    view, equals, rest = text.partition("=")
    home, colon, path = rest.partition(":")
    if not (view and equals and home and colon and path):
        raise BadValue(option, repr(text), "VIEW=CAMERA:FILE such as away=home:motion.txt")
    return view, home, path


def _sigmas(text: str | None) -> tuple[float, float]:
    """Return mm and radians of a text such as 0.1,0.01 (mm, degrees)."""
    if text is None:
        return 0.0, 0.0
    mm, degrees = numbers("--motion-sigma", text, 2, form="MM,DEG such as 0.1,0.01")
    return mm, math.radians(degrees)


def _plane(text: str | None) -> Plane | None:
    import numpy as np

    from cadcam.geometry.plane import Plane

    if text is None:
        return None
    values = numbers("--plane", text, 4, form="four numbers NX,NY,NZ,D such as 0,0,1,-1250")
    return Plane(np.array(values[:3]), np.array(values[3]))
