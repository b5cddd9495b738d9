"""Is the optimum global? Poses and calibrations against hundreds of random starts, scene by scene.

    python benchmarks/pose_global.py [scenes per row] [random starts]

Each row draws scenes of one kind, solves them through the public functions, and descends from random starts as an
independent search. "lost" counts scenes where a random start ended lower than the library; "hit" is the share of
random starts that found the library's optimum (how wide its basin is); "two" the scenes with a second minimum reported.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES, internals_of
from cadcam.camera.lens import BrownConrady, Division, Fisheye, Ideal
from cadcam.camera.observations import Observations
from cadcam.errors import CadcamError
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.multistart import descend
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)


@dataclass(frozen=True)
class Kind:
    """A kind of scene: points in a box of half-size 150 mm flattened by `flat`, seen from `near`..`far` box sizes."""

    name: str
    camera: Camera
    points: int
    noise_px: float
    flat: float = 1.0
    tilt_deg: float | None = None
    near: float = 1.5
    far: float = 8.0


def kinds() -> Iterator[Kind]:
    plain = Camera.from_focal(SIZE, 800.0)
    for points in (4, 5, 6, 10):
        for noise in (0.3, 5.0):
            yield Kind(f"space, {points} points, {noise} px", plain, points, noise)
    for tilt in (1.0, 17.0, 45.0, 75.0):
        for points, noise in ((4, 0.5), (8, 0.5), (8, 5.0)):
            yield Kind(f"flat, {tilt:.0f} deg, {points} points, {noise} px", plain, points, noise, 0.0, tilt)
    yield Kind("nearly flat (5 %), 6 points, 1 px", plain, 6, 1.0, 0.05)
    yield Kind("long lens, 6 points, 1 px", Camera.from_focal(SIZE, 8000.0), 6, 1.0)
    yield Kind("long lens, 4 points, 3 px", Camera.from_focal(SIZE, 8000.0), 4, 3.0)
    wide = Camera.from_focal(SIZE, 250.0)
    yield Kind("wide angle, 6 points, 1 px", wide, 6, 1.0, near=1.0, far=2.0)
    yield Kind("wide angle, 4 points, 5 px", wide, 4, 5.0, near=1.0, far=2.0)
    brown = Camera.from_focal(SIZE, 600.0, lens=BrownConrady(-0.25, 0.08, 0.001, -0.001))
    yield Kind("Brown-Conrady, 6 points, 2 px", brown, 6, 2.0)
    yield Kind("division, 5 points, 2 px", Camera.from_focal(SIZE, 600.0, lens=Division(-0.2)), 5, 2.0)
    fisheye = Camera.from_focal(SIZE, 300.0, lens=Fisheye(-0.02, 0.003))
    yield Kind("fisheye, 6 points, 2 px", fisheye, 6, 2.0, near=1.0)
    yield Kind("fisheye, 4 points, 2 px", fisheye, 4, 2.0, near=1.0)


def calibration_kinds() -> Iterator[Kind]:
    for f in (400.0, 800.0, 2500.0):
        for points in (6, 7, 8, 12):
            for noise in (0.3, 2.0):
                camera = Camera.from_focal(SIZE, f)
                yield Kind(f"focal {f:.0f}, {points} points, {noise} px", camera, points, noise, far=3.0)


def scene(kind: Kind, rng: np.random.Generator) -> Observations:
    """Return one scene of this kind; every point lies in the picture before noise."""
    opening = min(SIZE) / 2 / kind.camera.fx
    while True:
        p = rng.uniform(-150, 150, (kind.points, 3)) * [1, 1, kind.flat]
        R = so3.from_quaternion(rng.normal(size=4))
        if kind.tilt_deg is not None:
            axis = so3.exp([0, 0, rng.uniform(0, 2 * np.pi)]) @ [1.0, 0, 0]
            R = so3.exp(np.radians(kind.tilt_deg) * axis) @ so3.exp([0, 0, rng.uniform(0, 2 * np.pi)])
        distance = 150 / opening * rng.uniform(kind.near, kind.far)
        aside = rng.uniform(-0.3, 0.3, 2) * distance * opening
        q = kind.camera.project(Rigid(R, np.array([*aside, distance])) @ p)
        if np.isfinite(q).all() and kind.camera.sees(q).all():
            return Observations(p + np.array([1000, 2000, 500]), q + rng.normal(size=q.shape) * kind.noise_px)


def random_starts(model: CameraModel, internals: Array, rng: np.random.Generator) -> Array:
    """Return cameras looking at the points' centre from everywhere, 1.1 to 100 radii away."""
    count = len(internals)
    R = so3.from_quaternion(rng.normal(size=(count, 4)))
    centre = model.p_world.mean(axis=0)
    radius = np.linalg.norm(model.p_world - centre, axis=1).max()
    distance = radius * np.exp(rng.uniform(np.log(1.1), np.log(100), count))
    return model.states(centre - distance[:, None] * R[:, 2], R, internals)


def random_pose_search(kind: Kind, seen: Observations, starts: int, rng: np.random.Generator) -> Array:
    """Return the sums of squares that random starts end with, internals known."""
    model = CameraModel(seen.p_world, seen.q, EXTERNALS, kind.camera.lens)
    internals = np.broadcast_to(internals_of(kind.camera.K), (starts, 5))
    return descend(model, random_starts(model, internals, rng), 100)[1]


def random_calibration_search(kind: Kind, seen: Observations, starts: int, rng: np.random.Generator) -> Array:
    """Return the sums of squares that random starts end with: poses first, then all eleven parameters."""
    focal = np.exp(rng.uniform(np.log(150), np.log(8000), starts))
    one = np.ones(starts)
    internals = np.stack([one, focal, 0 * one, rng.uniform(0, 576, starts), rng.uniform(0, 768, starts)], axis=-1)
    pose = CameraModel(seen.p_world, seen.q, EXTERNALS, Ideal())
    states, _ = descend(pose, random_starts(pose, internals, rng), 15)
    return descend(CameraModel(seen.p_world, seen.q, NAMES, Ideal()), states, 150)[1]


Search = Callable[[Kind, Observations, int, np.random.Generator], Array]
Solve = Callable[[Kind, Observations], CameraEstimate]


@dataclass(frozen=True)
class Row:
    """What became of the scenes of one kind."""

    name: str
    lost: int
    refused: Counter[str]
    two: int
    hits: tuple[float, ...]
    seconds: float

    def __str__(self) -> str:
        hit = f"{100 * np.mean(self.hits):5.1f} {100 * np.min(self.hits):5.1f}" if self.hits else "    -     -"
        why = ", ".join(f"{n} {name}" for name, n in self.refused.items())
        refused = self.refused.total()
        return f"{self.name:38s} {self.lost:5d} {refused:8d} {self.two:5d}   {hit}   {1e3 * self.seconds:6.0f}  {why}"


def study(kind: Kind, scenes: int, starts: int, solve: Solve, search: Search, seed: int) -> Row:
    """Return one row of the table."""
    rng = np.random.default_rng(seed)
    lost = two = 0
    refused: Counter[str] = Counter()
    hits, times = [], []
    for _ in range(scenes):
        seen = scene(kind, rng)
        begin = time.perf_counter()
        try:
            estimate = solve(kind, seen)
        except CadcamError as error:
            refused[type(error).__name__] += 1
            continue
        finally:
            times.append(time.perf_counter() - begin)
        ours = estimate.sum_of_squares
        theirs = search(kind, seen, starts, rng)
        tolerance = 1e-6 * ours + 1e-9
        lost += bool(theirs.min() < ours - tolerance)
        two += estimate.alternative is not None
        hits.append(float(np.mean(theirs < ours + 1e-4 * ours + 1e-9)))
    return Row(kind.name, lost, refused, two, tuple(hits), float(np.median(times)))


def solve_pose(kind: Kind, seen: Observations) -> CameraEstimate:
    return locate_camera(seen, kind.camera)


def solve_calibration(kind: Kind, seen: Observations) -> CameraEstimate:
    return calibrate_camera(seen, SIZE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="?", type=int, default=50, help="scenes a row")
    parser.add_argument("starts", nargs="?", type=int, default=200, help="random starts of each scene")
    given = parser.parse_args()
    scenes, starts = given.scenes, given.starts
    head = f"{'':38s} {'lost':>5s} {'refused':>8s} {'two':>5s}   {'hit %':>5s} {'least':>5s}   {'ms':>6s}"
    print(f"pose, internals known; {scenes} scenes a row, {starts} random starts each\n{head}")
    for seed, kind in enumerate(kinds()):
        print(study(kind, scenes, starts, solve_pose, random_pose_search, seed), flush=True)
    print(f"\ncalibration, all eleven free\n{head}")
    for seed, kind in enumerate(calibration_kinds()):
        print(study(kind, scenes, starts, solve_calibration, random_calibration_search, seed), flush=True)


if __name__ == "__main__":
    main()
