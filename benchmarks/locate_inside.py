"""How far off a start may be for a camera that stands within a part, most of which is out of view.

    python benchmarks/locate_inside.py --views 24

Two parts: a block of a ship's double bottom, 2.4 x 2.4 x 1.2 m, seen from 0.4 to 0.9 m between its floors, and a girder
of 5 m with stiffeners at unequal distances, seen from 0.4 to 0.8 m beside it, its ends out of view. 768 x 576 px, focal
length 700 px, blur 0.5 px, noise 3 of 255, lights drawn anew for each picture. Starts are turned about what the camera
looks at and shifted across the line of sight, in random directions. An answer is right if no line in view is more than
2 px off. Prints by part and start how many answers are right and found, right whether found or not, wrong and found,
the median error (mm) at what the camera looks at of those that are right and found, and CPU time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.cad.parts.shipblock import ship_block
from cadcam.camera.camera import Camera
from cadcam.errors import CadcamError
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look

CAMERA = Camera.from_focal((768, 576), 700.0)
NOISE, BLUR_PX, RIGHT_PX = 3 / 255, 0.5, 2.0
STARTS = ((3.0, 15.0), (10.0, 30.0), (15.0, 40.0), (20.0, 40.0))  # deg, px
LEAST_PX = 2500.0  # of lines in view
STIFFENERS = (250, 700, 1300, 1750, 2400, 2950, 3300, 3950, 4600)  # mm
Place = tuple[Array, Array]  # eye, target: mm


@dataclass(frozen=True, slots=True)
class Outcome:
    """One answer: whether found, how far off lines in view are at most (px), the place looked at (mm), CPU time."""

    found: bool
    off_px: float
    off_mm: float
    cpu_s: float


def block() -> Part:
    whole = ship_block(triangles=29_000, size=(2400.0, 2400.0, 1200.0))
    return Part.of(whole.subset([name for name in whole.part_names if name != "pipe" and "flange" not in name]))


def girder() -> Part:
    """Return an I-girder, 5000 x 300 x 500 mm, with stiffeners on both sides of its web."""
    flanges = [box((0, 0, z), (5000, 300, z + 20), name=f"flange {z}") for z in (0, 480)]
    web = box((0, 143, 20), (5000, 157, 480), name="web")
    ribs = [
        box((x, y, 20), (x + 12, y + 120, 480), name=f"stiffener {x} {side}")
        for x in STIFFENERS
        for y, side in ((23, "port"), (157, "starboard"))
    ]
    return Part.of(merge([*flanges, web, *ribs]))


def in_block(rng: np.random.Generator) -> Place:
    target = np.array([850.0, 640.0, 100.0]) + rng.normal(0, [300, 200, 50])
    away = np.array([0.0, 0.5, 1.0]) + rng.normal(0, [0.4, 0.3, 0.2])
    return target + rng.uniform(400, 900) * away / np.linalg.norm(away), target


def beside_girder(rng: np.random.Generator) -> Place:
    target = np.array([rng.uniform(1000, 4000), 150.0, rng.uniform(150, 350)])
    away = np.array([0.0, -1.0, 0.2]) + rng.normal(0, [0.3, 0.0, 0.3])
    return target + rng.uniform(500, 800) * away / np.linalg.norm(away), target


PARTS: dict[str, tuple[Callable[[], Part], Callable[[np.random.Generator], Place]]] = {
    "block, between floors": (block, in_block),
    "girder, ends out of view": (girder, beside_girder),
}


def shots(
    part: Part, place: Callable[[np.random.Generator], Place], views: int, seed: int
) -> Iterator[tuple[Photo, Rigid, Array]]:
    """Yield photos whose world is the camera, camera_from_part, and the place (3,) mm that the camera looks at."""
    rng, renderer = np.random.default_rng(seed), open_renderer(part.scene)
    while views:
        eye, target = place(rng)
        pose = Rigid.look_at(eye, target, up=np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.15, 3))
        head, fill, back, ambient = rng.uniform((0.3, 0.2, 0.1, 0.15), (0.6, 0.5, 0.3, 0.3))
        x, y, z = rng.normal([-0.5, -0.8, -0.3], 0.5)
        look = Look(head=head, fill=fill, back=back, ambient=ambient, fill_from=(x, y, z), supersampling=4)
        if part.lines.draw(CAMERA, pose).visible.length_px.sum() < LEAST_PX:
            continue
        gray = gaussian_filter(renderer.render(CAMERA, pose, channels=Channel.IMAGE, look=look).gray, BLUR_PX)
        gray = np.clip(np.round((gray + rng.normal(0, NOISE, gray.shape)) * 255) / 255, 0, 1)
        yield Photo.of(gray.astype(np.float32), CAMERA), pose, target
        views -= 1


def start_of(pose: Rigid, target: Array, degrees: float, px: float, rng: np.random.Generator) -> Rigid:
    """Return a start that is off by so much, in random directions."""
    axis, (x, y), at = rng.normal(size=3), rng.normal(size=2), Rigid(translation=target)
    mm = px * float((pose @ target)[2]) / CAMERA.fx / np.hypot(x, y)
    turn = Rigid.exp([0, 0, 0, *(np.radians(degrees) * axis / np.linalg.norm(axis))])
    return Rigid(translation=np.array([mm * x, mm * y, 0.0])) @ pose @ at @ turn @ at.inv


def outcome(part: Part, photo: Photo, pose: Rigid, target: Array, start: Rigid) -> Outcome:
    began = time.process_time()
    try:
        answer = locate_part(part, [photo], start)
    except CadcamError:
        return Outcome(False, np.inf, np.inf, time.process_time() - began)
    taken, found = time.process_time() - began, answer.pose.world_from_part
    lines = part.lines.draw(CAMERA, pose).visible
    p = lines.p[CAMERA.sees(lines.q)]
    away = np.linalg.norm(CAMERA.project(found @ p) - CAMERA.project(pose @ p), axis=1)
    off_mm = float(np.linalg.norm(found @ target - pose @ target))
    return Outcome(answer.found, float(np.nan_to_num(away, nan=np.inf).max()), off_mm, taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=24, help="of each part (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn (default %(default)s)")
    args = parser.parse_args()
    print("| part | start, deg and px | right and found | right | wrong, found | error mm | CPU ms |")
    print("|---|---|---|---|---|---|---|")
    for name, (make, place) in PARTS.items():
        part = make()
        taken = list(shots(part, place, args.views, args.seed))
        for degrees, px in STARTS:
            rng = np.random.default_rng([args.seed, int(degrees)])
            starts = [start_of(pose, target, degrees, px, rng) for _, pose, target in taken]
            outcomes = [outcome(part, *shot, start) for shot, start in zip(taken, starts, strict=True)]
            right = [o for o in outcomes if o.off_px <= RIGHT_PX]
            found = [o for o in right if o.found]
            wrong = sum(o.found and o.off_px > RIGHT_PX for o in outcomes)
            mm = np.median([o.off_mm for o in found]) if found else np.nan
            cells = [name, f"{degrees:g}, {px:g}", f"{len(found)} of {len(outcomes)}", str(len(right)), str(wrong)]
            ms = 1000 * np.median([o.cpu_s for o in outcomes])
            print("| " + " | ".join([*cells, f"{mm:.3f}", f"{ms:.0f}"]) + " |", flush=True)


if __name__ == "__main__":
    main()
