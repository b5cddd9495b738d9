"""How many instances of a part are found where several lie in one photo: in a tray, and in a heap.

    python benchmarks/locate_instances.py ../shared/data/shipblock_clean --pictures 6
    python benchmarks/locate_instances.py ../shared/data/shipblock_clean --farther 1.6 --on
    python benchmarks/locate_instances.py ../shared/data/shipblock_clean --leaning --on

Draws 6 to 12 instances of the machined bracket, a box and a hexagonal prism on a mottled ground, with noise: apart from
each other and flat on it (tray), or tilted by up to some 30 degrees, the later ones over the earlier (heap). The camera
looks down from 15 to 40 degrees off the vertical; what is declared is that range to 60 degrees, any turn, and the
distance to 20 %; with --on the plane that they lie on in trays, instead of all that. An instance counts if half of it
shows. It is found if no corner is 5 px off, in any of the part's symmetric poses. With --leaning every second one leans
on its neighbour, by 8 to 30 degrees: it does not lie on the plane, is not asked for where that is told; "leaning" are
those believed all the same, of all of which half shows. --within 0.5 states that the plane is known to 0.5 mm: it is
told with errors of half of that (sd), in height and by its slope at the tray's border. "Another part" is looked for in
the same pictures, and should not be found.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cadcam.arrays import Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.image.picture import write_picture
from cadcam.locate.instances import locate_instances
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.views.resting import OnPlane
from cadcam.locate.views.view_range import ViewRange
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Scene
from locate_no_start import RIGHT_PX, Body, bodies, picture

CAMERA = Camera.from_focal((1280, 960), 1800.0)
CHOSEN = {"bracket": "hexagonal prism", "box": "bracket", "hexagonal prism": "box"}  # and what is not there
SHOWS = 0.5  # least share of an instance's silhouette that is not hidden or outside of the picture


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """A picture, the poses camera_from_part of the instances in it, the distance aimed at (mm), and the ground."""

    gray: Picture
    poses: list[Rigid]
    distance: float
    ground: Plane
    side: float
    leaning: frozenset[int] = frozenset()


@dataclass(slots=True, eq=False)
class Tally:
    """Counts over pictures; errors of centroids (mm), squared normalised errors, CPU times (s)."""

    there: int = 0
    found: int = 0
    hidden: int = 0
    wrong: int = 0
    twice: int = 0
    other: int = 0
    leaning: int = 0
    leaning_found: int = 0
    error_mm: list[float] = field(default_factory=list)
    normalised: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)


def laid(body: Body, n: int, rng: np.random.Generator, *, heap: bool) -> tuple[list[Rigid], float]:
    """Return poses (world_from_part) of n instances on the plane z = 0, and the side of the square that they fill."""
    middle, radius = body.mesh.bounds.mean(axis=0), float(np.linalg.norm(body.mesh.size_mm)) / 2
    side, apart = (1.65, 1.0) if heap else (2.2, 1.7)
    side *= radius * np.sqrt(n)
    spots: list[np.ndarray] = []
    poses: list[Rigid] = []
    while len(poses) < n:
        spot = rng.uniform(-side / 2, side / 2, 2)
        turned = exp(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))
        tilted = exp(rng.uniform(-0.5, 0.5, 3)) @ turned
        if any(np.linalg.norm(spot - other) < apart * radius for other in spots):
            side *= 1.001
            continue
        height = 0.6 * radius * np.sqrt(len(poses)) if heap else float(body.mesh.size_mm[2]) / 2
        R = tilted if heap else turned
        spots.append(spot)
        poses.append(Rigid(R, np.array([*spot, height]) - R @ middle))
    return poses, float(side)


def leaning(body: Body, n: int, rng: np.random.Generator) -> tuple[list[Rigid], float]:
    """Return poses of which every second one touches the plane with a corner or an edge, raised at its neighbour."""
    flat, side = laid(body, (n + 1) // 2, rng, heap=False)
    middle, radius = body.mesh.bounds.mean(axis=0), float(np.linalg.norm(body.mesh.size_mm)) / 2
    poses: list[Rigid] = []
    for pose in flat:
        turn, aside = rng.uniform(-np.pi, np.pi, 2)
        towards = np.array([np.cos(aside), np.sin(aside), 0.0])  # the neighbour that is leaned on
        up = exp(np.radians(rng.uniform(8, 30)) * np.cross(towards, [0.0, 0.0, 1.0]))
        R = up @ exp(np.array([0.0, 0.0, turn]))
        foot = pose @ middle - 0.95 * radius * towards
        low = float((body.mesh.vertices @ R.T)[:, 2].min())
        poses += [pose, Rigid(R, np.array([*(foot - R @ middle)[:2], -low]))]
    return poses[:n], 1.3 * side


def pictured(
    body: Body, n: int, noise: float, rng: np.random.Generator, *, heap: bool, farther: float = 1.0, lean: bool = False
) -> Pictured:
    poses, side = leaning(body, n, rng) if lean else laid(body, n, rng, heap=heap)
    distance = 1.25 * farther * side * CAMERA.fx / CAMERA.height
    around, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(15, 40))
    eye = distance * np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)])
    camera_from_world = Rigid.look_at(eye, np.zeros(3))
    scene = Scene.of(body.mesh).repeated(poses)
    gray = picture(open_renderer(scene), camera_from_world, noise, rng, camera=CAMERA)
    ground = Plane.through(camera_from_world @ np.zeros(3), camera_from_world.rotation[:, 2])
    seen = [camera_from_world @ pose for pose in poses]
    return Pictured(gray, seen, distance, ground, side, frozenset(range(1, n, 2) if lean else ()))


def shown(body: Body, poses: list[Rigid]) -> list[float]:
    """Return the share of each instance's silhouette that the picture shows."""
    scene = Scene.of(body.mesh)
    view = open_renderer(scene.repeated(poses)).render(CAMERA, Rigid(), channels=Channel.PART)
    alone = open_renderer(scene)
    wide = CAMERA.crop(-CAMERA.width, -CAMERA.height, (3 * CAMERA.width, 3 * CAMERA.height))
    parts, shares = len(scene.mesh.part_names), []
    for k, pose in enumerate(poses):
        whole = int((alone.render(wide, pose, channels=Channel.PART).part >= 0).sum())
        shares.append(int((view.part // parts == k).sum()) / max(whole, 1) if whole else 0.0)
    return shares


def off_px(body: Body, pose: Rigid, truth: Rigid) -> float:
    p, q = CAMERA.project(pose @ body.mesh.vertices), CAMERA.project(truth @ body.mesh.vertices)
    apart = np.linalg.norm(p - q, axis=1)
    return float(apart.max()) if np.isfinite(apart).all() else np.inf


def nearest(body: Body, pose: Rigid, poses: list[Rigid]) -> tuple[float, int, Rigid]:
    """Return how far off (px) a pose is from the nearest instance, its number, and its symmetric pose that is meant."""
    middle = Rigid(translation=body.mesh.bounds.mean(axis=0))
    alike = [(k, truth @ middle @ Rigid(g) @ middle.inv) for k, truth in enumerate(poses) for g in body.symmetry]
    return min(((off_px(body, pose, truth), k, truth) for k, truth in alike), key=lambda one: one[0])


def count(tally: Tally, body: Body, seen: Pictured, found: list[Location]) -> None:
    shares, middle = shown(body, seen.poses), body.mesh.bounds.mean(axis=0)
    right: set[int] = set()
    for one in found:
        pose = one.pose.world_from_part
        off, k, truth = nearest(body, pose, seen.poses)
        if off >= RIGHT_PX:
            tally.wrong += 1
            continue
        tally.twice += k in right
        right.add(k)
        xi = (pose.inv @ truth).log()
        tally.normalised.append(float(xi @ np.linalg.solve(one.pose.covariance, xi)) / 6)
        tally.error_mm.append(float(np.linalg.norm(pose @ middle - truth @ middle)))
    there = {k for k, share in enumerate(shares) if share >= SHOWS}
    tally.leaning += len(there & seen.leaning)
    tally.leaning_found += len(right & seen.leaning)
    there, right = there - seen.leaning, right - seen.leaning
    tally.there += len(there)
    tally.found += len(there & right)
    tally.hidden += len(right - there)


def declared(seen: Pictured, a: argparse.Namespace, rng: np.random.Generator) -> ViewRange:
    """Return what is declared of a picture: the plane that they lie on, or directions and distances."""
    if a.on and a.within is not None:
        up, x, y = a.within / 2 * rng.normal(size=3) / [1.0, seen.side / 2, seen.side / 2]
        middle, normal = seen.ground.foot([0.0, 0.0, seen.distance]), seen.ground.normal
        sloping = exp(np.array([x, y, 0.0])) @ normal
        return ViewRange(on=OnPlane(Plane.through(middle + up * normal, sloping), within_mm=a.within))
    if a.on:
        return ViewRange(on=OnPlane(seen.ground))
    return ViewRange(half_angle_deg=60, distance_mm=(0.8 * seen.distance, 1.2 * seen.distance))


def row(body: Body, other: Part, a: argparse.Namespace, *, heap: bool) -> str:
    tally, part, sizes = Tally(), Part.of(body.mesh), list[float]()
    for k in range(a.pictures):
        rng = np.random.default_rng([a.seed, k, heap])
        seen = pictured(body, int(rng.integers(6, 13)), a.noise, rng, heap=heap, farther=a.farther, lean=a.leaning)
        sizes.append(2 * part.aspects.radius * CAMERA.fx / seen.distance)
        if a.save is not None:
            write_picture(a.save / f"{body.name}_{'heap' if heap else 'tray'}_{k:02d}.png", seen.gray)
        photo = Photo.of(seen.gray, CAMERA)
        views = declared(seen, a, rng)
        locate_instances(part, [photo], views=views, most=1)  # makes the part's aspects for this distance
        began = time.process_time()
        found = [one for one in locate_instances(part, [photo], views=views) if one.found]
        tally.cpu.append((time.process_time() - began) / max(len(found), 1))
        count(tally, body, seen, found)
        tally.other += sum(one.found for one in locate_instances(other, [photo], views=views))
    errors = np.array(tally.error_mm or [np.nan])
    rms = float(np.sqrt(np.mean(tally.normalised or [np.nan])))
    counts = f"{tally.found} of {tally.there} | {tally.hidden} | {tally.wrong} | {tally.twice}"
    counts += f" | {tally.leaning_found} of {tally.leaning}" if a.leaning else ""
    lying = "leaning" if a.leaning else "heap" if heap else "tray"
    return (
        f"| {body.name} | {lying} | {min(sizes):.0f} to {max(sizes):.0f} | {counts}"
        f" | {np.median(errors):.3f} / {np.quantile(errors, 0.9):.3f} | {rms:.2f}"
        f" | {np.median(tally.cpu):.2f} | {tally.other} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder with the ship block's model.obj")
    parser.add_argument(
        "--pictures", type=int, default=6, help="of each body, in trays and heaps (default %(default)s)"
    )
    parser.add_argument("--noise", type=float, default=3.0, help="grey levels (default %(default)s)")
    parser.add_argument("--seed", type=int, default=7, help="of places, ground and noise (default %(default)s)")
    parser.add_argument("--farther", type=float, default=1.0, help="times the distance (default %(default)s)")
    parser.add_argument("--on", action="store_true", help="the plane that they lie on is known")
    parser.add_argument("--within", type=float, help="mm: how well that plane is known (default: not stated)")
    parser.add_argument("--parts", nargs="+", choices=CHOSEN, default=list(CHOSEN), help="(default: all)")
    parser.add_argument("--leaning", action="store_true", help="every second one leans on its neighbour; no heaps")
    parser.add_argument("--trays", action="store_true", help="no heaps")
    parser.add_argument("--save", type=Path, help="write the pictures into this folder")
    a = parser.parse_args()
    print(
        f"| part | lying | px large | found | beside, half hidden ones | wrong | twice{' | leaning' * a.leaning}",
        end=" | centroid, mm, median / 90 %",
    )
    print(" | normalised | CPU s each | another part found |")
    print("|---|---|---|---|---|---|---|---|---|---|---|" + "---|" * a.leaning)
    every = {body.name: body for body in bodies(a.scene)}
    chosen = {name: next(body for key, body in every.items() if key.startswith(name)) for name in CHOSEN}
    for name in a.parts:
        other = CHOSEN[name]
        for heap in (False,) if a.trays or a.leaning else (False, True):
            print(row(chosen[name], Part.of(chosen[other].mesh), a, heap=heap), flush=True)


if __name__ == "__main__":
    main()
