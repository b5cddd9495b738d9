"""Is the block as drawn? Photograph one with a bracket 5 mm off its place and a longitudinal forgotten, and judge it.

Run it anywhere: `python verify_a_part.py [FOLDER [SAMPLES]]`. The photo is of a block that differs from its CAD model;
the CAD model, the photo, its camera and a tolerance file are all that the verdict is made from. It leaves the photo,
the tolerances, the report to act on (report.html: open it in a browser) and the photo with every edge in the colour of
its deviation. SAMPLES are the renderings that the photo is the mean of.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import cadcam
from cadcam.cad.parts import ship_block
from cadcam.report.table import show
from cadcam.report.verify.overlay import write_overlay_svg
from cadcam.report.verify.words import verification_tables

CAMERA = cadcam.Camera.from_focal((1200, 900), 1500.0)
VIEW = cadcam.Rigid.look_at((200.0, -1900.0, 2300.0), (1900.0, 1000.0, 900.0))
# A lamp under the roof, and one at the camera
LIGHT = cadcam.Light((cadcam.Lamp((0.35, -0.55, 1.0), 0.7, 12.0),), flash=1.0, ambient=0.35)
DISPLACED, FORGOTTEN = "bracket 2.1 port", "longitudinal 2 port"
TOLERANCES = f"""features:
  bracket aft: {{part: {DISPLACED}, position_mm: 3, presence: required}}
  bracket fore: {{part: bracket 3.1 port, position_mm: 3, presence: required}}
  longitudinal: {{part: {FORGOTTEN}, presence: required}}
"""


def main(folder: Path, samples: int) -> None:
    """Photograph the block as it was built, judge it by the block as it was drawn."""
    folder.mkdir(parents=True, exist_ok=True)
    block = ship_block(triangles=29_000)
    drawn = block.subset([name for name in block.part_names if "pipe" not in name and "flange" not in name])
    photo = photograph(built(drawn), folder / "photo.png", samples)
    (folder / "tolerances.yaml").write_text(TOLERANCES)

    part = cadcam.Part.of(drawn)
    rough = cadcam.Rigid.exp(np.array([15.0, -10.0, 20.0, 0.02, -0.03, 0.02]))  # mm, and radians: two degrees
    located = cadcam.locate_part(part, [photo], rough)
    found = cadcam.verify_part(part, [photo], located, cadcam.read_tolerances(folder / "tolerances.yaml"))

    show(verification_tables(found), sys.stdout)
    origin = cadcam.VerificationOrigin("ship block", serial="example")
    cadcam.write_verification_page(folder / "report.html", found, [photo], origin, scene=part.scene)
    if found.inspection is not None:
        write_overlay_svg(folder / "verify.svg", photo, 0, found.inspection, quality=75)


def built(drawn: cadcam.Mesh) -> cadcam.Mesh:
    """Return the block with one part 5 mm off along x, and without another."""
    vertices = drawn.vertices.copy()
    vertices[np.unique(drawn.faces[drawn.part == drawn.part_names.index(DISPLACED)])] += (5.0, 0.0, 0.0)
    return replace(drawn, vertices=vertices).select(drawn.part != drawn.part_names.index(FORGOTTEN))


def photograph(mesh: cadcam.Mesh, path: Path, samples: int) -> cadcam.Photo:
    """Return what a machine-vision camera makes of it, noise and soft shadows included; the world is the block's."""
    photographer = cadcam.Photographer(cadcam.Scene.of(mesh))
    light = photographer.radiance(CAMERA, VIEW, light=LIGHT, blur_px=0.5, samples=samples).over((0.3, 0.3, 0.3))
    sensor = cadcam.named_sensor("global-shutter")
    cadcam.write_picture(path, sensor.apply(cadcam.to_gray(light), rng=np.random.default_rng(1997)))
    return cadcam.Photo.of(cadcam.read_picture(path), CAMERA, VIEW)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."), int(sys.argv[2]) if len(sys.argv) > 2 else 32)
