"""`cadcam render`: a CAD model imaged by a camera: shaded, wireframe, depth, normals, part or face numbers."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, refuse, size, verb, whole
from cadcam.cli.cameras import POSE_HELP, add_camera_options, camera_and_pose, view_as_json
from cadcam.cli.looks import add_look_options, check_look_options, scene_as_asked
from cadcam.cli.models import add_model_options, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, progress, say, working
from cadcam.cli.wires import (
    add_line_options,
    check_line_options,
    lines_in_words,
    naming,
)
from cadcam.errors import BadValue
from cadcam.image.suffixes import WRITABLE
from cadcam.render import RENDERERS

if TYPE_CHECKING:
    from cadcam.cad.mesh import Mesh
    from cadcam.camera.camera import Camera
    from cadcam.cli.channels import Output
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.view import Scene

_SUFFIXES = {
    "shaded": WRITABLE,
    "wireframe": (".png", ".svg", ".jpg", ".jpeg"),
    "depth": (".npy", ".exr", ".png"),
    "normals": (".npy", ".exr", ".png"),
    "parts": (".npy", ".png"),
    "faces": (".npy", ".png"),
}
_MOST_THREADS = 1024
_VIEWS = ("iso", "front", "back", "left", "right", "top", "bottom")
_EXAMPLES = f"""\
  cadcam render part.step -o part.png                                     a view chosen so that the part fills it
  cadcam render part.stl --unit in --view top --channel wireframe --hidden -o top.svg
  cadcam render part.step --look inspection --edges --part-color 'bolt*=#ff8800' --transparent -o part.png
  cadcam render part.step --camera camera.json --background photo.png -o in_place.png
  cadcam render part.step --camera camera.json --channel depth -o depth.npy
  cadcam render part.step --camera internals.json --pose pose.txt -o as_seen.png
  cadcam render part.step --camera cam.json --light hall --focal 16 --f-number 2 --sensor ccir-1996 -o as_taken.png
  cadcam render part.step --camera internals.json --poses poses.csv -o 'views/{{name}}.png'

{POSE_HELP}
poses file: a first line '# camera_from_world, mm' (or world_from_camera; or m, in ...), a line of column names, then a
pose a line; or JSON {{"poses": [{{"name": ..., "camera_from_world": ...}}, ...]}}; or a folder of pose files.
  name, r11, r12, r13, r21, r22, r23, r31, r32, r33, tx, ty, tz
  left,   1,   0,   0,   0,   1,   0,   0,   0,   1, -20, 0, 500
The output is then a pattern with {{name}} or {{index}} ({{index:04d}}), in quotes. Pictures that are there already are
kept, so that an interrupted run can be continued; --overwrite renders them again.
"""
_DESCRIPTION = """\
Render a CAD model through the exact camera: skew, aspect and lens distortion included, at every pixel centre.
Channels: shaded (RGB); wireframe (visible edges); depth (z-depth: .npy or .exr float32 mm with inf for the background,
or 16-bit .png with 0 for the background and the mm of a step printed); normals (camera frame; .npy, .exr with X, Y, Z,
or .png with (n+1)/2); parts and faces (.npy int32, -1 for the background; parts as .png in colours, faces as 16-bit
.png of number + 1)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "CAD model -> pictures, as a camera sees it"
    parser = verb(verbs, "render", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    add_model_options(parser)
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="file to write; the suffix says how")
    parser.add_argument(
        "--channel", choices=tuple(_SUFFIXES), default="shaded", help="what to render (default: shaded)"
    )
    add_camera_options(parser, required=False)
    parser.add_argument(
        "--poses", metavar="FILE", help="many poses: a poses file or a folder of pose files (see below)"
    )
    parser.add_argument("--overwrite", action="store_true", help="with --poses: render existing pictures again")
    parser.add_argument("--view", choices=_VIEWS, help="without a camera: the side to look from (default: iso)")
    parser.add_argument("--size", type=size, metavar="WxH", help="without a camera: picture size (default 1280x960)")
    parser.add_argument(
        "--renderer", choices=("auto", *RENDERERS), default="auto", help="see `cadcam doctor` (default: auto)"
    )
    parser.add_argument(
        "--threads",
        type=whole,
        metavar="N",
        help="threads of the raster renderer and, with --poses, of writing (default: one per core)",
    )
    add_look_options(parser)
    add_line_options(parser, color_by="one")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Render, write, report."""
    check_look_options(arguments)
    check_line_options(arguments)
    _check_renderer_options(arguments)
    if arguments.poses is not None:
        from cadcam.cli.batch import run_batch

        run_batch(arguments, _SUFFIXES[arguments.channel])
        return
    alone = "neither: a single picture is always rendered again"
    refuse(arguments, "--overwrite", why="without --poses", expected=alone)
    check_target(arguments.output, _SUFFIXES[arguments.channel])
    given = _given_camera(arguments)
    mesh, report = load_as_asked(arguments)
    camera, pose = given or _chosen_camera(arguments, mesh)
    result = _written(arguments, scene_as_asked(arguments, mesh), camera, pose)
    if arguments.json:
        document = {"output": arguments.output, "channel": arguments.channel, **result}
        print_json(document | {"model": model_as_json(report, mesh), "camera": view_as_json(camera, pose)})
    else:
        print(in_words(arguments.channel, result))
        width, height = result.get("size_px", camera.size)
        say(f"wrote {arguments.output} ({width} x {height} px)")


def _check_renderer_options(arguments: argparse.Namespace) -> None:
    """Refuse options of pixel rendering where no pixels are rendered, and threads where only one is used."""
    if arguments.threads is not None and not 1 <= arguments.threads <= _MOST_THREADS:
        raise BadValue("--threads", arguments.threads, f"a whole number from 1 to {_MOST_THREADS}")
    lines = arguments.channel == "wireframe"
    if lines:
        none = "none: lines are found in space, not in rendered pixels"
        refuse(arguments, "--renderer", why="with --channel wireframe", expected=none)
    if arguments.poses is None and (lines or arguments.renderer in ("gl", "ray")):
        one_does_all = "for a single picture that the raster renderer does not make"
        refuse(arguments, "--threads", why=one_does_all, expected="--renderer raster, or leave it out")


def _given_camera(arguments: argparse.Namespace) -> tuple[Camera, Rigid] | None:
    if arguments.camera is None:
        both = "both: a pose does not say the focal length"
        refuse(arguments, "--pose", why="without --camera", expected=both)
        return None
    refuse(arguments, "--view", "--size", why="beside --camera", expected="neither: the camera decides")
    known, pose = camera_and_pose(arguments.camera, arguments.pose)
    return known.camera, pose


def _chosen_camera(arguments: argparse.Namespace, mesh: Mesh) -> tuple[Camera, Rigid]:
    from cadcam.render.standard_view import standard_view

    return standard_view(mesh, arguments.view or "iso", size=arguments.size or (1280, 960))


def _written(arguments: argparse.Namespace, scene: Scene, camera: Camera, pose: Rigid) -> dict[str, Any]:
    """Write the requested channel; return what the caller should know of it."""
    from cadcam.cli.channels import output_of
    from cadcam.render.view import nothing_in_view

    with naming(arguments.model):
        with working("preparing"):
            output = output_of(arguments, scene, [pose])
        frame = _frame(output, camera, pose)
        if output.empty(frame):
            raise nothing_in_view(scene.mesh, camera, pose)
        return output.write(arguments.output, frame)


def _frame(output: Output, camera: Camera, pose: Rigid) -> Any:
    """Return a frame; for a photograph, with progress over its many renderings."""
    from cadcam.cli.photographs import Photographs

    if isinstance(output, Photographs):
        with progress("rendering", output.renderings) as step:
            return next(output.frames(camera, [pose], step=step))
    with working("rendering"):
        return next(output.frames(camera, [pose]))


def in_words(channel: str, result: Mapping[str, Any]) -> str:
    """Return the facts on a file as a sentence."""
    if channel == "wireframe":
        return lines_in_words(dict(result))
    words = [f"the model covers {result['seen_pixels']} px"]
    if "depth_mm" in result:
        words.append("depth {:.3f} to {:.3f} mm".format(*result["depth_mm"]))
    if "aperture_mm" in result:
        words.append(f"opening {result['aperture_mm']:.4g} mm, focused at {result['focus_mm']:.6g} mm")
    if "depth_mm_per_step" in result:
        words.append(f"{result['depth_mm_per_step']:g} mm a step, 0 for the background")
    parts = [f"  {at['number']:4d}  {at['pixels']:8d} px  {name}" for name, at in result.get("seen_parts", {}).items()]
    return "\n".join([", ".join(words), *parts])
