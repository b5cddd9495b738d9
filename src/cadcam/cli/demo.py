"""`cadcam demo`: the whole chain on built-in data, into a folder, by the very commands a reader can run again."""

from __future__ import annotations

import argparse
import io
import json
import shlex
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, verb
from cadcam.cli.output import print_json, print_tables, say, working
from cadcam.errors import UnwritableFile

if TYPE_CHECKING:
    from cadcam.camera.estimate import CameraEstimate
    from cadcam.report.table import Table

_EXAMPLES = """\
  cadcam demo                      into the folder cadcam-demo
  cadcam demo tour --json
"""
_DESCRIPTION = """\
Run the whole chain on built-in data and leave inputs, results and pictures in a folder:
1. the dissertation's sixteen calibration points -> its camera, beside the values it printed; the bench as that camera
saw it, with every target where it was measured and where it is projected;
2. a synthetic photo (rendered, with lens distortion, skewed pixels, blur and noise) of a ship's double-bottom block, 24
corners picked in it to 0.3 px -> its camera, beside the true one -> the block's visible wireframe on the photo."""

_FILES = {
    "bench_points.csv": "dissertation, Table 2.3: sixteen targets and where they were seen",
    "bench_camera.json": "the camera calibrated from them",
    "bench.png": "the bench as that camera saw it; targets measured (orange cross) and projected (blue ring)",
    "block.glb": "CAD model of a ship's double-bottom block, 4.2 x 3 x 2.2 m",
    "photo.png": "synthetic photo of it: distorted, skewed, blurred, noisy; things in it that are not in the CAD model",
    "points.csv": "24 corners of the block, picked in the photo to 0.3 px",
    "camera.json": "the camera calibrated from them, with its pose",
    "overlay.png": "the visible wireframe on the photo: edges green, contacts yellow, contours blue",
    "overlay.svg": "the same with hidden lines dashed, to zoom into",
    "side_by_side.png": "the photo, and the shaded model with its lines laid over it",
    "sum.png": "photo and model added and equalised: where they differ, edges double",
    "canny.png": "the lines in black on the photo's own edges in white",
}


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "the whole chain on built-in data, into a folder"
    parser = verb(verbs, "demo", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("folder", nargs="?", default="cadcam-demo", help="folder to fill (default: cadcam-demo)")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Fill the folder; print tables and the files."""
    folder = Path(arguments.folder)
    _make(folder)
    with working("making the inputs"):
        _write_inputs(folder)
    commands = _commands(folder)
    said: dict[str, Any] = {}
    for command in commands:
        if not arguments.json:
            say(f"$ {shlex.join(command)}")
        said |= _run(command)
    bench, block = _estimate(folder / "bench_camera.json"), _estimate(folder / "camera.json")
    with working("drawing the bench"):
        _draw_bench(folder / "bench.png", bench)
    distance = said["edge_distance_px"]
    if arguments.json:
        print_json(_document(folder, commands, bench, block, distance))
        return
    print_tables([_bench_table(folder, bench), _block_table(block, distance), _file_table(folder)])


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableFile(folder, error.strerror or str(error), "name another folder") from error


def _write_inputs(folder: Path) -> None:
    """Write points, photo and CAD model."""
    import numpy as np

    from cadcam.cad.load import load
    from cadcam.cad.parts import ship_block
    from cadcam.cad.write import write
    from cadcam.cli import demo_inputs as made
    from cadcam.files.points import write_points
    from cadcam.image.picture import write_picture
    from cadcam.render.view import Scene
    from cadcam.render.visible import visible_wireframe

    rng = np.random.default_rng(2026)
    write_points(folder / "bench_points.csv", made.bench_observations())
    write(ship_block(triangles=10_000), folder / "block.glb")
    block = load(folder / "block.glb")
    seen = visible_wireframe(Scene.of(block), made.TRUE_CAMERA, made.TRUE_POSE)
    write_points(folder / "points.csv", made.picked_points(block, seen, 24, rng))
    write_picture(folder / "photo.png", made.made_photo(block, rng))


def _commands(folder: Path) -> list[list[str]]:
    """Return the command lines of the chain, to be run here and by the reader."""

    def at(name: str) -> str:
        return str(folder / name)

    overlay = ["cadcam", "overlay", at("photo.png"), at("block.glb"), "--camera", at("camera.json")]
    bench = ["cadcam", "calibrate", at("bench_points.csv"), "--size", "768x576", "-o", at("bench_camera.json")]
    lens = ["--lens", "brown-conrady:k1"]
    return [
        bench,
        ["cadcam", "calibrate", at("points.csv"), "--photo", at("photo.png"), *lens, "-o", at("camera.json")],
        [*overlay, "--measure", "-o", at("overlay.png")],
        [*overlay, "--hidden", "-o", at("overlay.svg")],
        [*overlay, "--mode", "side-by-side", "--shaded", "0.8", "-o", at("side_by_side.png")],
        [*overlay, "--mode", "sum", "-o", at("sum.png")],
        [*overlay, "--mode", "canny", "-o", at("canny.png")],
    ]


def _run(command: list[str]) -> dict[str, Any]:
    """Run a command line as the shell would; return what it says with --json."""
    from cadcam.cli.main import parser

    arguments = parser().parse_args([*command[1:], "--json"])
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(io.StringIO()):
        arguments.run(arguments)
    document = json.loads(said.getvalue())
    assert isinstance(document, dict)
    return document


def _estimate(path: Path) -> CameraEstimate:
    from cadcam.files.camera import read_camera

    estimate = read_camera(path).estimate
    assert estimate is not None  # just written
    return estimate


def _draw_bench(path: Path, estimate: CameraEstimate) -> None:
    """Draw the bench half as large again as its photo, the targets where they were measured and are projected."""
    from cadcam.cad.parts import calibration_bench
    from cadcam.cli.wires import scene_without_edges
    from cadcam.image.draw import draw_points
    from cadcam.image.picture import write_picture
    from cadcam.render import open_renderer
    from cadcam.render.view import Channel, Look

    width, height = estimate.camera.size
    camera, pose = estimate.camera.resize((3 * width // 2, 3 * height // 2)), estimate.camera_from_world
    look = Look(supersampling=2, background=(0.86, 0.87, 0.88))
    renderer = open_renderer(scene_without_edges(calibration_bench()))
    picture = renderer.render(camera, pose, channels=Channel.IMAGE, look=look).image
    projected = camera.project(pose @ estimate.observations.p_world)
    measured = camera.pixel_of(estimate.camera.normalised(estimate.observations.q))
    picture = draw_points(picture, projected, color=(0.1, 0.7, 1.0), mark="circle", size=12, width=1.3)
    write_picture(path, draw_points(picture, measured, color=(1.0, 0.45, 0.0), mark="cross", size=12, width=1.3))


def _bench_table(folder: Path, estimate: CameraEstimate) -> Table:
    from cadcam.calibrate.points import calibrate
    from cadcam.cli.demo_inputs import PRINTED
    from cadcam.files.points import read_points
    from cadcam.report.camera import compared

    linear = calibrate(read_points(folder / "bench_points.csv"), estimate.camera.size, method="dlt-c23")
    return compared(
        "1. The dissertation's camera, from the sixteen points of its Table 2.3",
        estimate,
        {"DLT, C23 = 1": linear, "as printed": PRINTED},
        notes=("the printed values are those of the direct linear transform with C23 = 1 (Table 2.9)",),
    )


def _block_table(estimate: CameraEstimate, distance: dict[str, float]) -> Table:
    from cadcam.camera.extended_pinhole import NAMES, ExtendedPinhole
    from cadcam.cli.demo_inputs import TRUE_CAMERA, TRUE_POSE
    from cadcam.report.camera import against_truth

    values = ExtendedPinhole.from_camera(TRUE_CAMERA, TRUE_POSE).vector.tolist()
    share = 100 * distance["share_within_2_px"]
    return against_truth(
        "2. The camera of the synthetic photo, from 24 corners picked to 0.3 px",
        estimate,
        dict(zip(NAMES, values, strict=True)) | TRUE_CAMERA.lens.parameters,
        notes=(f"visible lines to the photo's edges: median {distance['median']:.2f} px, {share:.0f} % within 2 px",),
    )


def _file_table(folder: Path) -> Table:
    from cadcam.report.table import Table

    rows = tuple((str(folder / name), text) for name, text in _FILES.items())
    return Table(
        "Files",
        ("file", "what it is"),
        rows,
        ("file", "what it is"),
        ("run the commands above again, or with your own files",),
    )


def _document(
    folder: Path,
    commands: list[list[str]],
    bench: CameraEstimate,
    block: CameraEstimate,
    distance: dict[str, float],
) -> dict[str, Any]:
    from cadcam.cli.demo_inputs import TRUE_CAMERA, TRUE_POSE
    from cadcam.files.camera import parameters_as_json, pinhole_as_json

    return {
        "folder": str(folder),
        "commands": [shlex.join(command) for command in commands],
        "bench": {"residual_px": bench.thesis_residual, "parameters": parameters_as_json(bench)},
        "block": {"residual_px": block.thesis_residual, "parameters": parameters_as_json(block)},
        "block_truth": pinhole_as_json(TRUE_CAMERA, TRUE_POSE) | TRUE_CAMERA.lens.parameters,
        "edge_distance_px": distance,
        "files": {str(folder / name): text for name, text in _FILES.items()},
    }
