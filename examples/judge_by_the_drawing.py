"""Does the plate keep the tolerances that its STEP file states? A photo of the plate as built is judged by them.

Run it anywhere: `python judge_by_the_drawing.py [FOLDER [SAMPLES]]`. In the plate that is photographed one hole of
20 mm is 0.5 mm off its place, and 0.3 mm nearer to the other one than drawn; the one of 12 mm is 0.4 mm too large. It
leaves the tolerance file that the STEP file makes, the photo, the report (report.html: open it in a browser) and the
photo with every edge in the colour of its deviation. SAMPLES are the renderings that the photo is the mean of.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import cadcam
from cadcam.report.table import show
from cadcam.report.verify.overlay import write_overlay_svg
from cadcam.report.verify.words import verification_tables

DRAWN = Path(__file__).resolve().parents[1] / "models/drilled_plate.step"
CAMERA = cadcam.Camera.from_focal((1600, 1200), 3200.0)
VIEW = cadcam.Rigid.look_at((40.0, -110.0, 260.0), (60.0, 40.0, 10.0))
LIGHT = cadcam.Light((cadcam.Lamp((-0.5, -0.7, 1.0), 0.3, 12.0),), flash=0.35, ambient=0.2)
OFF = ((45.0, 25.0), (0.3, 0.4))  # mm: the middle of a hole of 20 mm, and how far it is off
LARGER = ((60.0, 60.0), 0.2)  # the middle of the one of 12 mm, and by how much its radius is too large


def main(folder: Path, samples: int) -> None:
    """Write the tolerance file, photograph the plate as it was built, judge it."""
    folder.mkdir(parents=True, exist_ok=True)
    part = cadcam.Part.of(cadcam.read_model(DRAWN))
    limits = folder / "tolerances.yaml"
    limits.write_text(cadcam.drawing_template(part.scene, cadcam.read_pmi(DRAWN), DRAWN.name))
    photo = photograph(built(part.scene.mesh), folder / "photo.png", samples)

    rough = cadcam.Rigid.exp(np.array([2.0, -1.0, 3.0, 0.02, -0.03, 0.02]))  # mm, and radians: two degrees
    located = cadcam.locate_part(part, [photo], rough)
    found = cadcam.verify_part(part, [photo], located, cadcam.read_tolerances(limits))
    show(verification_tables(found), sys.stdout)
    origin = cadcam.VerificationOrigin("drilled plate", serial="example")
    cadcam.write_verification_page(folder / "report.html", found, [photo], origin, scene=part.scene)
    if found.inspection is not None:
        write_overlay_svg(folder / "verify.svg", photo, 0, found.inspection, judgements=found.judgements, quality=60)


def built(drawn: cadcam.Mesh) -> cadcam.Mesh:
    """Return the plate with one hole off its place and another too large."""
    vertices = drawn.vertices.copy()
    (x, y), away = OFF
    vertices[at(vertices, x, y, 10.0), :2] += away
    (x, y), more = LARGER
    hole = at(vertices, x, y, 6.0)
    vertices[hole, :2] += more * (vertices[hole, :2] - (x, y)) / 6.0
    return replace(drawn, vertices=vertices)


def at(vertices: np.ndarray, x: float, y: float, radius: float) -> np.ndarray:
    """Return which vertices are those of the hole there."""
    return np.abs(np.hypot(vertices[:, 0] - x, vertices[:, 1] - y) - radius) < 0.01


def photograph(mesh: cadcam.Mesh, path: Path, samples: int) -> cadcam.Photo:
    """Return what a machine-vision camera makes of it, noise and soft shadows included; the world is the plate's."""
    photographer = cadcam.Photographer(cadcam.Scene.of(mesh))
    light = photographer.radiance(CAMERA, VIEW, light=LIGHT, blur_px=0.5, samples=samples).over((0.1, 0.1, 0.1))
    sensor = cadcam.named_sensor("global-shutter")
    cadcam.write_picture(path, sensor.apply(cadcam.to_gray(light), rng=np.random.default_rng(242)))
    return cadcam.Photo.of(cadcam.read_picture(path), CAMERA, VIEW)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."), int(sys.argv[2]) if len(sys.argv) > 2 else 32)
