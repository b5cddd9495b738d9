"""`cadcam overlay`: the CAD model's visible lines, or the shaded model, over a photo."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import (
    POINTS_OPTIONS,
    Verbs,
    add_json,
    add_points_options,
    check_in_picture,
    opacity,
    read_points_as_asked,
    refuse,
    verb,
)
from cadcam.cli.cameras import POSE_HELP, add_camera_options, camera_and_pose, read_any_camera, view_as_json
from cadcam.cli.models import add_model_options, check_order, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, print_tables, say_written, working
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.cli.wires import add_line_options, lines_as_json, lines_in_words, naming, scene_of, style_of, wireframe_of
from cadcam.errors import BadValue
from cadcam.image.suffixes import WRITABLE

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.camera.camera import Camera
    from cadcam.camera.estimate import CameraEstimate
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.lines.wireframe import Wireframe
    from cadcam.render.view import Scene

_SUFFIXES = (*WRITABLE, ".svg")
_EXAMPLES = f"""\
  cadcam overlay photo.png part.step --camera camera.json -o overlay.png
  cadcam overlay photo.png part.step --camera camera.json --hidden --color-by part -o overlay.svg
  cadcam overlay photo.png part.obj --unit m --camera internals.json --points picked.csv -o overlay.png
  cadcam overlay photo.png part.step --camera camera.json --mode canny --measure -o edges.png

modes: overlay        lines over the photo, and the shaded model under them with --shaded 0.4
       side-by-side   the photo, and the overlay beside it
       sum            photo and shaded model added, histogram-equalised: where they differ, edges double
       canny          the lines in black over the photo's own edges in white

{POSE_HELP}"""
_DESCRIPTION = """\
Draw a CAD model over a photo, hidden lines removed, through the camera that took it: skew, aspect and lens distortion
are drawn, the photo is not resampled. Where the camera stood is taken from its file, from --pose, or from --points
(four or more points of the model picked in the photo, in a points file as for `cadcam calibrate`)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + CAD model + camera -> the wireframe on the photo"
    parser = verb(verbs, "overlay", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "photo", metavar="PHOTO", help="PNG, JPEG, TIFF ... of the camera's size (EXIF orientation is applied)"
    )
    add_model_options(parser)
    add_camera_options(parser, required=True)
    add_full_scale(parser)
    parser.add_argument("--points", metavar="FILE", help="find the pose from these points, keeping the internals")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="picture to write: .png, .jpg or .svg")
    parser.add_argument(
        "--mode",
        choices=("overlay", "side-by-side", "sum", "canny"),
        default="overlay",
        help="what is drawn (below; default overlay)",
    )
    parser.add_argument(
        "--shaded", type=opacity, metavar="OPACITY", help="lay the shaded model under the lines, 0 to 1"
    )
    parser.add_argument(
        "--measure", action="store_true", help="also report how far the lines are from the photo's edges, in px"
    )
    add_line_options(parser)
    add_points_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Draw, write, report."""
    check_target(arguments.output, _SUFFIXES)
    check_order([arguments.photo], arguments.model)
    _check_options(arguments)
    camera, pose, estimate = _camera(arguments)
    photo = _photo(arguments, camera)
    mesh, report = load_as_asked(arguments)
    scene = scene_of(arguments, mesh)
    wireframe = wireframe_of(arguments, scene, camera, pose)
    said = lines_as_json(wireframe) | (_distances(photo, wireframe) if arguments.measure else {})
    _write(arguments, photo, scene, wireframe)
    if arguments.json:
        document = {"output": arguments.output, **said, "model": model_as_json(report, mesh)}
        print_json(document | {"camera": view_as_json(camera, pose)} | _residual_as_json(estimate))
    else:
        _print(said, estimate)
        say_written(arguments.output)


def _check_options(arguments: argparse.Namespace) -> None:
    if arguments.points is None:
        refuse(arguments, *POINTS_OPTIONS, why="without --points", expected="both, or leave it out")
    else:
        refuse(arguments, "--pose", why="beside --points", expected="one of them")
    if arguments.output.lower().endswith(".svg") and arguments.mode != "overlay":
        raise BadValue("--mode", arguments.mode, "overlay for an .svg file, or another suffix")
    if arguments.mode in ("sum", "canny"):
        refuse(arguments, "--shaded", why=f"with --mode {arguments.mode}", expected="overlay or side-by-side")


def _camera(arguments: argparse.Namespace) -> tuple[Camera, Rigid, CameraEstimate | None]:
    if arguments.points is None:
        known, pose = camera_and_pose(arguments.camera, arguments.pose, else_="--pose FILE or --points FILE")
        return known.camera, pose, None
    from cadcam.calibrate.points.camera import locate_camera

    observations = read_points_as_asked(arguments, arguments.points)
    camera = read_any_camera(arguments.camera).camera
    check_in_picture(observations, camera.size)
    with working("finding the pose"):
        estimate = locate_camera(observations, camera)
    return estimate.camera, estimate.camera_from_world, estimate


def _photo(arguments: argparse.Namespace, camera: Camera) -> Picture:
    """Return the photo, of the camera's size."""
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.render.overlay import fitting

    path, white = arguments.photo, white_as_asked(arguments, [arguments.photo])
    with working(f"reading {path}"):
        return fitting(read_camera_picture(path, full_scale=white), camera, name=path)


def _write(arguments: argparse.Namespace, photo: Picture, scene: Scene, wireframe: Wireframe) -> None:
    from cadcam.image.picture import write_picture
    from cadcam.render.overlay import write_overlay_svg

    style = style_of(arguments)
    if arguments.output.lower().endswith(".svg"):
        under = _under(arguments, photo, scene, wireframe)
        write_overlay_svg(arguments.output, wireframe, photo=under, style=style, title=arguments.model)
    else:
        write_picture(arguments.output, _picture(arguments, photo, scene, wireframe))


def _picture(arguments: argparse.Namespace, photo: Picture, scene: Scene, wireframe: Wireframe) -> Picture:
    from cadcam.render.overlay import add_pictures, overlay, overlay_on_edges, side_by_side

    if arguments.mode == "sum":
        return add_pictures(photo, _view(arguments, scene, wireframe))
    if arguments.mode == "canny":
        return overlay_on_edges(photo, wireframe)
    drawn = overlay(_under(arguments, photo, scene, wireframe), wireframe, style=style_of(arguments))
    return side_by_side(photo, drawn) if arguments.mode == "side-by-side" else drawn


def _under(arguments: argparse.Namespace, photo: Picture, scene: Scene, wireframe: Wireframe) -> Picture:
    """Return the picture that the lines are drawn on."""
    from cadcam.render.overlay import blend_pictures

    if arguments.shaded is None:
        return photo
    return blend_pictures(photo, _view(arguments, scene, wireframe), opacity=arguments.shaded)


def _view(arguments: argparse.Namespace, scene: Scene, wireframe: Wireframe) -> Any:
    from cadcam.render import open_renderer
    from cadcam.render.view import Channel, Look

    with working("rendering"), naming(arguments.model):
        renderer = open_renderer(scene)
        return renderer.render(
            wireframe.camera, wireframe.camera_from_world, channels=Channel.IMAGE, look=Look(supersampling=2)
        )


def _distances(photo: Picture, wireframe: Wireframe) -> dict[str, Any]:
    """Return the distances of the visible lines from the photo's nearest edges of similar direction."""
    import numpy as np

    from cadcam.files.jsontext import or_null
    from cadcam.render.overlay import edge_distances

    with working("measuring the distance to the photo's edges"):
        distance = edge_distances(photo, wireframe)
    median, high = np.quantile(distance, [0.5, 0.9], method="nearest")
    return {
        "edge_distance_px": {
            "median": or_null(median),
            "p90": or_null(high),
            "share_within_2_px": float(np.mean(distance <= 2)),
            "samples": len(distance),
        }
    }


def _residual_as_json(estimate: CameraEstimate | None) -> dict[str, Any]:
    from cadcam.files.camera import camera_as_json

    return {} if estimate is None else {"pose_estimate": camera_as_json(estimate)["estimate"]}


def _print(said: dict[str, Any], estimate: CameraEstimate | None) -> None:
    from cadcam.report.camera import estimate_tables

    if estimate is not None:
        print_tables(estimate_tables(estimate))
    print(lines_in_words(said))
    if "edge_distance_px" in said:
        d = said["edge_distance_px"]
        median = "none near" if d["median"] is None else f"{d['median']:.2f} px"
        print(f"median distance to the photo's edges: {median}; {100 * d['share_within_2_px']:.0f} % within 2 px")
