"""The options shared by `locate` and similar verbs: approximate pose, allowed motions, drawn lines."""

from __future__ import annotations

import argparse
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import (
    POINTS_OPTIONS,
    add_points_options,
    check_in_picture,
    given,
    number,
    numbers,
    read_points_as_asked,
    real,
    refuse,
)
from cadcam.cli.output import counting, progress, working
from cadcam.cli.photos import Shots
from cadcam.cli.wires import LINE, style_of
from cadcam.errors import BadValue, NothingInView, UnknownName

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from cadcam.arrays import Picture
    from cadcam.cad.mesh import Mesh
    from cadcam.camera.camera import Camera
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.location import Location
    from cadcam.locate.part import Part
    from cadcam.locate.photo import Photo
    from cadcam.locate.views.resting import OnPlane
    from cadcam.locate.views.view_range import ViewRange
    from cadcam.render.lines.visible import LineDrawer

START_FILE_HELP = """\
A start file is either JSON of `cadcam locate --pose-out`, or a first line '# camera_from_part, mm' (or world_from_part;
or m, in ...) and a 3x4 or 4x4 matrix. With one camera, the world is that camera. With several, it is the frame in which
their files place them. JSON by several cameras is in their frame, too: for a photo alone it serves if it tells of the
photo's camera by name, or if the camera's file says where it stands in that frame.
"""

FREEDOM_HELP = """\
freedom:  free            all six degrees of freedom (default)
          plane:0,0,1     on a floor with this normal in the world: two shifts and a turn
          axis:X,Y,Z,DX,DY,DZ   a turn about the axis through X,Y,Z (mm) along DX,DY,DZ
          along:DX,DY,DZ  a shift along this direction
          The numbers are in the world of a start file, so with one camera in that camera's frame, wherever its file
          places it. Add @part (plane:0,0,1@part) if they are in the part's own axes: that is the surer way. What is
          not free stays as in the start, so a start is needed.
"""

START_HELP = f"""\
start:    --start FILE    rough pose of the part; it may be off by some 20 degrees, 40 px and 10 % of the distance,
                          about the middle of the part, or of what is in view of one that the camera stands within
          --points FILE   four or more points of the model picked in the (first) photo; `cadcam calibrate --help` shows
                          the file
          neither         the part is searched for (seconds). With one photo whose camera file has a pose, it is first
                          tried where that file has the world's origin
{START_FILE_HELP}
{FREEDOM_HELP}"""

VIEWS_HELP = """\
seen from: any            from all sides (default), where the part is 0.2 to 1.2 of the photo's shorter side large
          above, above:60   from the side of the model's +z, up to 80 or 60 degrees from that axis
          X,Y,Z:30        from the direction X,Y,Z of the model (from its middle to the camera), up to 30 degrees off
          A narrower range is faster and surer.

on:       0,0,1,0         the part lies on this plane (a table, a belt, a tray): normal X,Y,Z and offset D (mm) in the
                          world of the camera file's pose, of several files, or of the rig; points p of the plane have
                          X px + Y py + Z pz = D. The part is on the side of the cameras, wherever the normal points.
                          Where the camera was calibrated on a board that lay there, 0,0,1,0 is the board's upper side
          0,0,1,0:2       known to within 2 mm, practically always, uneven undersides and errors of the camera's place
                          included: poses that are found are made more accurate by it. Else checked to 1 mm
          --lying 0,0,-1  the part's direction that points to the plane; else it lies on any face on which it stays
          Place and turn are then all that is searched for: faster, and small parts are found that otherwise are not
          certain. A part found not to lie there, tilted or raised, is refused.

          The first search of a model draws its views (seconds) and keeps them in the cache folder: CADCAM_CACHE, else
          ~/.cache/cadcam; CADCAM_CACHE=off keeps nothing.
"""


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the approximate pose of the part, and its allowed motions."""
    group = add_start_option(parser)
    group.add_argument("--points", metavar="FILE", help="points of the model picked in the photo (see below)")
    add_points_options(parser)


def add_start_option(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add the options for an approximate pose in a file and the part's allowed motions; return their group."""
    group = parser.add_argument_group("start (default: none, search)")
    group.add_argument("--start", metavar="FILE", help="rough pose of the part (see below)")
    group.add_argument("--freedom", default="free", metavar="F", help="how the part may move: see below")
    return group


def add_view_options(parser: argparse.ArgumentParser, *, when: str = "without a start") -> None:
    """Add the options for the range of views of a part that is searched for; when: it is."""
    group = parser.add_argument_group(f"search ({when})")
    group.add_argument(
        "--seen-from", default="any", metavar="V", help="from where the part may be seen: see below (default any)"
    )
    group.add_argument(
        "--roll", type=real, metavar="DEG", help="the part's z axis is upright in the photo, to within DEG"
    )
    group.add_argument(
        "--distance", metavar="NEAR,FAR", help="range of the camera's distance from the part's middle, mm"
    )
    group.add_argument("--on", metavar="X,Y,Z,D", help="plane that the part lies on, in the world: see below")
    group.add_argument("--lying", metavar="X,Y,Z", help="direction of the part that points to the plane of --on")


VIEW_OPTIONS = ("--seen-from", "--roll", "--distance", "--on", "--lying")


def views_as_asked(arguments: argparse.Namespace, camera_from_world: Rigid | None, *starts: str) -> ViewRange:
    """Return the range of views that the options declare; starts: options in place of them.

    camera_from_world: of the one camera whose file says where it stands.
    """
    from cadcam.locate.views.view_range import ViewRange

    if given(arguments, *starts):
        refuse(arguments, *VIEW_OPTIONS, why="beside a start", expected="one of them: a start is not searched for")
    text, _, angle = arguments.seen_from.partition(":")
    axis = numbers("--seen-from", text) if "," in text else []
    form = "any, above, above:DEG or X,Y,Z:DEG"
    if text not in ("any", "above") and len(axis) != 3:
        raise BadValue("--seen-from", repr(arguments.seen_from), form)
    within = number("--seen-from", angle, form=form) if angle else 180.0 if text == "any" else 80.0
    around: dict[str, Any] = {"half_angle_deg": within}
    if axis:
        around["axis"] = axis
    if arguments.roll is not None:
        around["roll_deg"] = arguments.roll
    if arguments.distance is not None:
        near, far = numbers("--distance", arguments.distance, 2, form="two numbers: nearest,farthest in mm")
        around["distance_mm"] = (near, far)
    return ViewRange(**around, on=_plane_as_asked(arguments, camera_from_world))


def _plane_as_asked(arguments: argparse.Namespace, camera_from_world: Rigid | None) -> OnPlane | None:
    """Return the plane of --on, in the frame that the photos' cameras are placed in; None without it."""
    import numpy as np

    from cadcam.geometry.plane import Plane
    from cadcam.locate.views.resting import OnPlane

    if arguments.on is None:
        refuse(arguments, "--lying", why="without --on", expected="--on beside it: the plane that the part lies on")
        return None
    refuse(arguments, "--roll", why="beside --on", expected="one of them: on a plane a part may be turned anyhow")
    text, known, within = arguments.on.partition(":")
    x, y, z, offset = numbers("--on", text, 4, form="four numbers: the normal X,Y,Z and the offset D in mm")
    plane = Plane(np.array([x, y, z]), np.array(offset))
    if len(arguments.camera) == 1:  # whose frame is the world
        if camera_from_world is None:
            wanted = "camera_from_world: --on is a plane in the world; calibrate on a board that lies on it"
            raise BadValue(f"the pose in {arguments.camera[0]}", "missing", wanted)
        normal = camera_from_world.rotation @ plane.normal
        plane = Plane.through(camera_from_world @ plane.foot([0.0, 0.0, 0.0]), normal)
    down = None if arguments.lying is None else np.array(numbers("--lying", arguments.lying, 3))
    return OnPlane(plane, down, number("--on", within) if known else None, stated=f"--on {arguments.on}")


@contextmanager
def aspects_kept(part: Part) -> Iterator[None]:
    """Load the part's aspects from the cache's folder, and store there what is computed meanwhile."""
    from cadcam.locate.search.aspect_files import read_aspects, write_aspects

    folder = cache_folder()
    kept = len(part.aspects.made)
    if not kept and folder is not None:
        kept = read_aspects(part, folder)
    try:
        yield
    finally:
        if folder is not None and len(part.aspects.made) > kept:
            write_aspects(part, folder)


def prepare(part: Part, cameras: Sequence[Camera], views: ViewRange) -> None:
    """Compute the aspects that a search in photos of these cameras needs, and show how far that has come."""
    from cadcam.locate.search.without_start import unmade

    if todo := unmade(part, cameras, views):
        with progress("preparing the part", len(todo)) as step:
            part.aspects.make(todo, step)


def cache_folder() -> Path | None:
    """Return the cache folder kept between runs: CADCAM_CACHE (off: none), else the system's."""
    import os
    import sys
    from pathlib import Path

    asked = os.environ.get("CADCAM_CACHE", "")
    if asked:
        return None if asked == "off" else Path(asked)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData/Local")) / "cadcam" / "aspects"
    usual = Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return Path(os.environ.get("XDG_CACHE_HOME") or usual) / "cadcam" / "aspects"


def start_as_asked(
    arguments: argparse.Namespace, viewpoints: Sequence[Viewpoint], camera_from_world: Rigid | None
) -> Rigid | None:
    """Return world_from_part of --start or --points, picked in the first photo; None for neither.

    camera_from_world: of the one camera whose file says where it stands.
    """
    if arguments.start:
        refuse(arguments, "--points", why="beside --start", expected="one of them")
    if arguments.points is None:
        refuse(arguments, *POINTS_OPTIONS, why="without --points", expected="both, or leave it out")
    if arguments.start:
        return pose_in_file(arguments, arguments.start, viewpoints, camera_from_world)
    if arguments.points:
        from cadcam.calibrate.points.camera import locate_camera

        view, observations = viewpoints[0], read_points_as_asked(arguments, arguments.points)
        check_in_picture(observations, view.camera.size)
        with working("finding the start from points"):
            camera_from_part = locate_camera(observations, view.camera).camera_from_world
        return view.camera_from_world.inv @ camera_from_part
    return None


def pose_in_file(
    arguments: argparse.Namespace, path: str, viewpoints: Sequence[Viewpoint], camera_from_world: Rigid | None
) -> Rigid:
    """Return world_from_part of a file, in the world of the photos' cameras; camera_from_world: as `start_as_asked`."""
    from cadcam.files.pose_estimate import read_pose_by_one, read_pose_by_several

    if arguments.rig or len(viewpoints) > 1:
        return read_pose_by_several(path, viewpoints)
    return read_pose_by_one(path, viewpoints[0].name, camera_from_world=camera_from_world)


def freedom_as_asked(arguments: argparse.Namespace, *, posed: bool = False) -> Freedom:
    """Return the motions that --freedom allows, from a start; posed: whether a pose that was found before is one."""
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
    if arguments.start is None and arguments.points is None and not posed:
        raise BadValue("--freedom", f"{arguments.freedom!r} without a start", "--start or --points: the rest stays so")
    count, make = makers[kind]
    values = numbers("--freedom", rest, count, form=f"{count} numbers after {kind}:")
    parts = [values[i : i + 3] for i in range(0, count, 3)]
    return make(*parts, frame="part" if frame == "part" else "world")


def part_as_asked(arguments: argparse.Namespace, mesh: Mesh) -> Part:
    """Return the part with its feature edges."""
    from cadcam.cli.wires import scene_of
    from cadcam.locate.part import Part

    return Part(scene_of(arguments, mesh))


def located(
    part: Part, shots: Shots, start: Rigid | None, freedom: Freedom, views: ViewRange | None = None
) -> Location:
    """Return the pose of the part: from the start, else where the camera file's world is, else by a search."""
    from cadcam.locate.in_photos import locate_part
    from cadcam.locate.views.view_range import WHOLE_SPHERE

    views = WHOLE_SPHERE if views is None else views
    if start is not None:
        with working("looking for the part"):
            return locate_part(part, shots.photos, start, freedom=freedom)
    there = at_the_world(part, shots.photos, shots.camera_from_world, freedom, views)
    if there is not None:
        return there
    with aspects_kept(part):
        prepare(part, [photo.camera for photo in shots.photos], views)
        with working("looking for the part"):
            return locate_part(part, shots.photos, views=views, freedom=freedom)


def at_the_world(
    part: Part, photos: Sequence[Photo], camera_from_world: Rigid | None, freedom: Freedom, views: ViewRange
) -> Location | None:
    """Return the pose of a part that is about where the world of its camera's file is, with all that look the same.

    None where it is not, as where that world is another thing's; where the file has no pose; and where views are
    declared, among which it is searched for.
    """
    from cadcam.locate.in_photos import locate_part, with_equivalents

    if camera_from_world is None or not views.anywhere:
        return None
    try:
        location = locate_part(part, photos, camera_from_world, freedom=freedom)
    except NothingInView:
        return None
    if not location.found:
        return None
    return with_equivalents(part, location) if freedom.full else location


def instances_located(part: Part, shots: Shots, views: ViewRange, most: int) -> list[Location]:
    """Return all instances of the part, at most so many; if there are none, what was tried."""
    from cadcam.locate.instances import locate_instances

    with aspects_kept(part):
        prepare(part, [photo.camera for photo in shots.photos], views)
        with counting("looking for instances", "found") as step:
            return locate_instances(part, shots.photos, views=views, most=most, step=step)


def overlaid(
    arguments: argparse.Namespace,
    lines: LineDrawer,
    picture: Picture,
    photo: Photo,
    world_from_part: Rigid,
    color: tuple[float, float, float] = LINE,
) -> Picture:
    """Return a picture with the part's visible lines at a pose; without any where the part is out of view."""
    from cadcam.image.picture import to_rgb
    from cadcam.render.lines.wireframe import LineOptions
    from cadcam.render.overlay import overlay

    pose = photo.camera_from_world @ world_from_part
    try:
        wireframe = lines.draw(photo.camera, pose, options=LineOptions(hidden=arguments.hidden))
    except NothingInView:
        return to_rgb(picture)
    return overlay(picture, wireframe, style=style_of(arguments, color=color))
