"""`cadcam render`: a CAD model as a camera sees it: shaded, wireframe, depth, normals, part or face numbers."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, size, verb
from cadcam.cli.models import add_model_options, load_as_asked
from cadcam.cli.output import check_target, print_json, print_tables, say, working
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.cad.mesh import Mesh
    from cadcam.camera.camera import Camera
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.view import Scene

_SUFFIXES = {
    "shaded": (".png", ".jpg", ".jpeg"),
    "wireframe": (".png", ".svg", ".jpg", ".jpeg"),
    "depth": (".npy", ".png"),
    "normals": (".npy", ".png"),
    "parts": (".npy", ".png"),
    "faces": (".npy",),
}
_VIEWS = ("iso", "front", "back", "left", "right", "top", "bottom")
_EXAMPLES = """\
  cadcam render part.step -o part.png                                     a view chosen so that the part fills it
  cadcam render part.stl --unit in --view top --channel wireframe --hidden -o top.svg
  cadcam render part.step --camera camera.json --channel depth -o depth.npy
  cadcam render part.step --camera internals.json --pose pose.txt -o as_seen.png

pose file: a first line '# camera_from_world, mm' (or world_from_camera; or m, in ...), then a 3x4 or 4x4 matrix.
"""
_DESCRIPTION = """\
Render a CAD model through the exact camera: skew, aspect and lens distortion included, at every pixel centre.
Channels: shaded (RGB); wireframe (visible edges); depth (z-depth: .npy float32 mm with inf for the background, or 16-bit
.png with 0 for the background and its scale in the output); normals (camera frame; .npy, or .png with (n+1)/2);
parts and faces (.npy int32, -1 for the background; parts as .png in colours)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs, "render", run, short="CAD model -> picture, as a camera sees it", description=_DESCRIPTION, examples=_EXAMPLES
    )
    add_model_options(parser)
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="file to write; its suffix decides the format")
    parser.add_argument("--channel", choices=tuple(_SUFFIXES), default="shaded", help="what to render (default: shaded)")
    parser.add_argument("--camera", metavar="FILE", help="camera file; its pose is used unless --pose is given")
    parser.add_argument("--pose", metavar="FILE", help="pose file, or a camera file with a pose")
    parser.add_argument("--view", choices=_VIEWS, help="without a camera: the side to look from (default: iso)")
    parser.add_argument("--size", type=size, metavar="WxH", help="without a camera: picture size in px (default 1280x960)")
    parser.add_argument("--hidden", action="store_true", help="wireframe: hidden lines too, dashed")
    parser.add_argument("--width", type=float, default=1.5, metavar="PX", help="wireframe: line width (default 1.5)")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Render, write, report."""
    check_target(arguments.output, _SUFFIXES[arguments.channel])
    mesh, report = load_as_asked(arguments)
    camera, pose = _camera(arguments, mesh)
    with working("rendering"):
        result = _written(arguments, mesh, camera, pose)
    document = {"output": arguments.output, "model": report, "camera": _camera_document(camera, pose), **result}
    if arguments.json:
        print_json(document)
    else:
        _print(document, camera)
        say(f"wrote {arguments.output}")


def _camera(arguments: argparse.Namespace, mesh: Mesh) -> tuple[Camera, Rigid]:
    from cadcam.files.camera import read_camera
    from cadcam.files.matrix import read_pose
    from cadcam.render.standard_view import standard_view

    if arguments.camera is None:
        if arguments.pose is not None:
            raise BadValue("--pose", "given without --camera", "both: a pose does not say the focal length")
        return standard_view(mesh, arguments.view or "iso", size=arguments.size or (1280, 960))
    if arguments.view or arguments.size:
        raise BadValue("--view or --size", "given beside --camera", "neither: the camera decides")
    known = read_camera(arguments.camera)
    pose = read_pose(arguments.pose) if arguments.pose else known.camera_from_world
    if pose is None:
        raise BadValue(f"pose in {arguments.camera}", "missing", "a camera file with camera_from_world, or --pose FILE")
    return known.camera, pose


def _written(arguments: argparse.Namespace, mesh: Mesh, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the channel asked for; return what the caller should know of it."""
    from cadcam.render.view import Scene

    if arguments.channel == "wireframe":
        return _wireframe(arguments, Scene.of(mesh), camera, pose)
    view_of = _CHANNELS[arguments.channel]
    return view_of(arguments.output, Scene.of(mesh, edges=_no_edges()), camera, pose)
