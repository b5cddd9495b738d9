"""How often long profiles are located from rough starts: flat bar, angle, tee, channel, I-beam, alone in the picture.

    python benchmarks/locate_slender.py --views 16

Nearly all lines of a bar run along it and are the same wherever it is shifted to; its ends tell the rest. Each profile,
10 to 20 times as long as wide, is rendered from directions drawn evenly, less often end-on, 0.6 to 0.8 of the picture
long, with noise of 3 of 255, and located from a start 5 to 20 degrees, 5 to 40 px and up to 10 % of the depth off. An
answer is right if no corner is more than 4 px off, in one of the part's symmetric poses. Prints by profile how many
answers are found and right, found and wrong, and right whether found or not.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look

CAMERA = Camera.from_focal((1280, 1024), 1600.0)
LOOK = Look(head=0.25, fill=0.7, back=0.1, fill_from=(0.7, -0.6, 0.1), background=(0.35, 0.35, 0.35), supersampling=4)
NOISE, BLUR_PX, RIGHT_PX = 3 / 255, 0.6, 4.0
Boxes = tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
PROFILES: dict[str, Boxes] = {  # mm
    "flat bar 2000 x 100 x 10": (((0, 0, 0), (2000, 100, 10)),),
    "angle 1500 x 100 x 75": (((0, 0, 0), (1500, 100, 8)), ((0, 0, 8), (1500, 8, 75))),
    "tee 1500 x 120 x 150": (((0, 0, 0), (1500, 120, 8)), ((0, 56, 8), (1500, 64, 150))),
    "channel 1200 x 80 x 45": (
        ((0, 0, 0), (1200, 80, 6)),
        ((0, 0, 6), (1200, 6, 45)),
        ((0, 74, 6), (1200, 80, 45)),
    ),
    "I-beam 1000 x 100 x 100": (
        ((0, 0, 0), (1000, 100, 8)),
        ((0, 47, 8), (1000, 53, 92)),
        ((0, 0, 92), (1000, 100, 100)),
    ),
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """One answer: whether found, how far off its corners are at most (px), CPU time."""

    found: bool
    off_px: float
    cpu_s: float


def profile(boxes: Boxes) -> Mesh:
    """Return a profile, a body for each of its walls."""
    return merge([box(low, high, name=f"wall {k}") for k, (low, high) in enumerate(boxes)])


def drawn(part: Part, rng: np.random.Generator) -> Rigid:
    """Return camera_from_part with all of the part in the picture."""
    v, centre, radius = part.scene.mesh.vertices, part.aspects.centre, part.aspects.radius
    while True:
        towards = rng.normal(size=3) * [0.5, 1.0, 1.0]
        away = 2 * radius * CAMERA.fx / (rng.uniform(0.6, 0.8) * CAMERA.width)
        seen = Rigid.look_at(centre + away * towards / np.linalg.norm(towards), centre)
        pose = Rigid.exp([0, 0, 0, 0, 0, rng.uniform(-math.pi, math.pi)]) @ seen
        q = CAMERA.project(pose @ v)
        if (q > 10).all() and (q < np.array(CAMERA.size) - 10).all():
            return pose


def photo_of(part: Part, pose: Rigid, rng: np.random.Generator) -> Photo:
    """Return the noisy photo; its world is the camera."""
    gray = open_renderer(part.scene).render(CAMERA, pose, channels=Channel.IMAGE, look=LOOK).gray
    return Photo.of(
        np.clip(gaussian_filter(gray, BLUR_PX) + rng.normal(scale=NOISE, size=gray.shape), 0, 1).astype(np.float32),
        CAMERA,
    )


def start_of(part: Part, pose: Rigid, rng: np.random.Generator) -> Rigid:
    """Return a rough start."""
    middle = Rigid(translation=part.aspects.centre)
    axis, way = rng.normal(size=3), rng.normal(size=2)
    z = float((pose @ middle.translation)[2])
    aside = rng.uniform(5, 40) * way / np.linalg.norm(way) * z / CAMERA.fx
    turn = Rigid.exp([0, 0, 0, *(math.radians(rng.uniform(5, 20)) * axis / np.linalg.norm(axis))])
    return Rigid(translation=np.array([*aside, rng.uniform(-0.1, 0.1) * z])) @ pose @ middle @ turn @ middle.inv


def off_px(part: Part, found: Rigid, pose: Rigid) -> float:
    """Return how far (px) the farthest corner is off, in the best of the symmetric poses."""
    v = part.scene.mesh.vertices
    q: Array = CAMERA.project(pose @ v)
    away = [np.linalg.norm(CAMERA.project(found @ S @ v) - q, axis=1).max() for S in part.symmetries]
    return float(np.nanmin(away))


def outcome(part: Part, rng: np.random.Generator) -> Outcome:
    pose = drawn(part, rng)
    photo, start = photo_of(part, pose, rng), start_of(part, pose, rng)
    began = time.process_time()
    answer = locate_part(part, [photo], start)
    taken = time.process_time() - began
    return Outcome(answer.found, off_px(part, answer.pose.world_from_part, pose), taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=16, help="of each profile (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn (default %(default)s)")
    given = parser.parse_args()
    print("| profile | views | found, right | found, wrong | right, whether found or not | CPU median, ms |")
    print("|---|---|---|---|---|---|")
    for name, boxes in PROFILES.items():
        part, rng = Part.of(profile(boxes)), np.random.default_rng(given.seed)
        every = [outcome(part, rng) for _ in range(given.views)]
        right = [o.off_px < RIGHT_PX for o in every]
        both = sum(o.found and r for o, r in zip(every, right, strict=True))
        wrong = sum(o.found and not r for o, r in zip(every, right, strict=True))
        ms = 1000 * np.median([o.cpu_s for o in every])
        print(f"| {name} | {len(every)} | {both} | {wrong} | {sum(right)} | {ms:.0f} |", flush=True)


if __name__ == "__main__":
    main()
