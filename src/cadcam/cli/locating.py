"""What locating, tracking and verifying share on the command line: photos with their cameras, the start, freedoms."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cadcam.cli.arguments import add_points_options, number, read_points_as_asked
from cadcam.cli.cameras import add_camera_options, camera_file_of
from cadcam.cli.output import working
from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable

    from cadcam.cad.mesh import Mesh
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.part import Part

_EDGE_PX = 0.1  # stated with cameras whose calibration does not tell it; edges bring their own noise
START_HELP = """\
start:    nothing         the part is searched for in the whole picture, from all sides (seconds)
          --start FILE    where it is, roughly: some 20 degrees, 40 px and 10 % of the distance off do no harm
          --points FILE   four or more points of the model picked in the photo, as for `cadcam calibrate`
start file: a first line '# camera_from_part, mm' (or world_from_part; or m, in ...), then a 3x4 or 4x4 matrix; or what
--pose-out wrote. The world is that of the camera's file, or the camera where that says no pose.

freedom:  free            all six (default)
          plane:0,0,1     on a floor with this normal in the world: two shifts and a turn
          axis:X,Y,Z,DX,DY,DZ   a turn about the axis through X,Y,Z (mm) along DX,DY,DZ
          along:DX,DY,DZ  a shift along this direction
          Add @part (plane:0,0,1@part) where the numbers are in the part's own axes. What is not free stays as in the
          start, which is therefore needed.
"""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A source of pictures (a photo, a folder, a video), the viewpoint it was taken from, and the camera's file."""

    source: str
    viewpoint: Viewpoint
    camera_file: str


def add_view_options(parser: argparse.ArgumentParser, *, what: str) -> None:
    """Add the cameras: one, or several that took their pictures together."""
    add_camera_options(parser, required=True)
    parser.add_argument(
        "--also",
        action="append",
        default=[],
        metavar=f"{what}=CAMERA",
        help=f"{what.lower()} of a further camera with its file; both files say where they stand. May be repeated",
    )
    parser.add_argument("--rig", metavar="FILE", help="file of `cadcam rig`: --camera and --also then name its cameras")


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add where the part is, roughly, and how it may move from there."""
    group = parser.add_argument_group("start (default: none, search)")
    group.add_argument("--start", metavar="FILE", help="rough pose of the part (see below)")
    group.add_argument("--points", metavar="FILE", help="points of the model picked in the first photo")
    group.add_argument("--freedom", default="free", metavar="F", help="free, plane:..., axis:... or along:... (below)")
    add_points_options(parser)


def views_as_asked(arguments: argparse.Namespace, source: str) -> list[View]:
    """Return the first source with its camera, then those of --also."""
    pairs = [(source, arguments.camera), *(_pair(text) for text in arguments.also)]
    if arguments.rig is not None:
        return _rig_views(arguments, pairs)
    if len(pairs) > 1 and arguments.pose is not None:
        raise BadValue("--pose", "given beside --also", "poses in the camera files: they have to share one world")
    return [View(source, _viewpoint(path, arguments.pose, needs_pose=len(pairs) > 1), path) for source, path in pairs]


def start_as_asked(arguments: argparse.Namespace, view: Viewpoint) -> Rigid | None:
    """Return world_from_part of --start or --points, None for neither."""
    if arguments.start and arguments.points:
        raise BadValue("--points", "given beside --start", "one of them")
    if arguments.start:
        from cadcam.files.pose_estimate import read_part_pose

        return read_part_pose(arguments.start, camera_from_world=view.camera_from_world)
    if arguments.points:
        from cadcam.calibrate.points import locate_camera

        observations = read_points_as_asked(arguments, arguments.points)
        with working("finding the start from points"):
            camera_from_part = locate_camera(observations, view.camera).camera_from_world
        return view.camera_from_world.inv @ camera_from_part
    return None


def freedom_as_asked(arguments: argparse.Namespace) -> Freedom:
    """Return the motions that --freedom allows."""
    from cadcam.locate.freedom import FREE, Freedom

    text, at, frame = arguments.freedom.partition("@")
    if at and frame not in ("world", "part"):
        raise UnknownName("frame in --freedom", frame, ("world", "part"))
    kind, _, rest = text.partition(":")
    if kind == "free":
        return FREE
    makers: dict[str, tuple[int, Callable[..., Freedom]]]
    makers = {"plane": (3, Freedom.planar), "along": (3, Freedom.along), "axis": (6, Freedom.about)}
    if kind not in makers:
        raise UnknownName("freedom", kind, ("free", *makers))
    if arguments.start is None and arguments.points is None:
        raise BadValue("--freedom", f"{arguments.freedom!r} without a start", "--start or --points: the rest stays so")
    count, make = makers[kind]
    values = [number("--freedom", v) for v in rest.split(",") if v.strip()]
    if len(values) != count:
        raise BadValue("--freedom", repr(arguments.freedom), f"{count} numbers after {kind}:")
    parts = [values[i : i + 3] for i in range(0, count, 3)]
    return make(*parts, frame="part" if frame == "part" else "world")


def part_as_asked(arguments: argparse.Namespace, mesh: Mesh) -> Part:
    """Return the part with its feature edges."""
    from cadcam.cli.wires import scene_of
    from cadcam.locate.part import Part

    return Part(scene_of(arguments, mesh))


def _pair(text: str) -> tuple[str, str]:
    source, equals, camera = text.rpartition("=")
    if not equals or not source or not camera:
        raise BadValue("--also", repr(text), "PICTURES=CAMERA such as right.png=right.json")
    return source, camera


def _viewpoint(path: str, pose_file: str | None, *, needs_pose: bool) -> Viewpoint:
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.files.matrix import read_pose
    from cadcam.geometry.rigid import Rigid

    file = camera_file_of(path)
    pose = read_pose(pose_file) if pose_file else file.camera_from_world
    if needs_pose and pose is None:
        raise BadValue(f"the pose in {path}", "missing", "a camera file with camera_from_world: where each stands")
    if file.estimate is None:
        return Viewpoint.exact(path, file.camera, pose or Rigid(), sigma_px=_EDGE_PX)
    if pose_file is None:
        return Viewpoint.fixed(path, file.estimate, sigma_px=_EDGE_PX)
    return Viewpoint.placed(path, file.estimate, pose or Rigid(), sigma_px=_EDGE_PX)


def _rig_views(arguments: argparse.Namespace, pairs: list[tuple[str, str]]) -> list[View]:
    from cadcam.files.rig import read_rig

    if arguments.pose is not None:
        raise BadValue("--pose", "given beside --rig", "neither: the rig's first camera is the world")
    known = {view.name: view for view in read_rig(arguments.rig).viewpoints(sigma_px=_EDGE_PX)}
    for _, name in pairs:
        if name not in known:
            raise UnknownName(f"camera of {arguments.rig}", name, known)
    return [View(source, known[name], arguments.rig) for source, name in pairs]
