"""`cadcam render`: a CAD model as a camera sees it: shaded, wireframe, depth, normals, part or face numbers."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, size, verb
from cadcam.cli.cameras import POSE_HELP, add_camera_options, camera_and_pose, view_as_json
from cadcam.cli.models import add_model_options, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, say, working
from cadcam.cli.wires import (
    INK,
    add_line_options,
    lines_as_json,
    lines_in_words,
    naming,
    scene_of,
    scene_without_edges,
    style_of,
    wireframe_of,
)
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.cad.mesh import Mesh
    from cadcam.camera.camera import Camera
    from cadcam.geometry.rigid import Rigid

_SUFFIXES = {
    "shaded": (".png", ".jpg", ".jpeg"),
    "wireframe": (".png", ".svg", ".jpg", ".jpeg"),
    "depth": (".npy", ".png"),
    "normals": (".npy", ".png"),
    "parts": (".npy", ".png"),
    "faces": (".npy",),
}
_VIEWS = ("iso", "front", "back", "left", "right", "top", "bottom")
_EXAMPLES = f"""\
  cadcam render part.step -o part.png                                     a view chosen so that the part fills it
  cadcam render part.stl --unit in --view top --channel wireframe --hidden -o top.svg
  cadcam render part.step --camera camera.json --channel depth -o depth.npy
  cadcam render part.step --camera internals.json --pose pose.txt -o as_seen.png

{POSE_HELP}"""
_DESCRIPTION = """\
Render a CAD model through the exact camera: skew, aspect and lens distortion included, at every pixel centre.
Channels: shaded (RGB); wireframe (visible edges); depth (z-depth: .npy float32 mm with inf for the background, or
16-bit .png with 0 for the background and the mm of a step printed); normals (camera frame; .npy, or .png with (n+1)/2);
parts and faces (.npy int32, -1 for the background; parts as .png in colours)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "CAD model -> picture, as a camera sees it"
    parser = verb(verbs, "render", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    add_model_options(parser)
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="file to write; the suffix says how")
    parser.add_argument(
        "--channel", choices=tuple(_SUFFIXES), default="shaded", help="what to render (default: shaded)"
    )
    add_camera_options(parser, required=False)
    parser.add_argument("--view", choices=_VIEWS, help="without a camera: the side to look from (default: iso)")
    parser.add_argument("--size", type=size, metavar="WxH", help="without a camera: picture size (default 1280x960)")
    add_line_options(parser, color_by="one")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Render, write, report."""
    check_target(arguments.output, _SUFFIXES[arguments.channel])
    given = _given_camera(arguments)
    mesh, report = load_as_asked(arguments)
    camera, pose = given or _chosen_camera(arguments, mesh)
    result = _written(arguments, mesh, camera, pose)
    if arguments.json:
        document = {"output": arguments.output, "channel": arguments.channel, **result}
        print_json(document | {"model": model_as_json(report, mesh), "camera": view_as_json(camera, pose)})
    else:
        print(_in_words(arguments.channel, result))
        say(f"wrote {arguments.output} ({camera.width} x {camera.height} px)")


def _given_camera(arguments: argparse.Namespace) -> tuple[Camera, Rigid] | None:
    if arguments.camera is None:
        if arguments.pose is not None:
            raise BadValue("--pose", "given without --camera", "both: a pose does not say the focal length")
        return None
    if arguments.view or arguments.size:
        raise BadValue("--view or --size", "given beside --camera", "neither: the camera decides")
    return camera_and_pose(arguments.camera, arguments.pose)


def _chosen_camera(arguments: argparse.Namespace, mesh: Mesh) -> tuple[Camera, Rigid]:
    from cadcam.render.standard_view import standard_view

    return standard_view(mesh, arguments.view or "iso", size=arguments.size or (1280, 960))


def _written(arguments: argparse.Namespace, mesh: Mesh, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the channel asked for; return what the caller should know of it."""
    if arguments.channel == "wireframe":
        return _write_wireframe(arguments, mesh, camera, pose)
    from cadcam.cli.channels import WRITERS
    from cadcam.render import open_renderer

    with working("rendering"), naming(arguments.model):
        renderer = open_renderer(scene_without_edges(mesh))
        return WRITERS[arguments.channel](arguments.output, renderer, camera, pose)


def _write_wireframe(arguments: argparse.Namespace, mesh: Mesh, camera: Camera, pose: Rigid) -> dict[str, Any]:
    import numpy as np

    from cadcam.image.picture import write_picture
    from cadcam.render.overlay import overlay, write_overlay_svg

    wireframe = wireframe_of(arguments, scene_of(arguments, mesh), camera, pose)
    style = style_of(arguments, color=INK)
    if arguments.output.lower().endswith(".svg"):
        write_overlay_svg(arguments.output, wireframe, style=style, title=arguments.model)
    else:
        paper = np.ones((camera.height, camera.width), np.float32)
        write_picture(arguments.output, overlay(paper, wireframe, style=style))
    return lines_as_json(wireframe)


def _in_words(channel: str, result: dict[str, Any]) -> str:
    if channel == "wireframe":
        return lines_in_words(result)
    words = [f"the model covers {result['seen_pixels']} px"]
    if "depth_mm" in result:
        words.append("depth {:.3f} to {:.3f} mm".format(*result["depth_mm"]))
    if "depth_mm_per_step" in result:
        words.append(f"{result['depth_mm_per_step']:g} mm a step, 0 for the background")
    parts = [f"  {at['number']:4d}  {at['pixels']:8d} px  {name}" for name, at in result.get("seen_parts", {}).items()]
    return "\n".join([", ".join(words), *parts])
