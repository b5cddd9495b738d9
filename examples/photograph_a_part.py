"""Photographs of the ship block before it is built: by an analogue camera of 1996, a machine-vision camera and a phone.

Run it anywhere: `python photograph_a_part.py [FOLDER [SAMPLES]]`. Each camera has its lens, focus, opening, distortion
and sensor; the hall's lamps throw the same soft shadows for all. It writes a picture of each into FOLDER; where a chip
has many pixels they are taken together. SAMPLES are the renderings that a picture is the mean of.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import cadcam
from cadcam.cad.parts import ship_block
from cadcam.image.picture import to_gray
from cadcam.image.sensor.charge import Exposure
from cadcam.image.sensor.presets import CCIR_1996, GLOBAL_SHUTTER, PHONE
from cadcam.render.photograph import behind, blur_before

FLOOR = (0.35, 0.36, 0.38)


@dataclass(frozen=True)
class Shot:
    """A camera and its lens, where it stands, the size of the picture."""

    name: str
    sensor: cadcam.Sensor
    optics: cadcam.Optics
    lens: cadcam.BrownConrady
    eye: tuple[float, float, float]
    at: tuple[float, float, float]
    size: tuple[int, int]
    colored: bool = False


SHOTS = (
    Shot(
        "ccir-1996",
        replace(CCIR_1996, exposure=Exposure(1.2)),
        cadcam.Optics(cadcam.sensor_format("1/2").with_pixels((768, 576)), 8.0, 6000.0, 4.0),
        cadcam.BrownConrady(k1=-0.2),
        (5800.0, -4000.0, 4400.0),
        (2050.0, 1250.0, 850.0),
        (768, 576),
    ),
    Shot(
        "global-shutter",
        replace(GLOBAL_SHUTTER, exposure=Exposure(1.9)),
        cadcam.Optics(cadcam.sensor_format("IMX273"), 8.0, 2400.0, 1.4),
        cadcam.BrownConrady(k1=-0.05),
        (200.0, -1900.0, 2300.0),
        (1900.0, 1000.0, 900.0),
        (720, 540),
    ),
    Shot(
        "phone",
        replace(PHONE, exposure=Exposure(1.3)),
        cadcam.Optics(cadcam.SensorFormat("phone", (9.8, 7.3), (4032, 3024)), 6.8, 1500.0, 1.8),
        cadcam.BrownConrady(k1=0.02),
        (4700.0, -1500.0, 2500.0),
        (1900.0, 1000.0, 900.0),
        (720, 540),
        colored=True,
    ),
)


def main(folder: Path, samples: int) -> None:
    """Photograph the block three times."""
    folder.mkdir(parents=True, exist_ok=True)
    photographer = cadcam.Photographer(cadcam.Scene.of(ship_block(triangles=100_000)))
    for shot in SHOTS:
        camera = replace(shot.optics.camera(), lens=shot.lens).resize(shot.size)
        pose = cadcam.Rigid.look_at(shot.eye, shot.at)
        aperture = cadcam.Aperture.of(shot.optics)
        blur = blur_before(shot.sensor, camera, aperture)
        seen = photographer.radiance(
            camera, pose, light=cadcam.named_light("hall"), aperture=aperture, blur_px=blur, samples=samples
        )
        light = seen.over(FLOOR)
        sensor = behind(shot.sensor, camera)
        picture = sensor.apply(light if shot.colored else to_gray(light), rng=np.random.default_rng(1996))
        path = folder / f"photo_{shot.name}.jpg"
        cadcam.write_picture(path, picture, quality=82)
        near, far = shot.optics.depth_of_field(2 * shot.optics.sensor.pitch_mm[0])
        print(f"{path}: sharp within 2 px of the chip from {near:.0f} to {far:.0f} mm")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "."), int(sys.argv[2]) if len(sys.argv) > 2 else 64)
