"""How well a part is located before a ground that is white or nearly so, as before a backlight.

    python benchmarks/locate_backlit.py --views 16

The bracket of `cadcam.cad.parts`, one photo each from 330 to 450 mm, 15 to 60 degrees from its upright, f = 1100 px:
rendered before a ground of 1, blurred by 0.5 px beyond the pixels, times a level, with noise, clipped at white, in
eight bits. Starts are off by 2 mm and 0.02 rad (sd). Prints by level of the ground and noise how many are found; of
those the median and the largest error of the part's middle (mm), and the root mean square of the pose's error over its
covariance (1: as stated).
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look

CAMERA = Camera.from_focal((800, 600), 1100.0)
LOOK = Look(supersampling=4, background=(1.0, 1.0, 1.0))
BLUR_PX = 0.5
CASES = ((0.9, 0.01), (0.97, 0.01), (0.97, 0.02), (1.0, 0.005), (1.0, 0.01), (1.0, 0.02), (1.02, 0.01), (1.3, 0.01))


def view(part: Part, rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera that looks down at the part."""
    tilt, azimuth, away = np.radians(rng.uniform(15, 60)), rng.uniform(0, 2 * np.pi), rng.uniform(330, 450)
    up = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
    return Rigid.look_at(part.aspects.centre + away * up, part.aspects.centre)


def row(part: Part, level: float, noise: float, views: int) -> str:
    """Return the table's row of a level of the ground and a noise."""
    rng, renderer, off_mm, squared = np.random.default_rng(3), open_renderer(part.scene), [], []
    for _ in range(views):
        pose = view(part, rng)
        light = level * gaussian_filter(renderer.render(CAMERA, pose, channels=Channel.IMAGE, look=LOOK).gray, BLUR_PX)
        seen = np.round(255 * np.clip(light + noise * rng.normal(size=light.shape), 0, 1)) / 255
        start = pose @ Rigid.exp(rng.normal(size=6) * np.repeat([2.0, 0.02], 3))
        located = locate_part(part, [Photo.of(seen.astype(np.float32), CAMERA)], start)
        if not located.found:
            continue
        xi = (located.pose.world_from_part.inv @ pose).log()
        squared.append(float(xi @ np.linalg.solve(located.pose.covariance, xi)) / 6)
        middle = part.aspects.centre
        off_mm.append(float(np.linalg.norm(located.pose.world_from_part @ middle - pose @ middle)))
    errors = f"{np.median(off_mm):.3f} / {np.max(off_mm):.3f} | {np.sqrt(np.mean(squared)):.2f}" if off_mm else "|"
    return f"| {level:g} | {noise:g} | {len(off_mm)} of {views} | {errors} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=16, help="of each case (default %(default)s)")
    views = parser.parse_args().views
    part = Part.of(machined_bracket())
    print("| ground, of white | noise, of white | found | error, median / largest, mm | normalised |")
    print("|---|---|---|---|---|")
    for level, noise in CASES:
        print(row(part, level, noise, views), flush=True)


if __name__ == "__main__":
    main()
