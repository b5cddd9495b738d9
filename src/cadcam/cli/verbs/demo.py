"""`cadcam demo`: the whole chain on built-in data, into a folder, by the very commands a reader can run again."""

from __future__ import annotations

import argparse
import io
import json
import os
import shlex
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, verb
from cadcam.cli.output import check_folder, print_json, print_tables, say, working
from cadcam.errors import UnwritableFile

if TYPE_CHECKING:
    from cadcam.report.table import Table

Said = dict[str, Any]

_EXAMPLES = """\
  cadcam demo                      into the folder cadcam-demo
  cadcam demo tour --json
"""
_DESCRIPTION = """\
Run the whole chain on built-in data and leave inputs, results and pictures in a folder:
1. the dissertation's sixteen calibration points -> its camera, beside the values it printed; the bench as that camera
saw it, with every target where it was measured and where it is projected;
2. a synthetic photo (rendered, with lens distortion, skewed pixels, blur and noise) of a ship's double-bottom block, 24
corners picked in it to 0.3 px -> its camera, beside the true one -> the block's visible wireframe on the photo;
3. a synthetic photo of the block as built, a bracket 6 mm off and a longitudinal forgotten, from near by -> where
the block is in it -> the verdict by its CAD and a tolerance file, beside the truth, with a report for the browser."""

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
    "steel.glb": "the block's CAD model before its pipe is mounted, as designed",
    "marks.csv": "84 marks on two plates, seen to 0.05 px by a second, finer camera",
    "close_camera.json": "that camera calibrated from them",
    "as_built.png": "synthetic photo of the block as built, by that camera from near by: a flash, shadows, noise",
    "rough.txt": "where somebody thinks that the camera was held",
    "tolerances.yaml": "what is asked of the block, in mm",
    "pose.json": "where the block was found in the photo, with its covariance",
    "found.png": "the lines of the CAD model where the block was found, the displaced and the forgotten part too",
    "report.html": "the verdict and all that it follows from: open it in a browser",
    "report.json": "the same for programs; `cadcam state add report.json` keeps it",
}


@dataclass(frozen=True)
class _Step:
    """Command lines, to be run here and by the reader, and the table of their results (one document per command)."""

    commands: tuple[list[str], ...]
    table: Callable[[Path, list[Said]], Table]


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "the whole chain on built-in data, into a folder"
    parser = verb(verbs, "demo", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "folder", nargs="?", metavar="FOLDER", default="cadcam-demo", help="folder to fill (default: cadcam-demo)"
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Fill the folder; print commands, tables and the files."""
    from cadcam.cli.demo import results as results

    check_folder(arguments.folder)
    folder = Path(arguments.folder)
    _make(folder)
    _write_inputs(folder)
    said: list[list[Said]] = []
    for step in _steps(folder):
        said.append([_run(command, quiet=arguments.json) for command in step.commands])
        if not arguments.json:
            print_tables([step.table(folder, said[-1])])
    with working("drawing the bench"):
        results.draw_bench(folder)
    files = {str(folder / name): text for name, text in _FILES.items()}
    if arguments.json:
        commands = [shlex.join(command) for command in _commands(folder)]
        print_json({"folder": str(folder), "commands": commands} | results.as_json(folder, said) | {"files": files})
    else:
        print_tables([results.file_table(files)])


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableFile(folder, error.strerror or str(error), "name another folder") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UnwritableFile(folder, "it is read-only", "name another folder, or change its permissions")


def _write_inputs(folder: Path) -> None:
    """Write points, photos, CAD models, start and tolerances."""
    import numpy as np

    from cadcam.cad.parts import ship_block
    from cadcam.cad.read import read_model
    from cadcam.cad.write import write_model
    from cadcam.cli.demo import as_built as built
    from cadcam.cli.demo import inputs as made
    from cadcam.files.points import write_points
    from cadcam.image.picture import write_picture
    from cadcam.render.lines.visible import visible_wireframe
    from cadcam.render.view import Scene
    from cadcam.whole import write_whole

    with working("making the inputs: points, CAD model, photo"):
        rng = np.random.default_rng(2026)
        write_points(folder / "bench_points.csv", made.bench_observations())
        write_model(folder / "block.glb", ship_block(triangles=10_000))
        block = read_model(folder / "block.glb")
        seen = visible_wireframe(Scene.of(block), made.TRUE_CAMERA, made.TRUE_POSE)
        write_points(folder / "points.csv", made.picked_points(block, seen, 24, rng))
        write_picture(folder / "photo.png", made.made_photo(block, rng))
    with working("taking a photo of the block as it was built"):
        write_model(folder / "steel.glb", built.steel_of(block))
        write_points(folder / "marks.csv", built.seen_marks(rng))
        write_whole(folder / "rough.txt", built.start_text().encode())
        write_whole(folder / "tolerances.yaml", built.TOLERANCES.encode())
        write_picture(folder / "as_built.png", built.made_photo(read_model(folder / "steel.glb"), rng))


def _steps(folder: Path) -> tuple[_Step, ...]:
    from cadcam.cli.demo import results as results

    def at(name: str) -> str:
        return str(folder / name)

    lens = ["--lens", "brown-conrady:k1"]
    overlay = ["cadcam", "overlay", at("photo.png"), at("block.glb"), "--camera", at("camera.json")]
    built = [at("as_built.png"), at("steel.glb"), "--camera", at("close_camera.json")]
    bench = ["cadcam", "calibrate", at("bench_points.csv"), "--size", "768x576", "-o", at("bench_camera.json")]
    block = (
        ["cadcam", "calibrate", at("points.csv"), "--photo", at("photo.png"), *lens, "-o", at("camera.json")],
        [*overlay, "--measure", "-o", at("overlay.png")],
        [*overlay, "--hidden", "-o", at("overlay.svg")],
        [*overlay, "--mode", "side-by-side", "--shaded", "0.8", "-o", at("side_by_side.png")],
        [*overlay, "--mode", "sum", "-o", at("sum.png")],
        [*overlay, "--mode", "canny", "-o", at("canny.png")],
    )
    pose, verdict = ["--pose", at("pose.json")], ["-o", at("report.html"), "-o", at("report.json")]
    judged = (
        ["cadcam", "calibrate", at("marks.csv"), "--size", "1200x900", *lens, "-o", at("close_camera.json")],
        ["cadcam", "locate", *built, "--start", at("rough.txt"), "--pose-out", at("pose.json"), "-o", at("found.png")],
        ["cadcam", "verify", *built, *pose, "--tolerances", at("tolerances.yaml"), *verdict],
    )
    return (
        _Step((bench,), results.bench_table),
        _Step(block, results.block_table),
        _Step(judged, results.verdict_table),
    )


def _commands(folder: Path) -> list[list[str]]:
    """Return the command lines of the chain."""
    return [command for step in _steps(folder) for command in step.commands]


def _run(command: list[str], *, quiet: bool) -> Said:
    """Show a command line and run it as the shell would; return its output with --json."""
    from cadcam.cli.main import parser

    if not quiet:
        say(f"$ {shlex.join(command)}")
    arguments = parser(command[1]).parse_args([*command[1:], "--json"])
    said = io.StringIO()
    with working(f"cadcam {command[1]}"), redirect_stdout(said), redirect_stderr(io.StringIO()):
        arguments.run(arguments)
    document = json.loads(said.getvalue())
    assert isinstance(document, dict)
    return document
