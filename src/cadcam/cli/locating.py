"""What locating and its kin share on the command line: where the part is roughly, and how it may move from there."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cadcam.cli.arguments import add_points_options, number, read_points_as_asked
from cadcam.cli.output import working
from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable

    from cadcam.cad.mesh import Mesh
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.part import Part

START_HELP = """\
start:    --start FILE    where the part is, roughly: some 20 degrees, 40 px and 10 % of the distance off do no harm
          --points FILE   four or more points of the model picked in the (first) photo, as for `cadcam calibrate`
          neither         where the camera's file says that its world is, else searched for from all sides (seconds)
A start file's first line says what it holds: '# camera_from_part, mm' (or world_from_part; or m, in ...), then a 3x4 or
4x4 matrix; or JSON of --pose-out. The world is the camera; of several cameras, that in which their files place them.

freedom:  free            all six (default)
          plane:0,0,1     on a floor with this normal in the world: two shifts and a turn
          axis:X,Y,Z,DX,DY,DZ   a turn about the axis through X,Y,Z (mm) along DX,DY,DZ
          along:DX,DY,DZ  a shift along this direction
          Add @part (plane:0,0,1@part) where the numbers are in the part's own axes. What is not free stays as in the
          start, which is therefore needed.
"""


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add where the part is, roughly, and how it may move from there."""
    group = parser.add_argument_group("start (default: none, search)")
    group.add_argument("--start", metavar="FILE", help="rough pose of the part (see below)")
    group.add_argument("--points", metavar="FILE", help="points of the model picked in the photo")
    group.add_argument("--freedom", default="free", metavar="F", help="free, plane:..., axis:... or along:... (below)")
    add_points_options(parser)


def start_as_asked(arguments: argparse.Namespace, view: Viewpoint) -> Rigid | None:
    """Return world_from_part of --start or --points, picked in the photo of `view`; None for neither."""
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
