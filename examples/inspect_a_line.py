"""Judge the parts of a line: photograph twelve, of which one lacks a block and a rib creeps, and `cadcam inspect` them.

Run it anywhere: `python inspect_a_line.py [FOLDER]`. It leaves a folder as a station has it: the CAD model, the camera,
tolerances, about where the parts are put, and a photo of each part, named by its serial number. What is then run is
one command; open inspected/index.html in a browser. Run that command again: nothing is judged twice.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import cadcam
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.cli.main import main as command
from cadcam.report.state.chart import write_trend_svg

CAMERA = cadcam.Camera.from_focal((640, 480), 990.0)
VIEW = cadcam.Rigid.look_at((420.0, -620.0, 640.0), (10.0, 0.0, 10.0))
PARTS, WITHOUT_BLOCK, CREEP_MM = 12, 7, 0.05
TOLERANCES = """features:
  rib: {part: rib 1, position_mm: 0.8, direction: [0, 1, 0]}
  block: {part: block, position_mm: 1, presence: required}
"""


def main(folder: Path) -> None:
    """Fill the folder, then judge what is in it."""
    station(folder)
    words = ["inspect", folder / "photos", folder / "plate.glb", "--camera", folder / "camera.json"]
    words += ["--start", folder / "near.txt", "--tolerances", folder / "tolerances.yaml"]
    words += ["--store", folder / "parts.sqlite", "--reports", folder / "inspected"]
    command([str(word) for word in words])
    with cadcam.open_store(folder / "parts.sqlite") as store:
        rib = cadcam.trend(store.query(part="plate"), "rib")
    write_trend_svg(folder / "rib.svg", rib)


def station(folder: Path) -> None:
    """Write model, camera, tolerances, a start, and the photos."""
    (folder / "photos").mkdir(parents=True, exist_ok=True)
    cadcam.write_model(folder / "plate.glb", plate())
    cadcam.write_camera(folder / "camera.json", CAMERA)
    rows = [" ".join(f"{v:.9g}" for v in row) for row in VIEW.matrix]
    (folder / "near.txt").write_text("\n".join(["# camera_from_part, mm", *rows]) + "\n")
    (folder / "tolerances.yaml").write_text(TOLERANCES)
    rng, sensor = np.random.default_rng(1997), cadcam.named_sensor("global-shutter")
    for number in range(PARTS):
        laid = cadcam.Rigid.exp(np.append(rng.normal(scale=5.0, size=3), rng.normal(scale=0.02, size=3)))
        look = cadcam.Look(supersampling=4, background=(0.6, 0.6, 0.6), back=0.35)
        renderer = cadcam.open_renderer(cadcam.Scene.of(built(number)))
        light = cadcam.to_gray(renderer.render(CAMERA, VIEW @ laid, look=look).image)
        cadcam.write_picture(folder / "photos" / f"S{number + 1:03d}.png", sensor.apply(light, rng=rng))


def plate() -> cadcam.Mesh:
    """Return a plate of 300 x 200 mm with two ribs and a block."""
    ends = {
        "plate": ((-150, -100, 0), (150, 100, 12)),
        "rib 1": ((-120, -60, 12), (40, -48, 52)),
        "rib 2": ((-120, 30, 12), (40, 42, 52)),
        "block": ((70, -70, 12), (120, -10, 45)),
    }
    return merge([box(low, high, name=name, color=(0.55, 0.55, 0.6)) for name, (low, high) in ends.items()])


def built(number: int) -> cadcam.Mesh:
    """Return a part as it was made: the rib a little farther off each time, and once no block."""
    drawn = plate()
    vertices = drawn.vertices.copy()
    vertices[np.unique(drawn.faces[drawn.part == drawn.part_names.index("rib 1")])] += (0.0, CREEP_MM * number, 0.0)
    made = replace(drawn, vertices=vertices)
    return made.select(made.part != made.part_names.index("block")) if number == WITHOUT_BLOCK else made


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."))
