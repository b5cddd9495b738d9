"""Make the pictures of renders/ and the data of examples/data: all from what the package itself brings along.

Run it as `python examples/gallery.py [FOLDER]`; without a folder it writes into the project's own.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from pathlib import Path

import cadcam
from cadcam.cad.parts import machined_bracket, ship_block
from cadcam.cli.main import main as run
from cadcam.files.points import read_points, write_points

ROOT = Path(__file__).resolve().parents[1]
INK = cadcam.LineStyle(color_by="one", color=(0.05, 0.08, 0.12))


def main(root: Path) -> None:
    """Run the demo, keep its inputs for the examples and its pictures for the README; add line drawings."""
    data, renders = root / "examples" / "data", root / "renders"
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            if run(["demo", folder]) != 0:
                raise SystemExit("the demo failed")
        for name in ("bench", "block"):
            points = read_points(demo / ("bench_points.csv" if name == "bench" else "points.csv"))
            write_points(data / f"{name}_points.csv", points)
        cadcam.write_picture(data / "block_photo.jpg", cadcam.read_picture(demo / "photo.png"), quality=88)
        for name in ("bench", "overlay", "sum", "canny"):
            cadcam.write_picture(renders / f"{name}.jpg", cadcam.read_picture(demo / f"{name}.png"), quality=82)
    drawing(renders / "bracket.png", machined_bracket(), hidden=True)
    drawing(renders / "shipblock.png", ship_block(), hidden=False)
    for path in sorted([*data.iterdir(), *renders.iterdir()]):
        print(f"{path.relative_to(root)}: {path.stat().st_size // 1024} kB")


def drawing(path: Path, mesh: cadcam.Mesh, *, hidden: bool) -> None:
    """Draw the visible lines over a pale shaded picture, as a technical illustration."""
    camera, pose = cadcam.standard_view(mesh, "iso", size=(1000, 700))
    scene = cadcam.Scene.of(mesh)
    look = cadcam.Look(head=0.25, fill=0.35, ambient=0.75, supersampling=2)
    view = cadcam.open_renderer(scene).render(camera, pose, channels=cadcam.Channel.IMAGE, look=look)
    wires = cadcam.visible_wireframe(scene, camera, pose, options=cadcam.LineOptions(hidden=hidden))
    cadcam.write_picture(path, cadcam.overlay(view.image, wires, style=INK))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
