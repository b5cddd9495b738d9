"""Coverage of a calibration's 95 % intervals: how often they contain the truth.

    python benchmarks/coverage.py [--near] [simulated calibrations a scene] [scene ...]

Each calibration has a pose and noise of its own and goes through the public functions. --near: each starts at the true
camera (a joint calibration of one view, with a guess), which spares the search and tells the same minimum many times
as fast: a thousand calibrations know a share to 0.7 % only, eight thousand to a quarter of a per cent.

"stated" intervals know the noise (sigma_px; 1.96 sigma), "residuals" take it from the residuals (Student's quantile for
the degrees of freedom). Projections are pixels (x, y) of fixed world points which the true camera sees at the picture's
centre and corners, at the depth of the calibration's points. The last column is how far 95 % may be missed by chance,
3 standard errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import ExtendedPinhole
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)
SIGMA = 0.5
LEVEL = 0.95
PINHOLE = ExtendedPinhole(0, 0, 0, 0, 0, 0, 1.007, 805.9, np.radians(0.01), 319.7, 354.7)
POSE = ExtendedPinhole.from_vector(
    [7.7, 416.3, -210.4, *np.radians([-9.04, -9.44, -2.36]), 1.0, 1.0, 0.0, 0.0, 0.0]
).camera_from_world
BENCH = np.array(
    [[x, y, z] for z in (-1040.0, -1410.0)
     for x, y in ((0, 80), (10, 220), (10, 400), (100, 140), (110, 300), (220, 230), (250, 80), (290, 400))]
)  # fmt: skip
BOX = np.random.default_rng(7).uniform([-150, -50, -1500], [400, 550, -950], (40, 3))
Solve = Callable[[Observations, Camera], CameraEstimate]


@dataclass(frozen=True)
class Scene:
    """A kind of calibration: the points, the true camera, and how it is estimated."""

    points: Array
    camera: Camera
    solve: Solve
    sigma: float = SIGMA
    near: Solve | None = None


@dataclass
class Count:
    """How many intervals of one quantity held the truth."""

    stated: int = 0
    residuals: int = 0


@dataclass
class Coverage:
    """Counts by quantity, of so many calibrations."""

    calibrations: int = 0
    counts: dict[str, Count] = field(default_factory=dict)

    def add(self, quantity: str, error: float, sigma: float, limits: tuple[float, float]) -> None:
        """Count an error by its sigma for noise 1 px, held or not; limits: half widths in those sigmas."""
        count = self.counts.setdefault(quantity, Count())
        count.stated += abs(error) <= limits[0] * sigma
        count.residuals += abs(error) <= limits[1] * sigma


def scenes() -> Mapping[str, Scene]:
    """Return the kinds of calibration."""
    plain = PINHOLE.camera(SIZE)
    square = Camera.from_focal(SIZE, 800.0)
    curved = Camera(SIZE, plain.K, BrownConrady(-0.2))
    fixed = {"skew": 0.0, "aspect": 1.0}
    return {
        "bench of 16 points, eleven free": Scene(BENCH, plain, lambda o, c: calibrate_camera(o, c.size), near=_near()),
        "bench, skew and aspect fixed": Scene(
            BENCH, square, lambda o, c: calibrate_camera(o, c.size, fixed=fixed), near=_near(fixed=fixed)
        ),
        "40 points, eleven and k1 free": Scene(
            BOX,
            curved,
            lambda o, c: calibrate_camera(o, c.size, lens=BrownConrady(), free_lens=("k1",)),
            near=_near(lens=BrownConrady(), free_lens=("k1",)),
        ),
        "bench, pose alone": Scene(BENCH, plain, locate_camera),
    }


def _near(**model: Any) -> Solve:
    """Return a calibration that starts at the true camera."""
    return lambda o, c: calibrate_jointly([o], c.size, guess=c, **model).view(0)


def coverage(scene: Scene, calibrations: int, rng: np.random.Generator) -> Coverage:
    """Return how often the intervals held, over simulated calibrations."""
    result = Coverage(calibrations)
    for _ in range(calibrations):
        pose = _pose(scene, rng)
        q = scene.camera.project(pose @ scene.points) + scene.sigma * rng.standard_normal((len(scene.points), 2))
        _judge(result, scene, pose, scene.solve(Observations(scene.points, q), scene.camera))
    return result


def _pose(scene: Scene, rng: np.random.Generator) -> Rigid:
    """Return a pose near that of Table 2.9 from which the camera sees every point."""
    while True:
        pose = POSE @ Rigid.exp(np.concatenate([rng.uniform(-40, 40, 3), rng.uniform(-0.05, 0.05, 3)]))
        if scene.camera.sees(scene.camera.project(pose @ scene.points)).all():
            return pose


def _judge(result: Coverage, scene: Scene, pose: Rigid, estimate: CameraEstimate) -> None:
    from scipy.stats import norm, t

    assert estimate.sigma0 is not None
    half = (1 + LEVEL) / 2
    limits = norm.ppf(half) * scene.sigma, t.ppf(half, estimate.dof) * estimate.sigma0
    unit = np.sqrt(np.diag(estimate.covariance)) / estimate.noise_px
    truth = np.append(ExtendedPinhole.from_camera(scene.camera, pose).vector, list(_lens(scene.camera)))
    for i, name in enumerate(estimate.parameters):
        if name in estimate.free:
            result.add(name, estimate.values[i] - truth[i], unit[i], limits)
    p = _places(scene, pose)
    off = estimate.camera.project(estimate.camera_from_world @ p) - scene.camera.project(pose @ p)
    spread = np.sqrt(np.diagonal(estimate.projection_covariance(p), axis1=1, axis2=2)) / estimate.noise_px
    for i, place in enumerate(("centre", "top left", "top right", "bottom left", "bottom right")):
        for j, axis in enumerate("xy"):
            result.add(f"{place} {axis}", off[i, j], spread[i, j], limits)


def _lens(camera: Camera) -> list[float]:
    return list(camera.lens.parameters.values())


def _places(scene: Scene, pose: Rigid) -> Array:
    """Return the world points seen at the centre and the corners."""
    w, h = scene.camera.size
    q = np.array([[(w - 1) / 2, (h - 1) / 2], [0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]])
    rays = scene.camera.unproject(q)
    depth = (pose @ scene.points)[:, 2].mean()
    return np.asarray(pose.inv @ (rays * depth / rays[:, 2:]))


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("calibrations", type=int, nargs="?", default=500)
    arguments.add_argument("scenes", nargs="*", metavar="scene")
    arguments.add_argument("--near", action="store_true")
    given = arguments.parse_args()
    if unknown := set(given.scenes) - set(scenes()):
        arguments.error(f"no scene {unknown.pop()!r}; scenes are {', '.join(scenes())}")
    calibrations = given.calibrations
    chance = 300 * np.sqrt(LEVEL * (1 - LEVEL) / calibrations)
    for i, (name, scene) in enumerate(scenes().items()):
        solve = scene.near if given.near else scene.solve
        if solve is None or (given.scenes and name not in given.scenes):
            continue
        result = coverage(replace(scene, solve=solve), calibrations, np.random.default_rng([20, i]))
        print(f"{name}; {calibrations} calibrations{', near' * given.near}")
        print(f"{'':22s}  stated %  residuals %   by chance")
        for quantity, count in result.counts.items():
            stated, residuals = (100 * k / calibrations for k in (count.stated, count.residuals))
            print(f"{quantity:22s}  {stated:8.1f}  {residuals:11.1f}  +- {chance:6.1f}")
        print(flush=True)


if __name__ == "__main__":
    main()
