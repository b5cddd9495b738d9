"""Make the pictures of renders/ and the data of examples/data from a folder that `cadcam demo` has filled.

Run it as `cadcam demo DEMO && python examples/gallery.py DEMO [ROOT]`; without ROOT it writes into the project's own
folders. The line drawing is of a parametric sample part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cadcam
from cadcam.cad.parts import machined_bracket

ROOT = Path(__file__).resolve().parents[1]
INK = cadcam.LineStyle(color_by="one", color=(0.05, 0.08, 0.12))


def main(demo: Path, root: Path) -> None:
    """Keep the demo's inputs for the examples and its pictures for the README; add a line drawing."""
    data, renders = root / "examples" / "data", root / "renders"
    for source, name in (("bench_points.csv", "bench_points.csv"), ("points.csv", "block_points.csv")):
        cadcam.write_points(data / name, cadcam.read_points(demo / source))
    cadcam.write_picture(data / "block_photo.jpg", cadcam.read_picture(demo / "photo.png"), quality=88)
    for name in ("bench", "overlay", "sum", "canny"):
        cadcam.write_picture(renders / f"{name}.jpg", cadcam.read_picture(demo / f"{name}.png"), quality=82)
    verdict = photo_of((demo / "report.html").read_text(encoding="utf-8"))
    (renders / "verdict.svg").write_text(verdict, encoding="utf-8")
    drawing(renders / "bracket.png", machined_bracket())
    for path in sorted([*data.iterdir(), *renders.iterdir()]):
        print(f"{path.relative_to(root)}: {path.stat().st_size // 1024} kB")


def photo_of(report: str) -> str:
    """Return the photo of a report, with the deviations of the part's edges, as a picture of its own."""
    start = report.index('<svg class="photo"')
    svg = report[start : report.index("</svg>", start) + len("</svg>")]
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)


def drawing(path: Path, mesh: cadcam.Mesh) -> None:
    """Draw the lines, hidden ones dashed, over a pale shaded picture, as a technical illustration."""
    camera, pose = cadcam.standard_view(mesh, "iso", size=(1000, 700))
    scene = cadcam.Scene.of(mesh)
    look = cadcam.Look(head=0.25, fill=0.35, back=0.0, ambient=0.75, supersampling=2)
    view = cadcam.open_renderer(scene).render(camera, pose, channels=cadcam.Channel.IMAGE, look=look)
    wires = cadcam.visible_wireframe(scene, camera, pose, options=cadcam.LineOptions(hidden=True))
    cadcam.write_picture(path, cadcam.overlay(view.image, wires, style=INK))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else ROOT)
