"""CPU time of a joint calibration with its covariance, compared with OpenCV and COLMAP's bundle adjuster.

    python benchmarks/calibrate.py [--views 50 500] [--repeats 5]

Views of a flat board of 10 x 10 points in random poses, noise 0.2 px, nine shared internals (fx fy cx cy k1 k2 p1 p2
k3). CPU time of one call, all threads together, median of the repeats, all taken in turn. Ours ends with the full
covariance of internals and poses; OpenCV is timed with and without its standard deviations; pycolmap gives none and has
no k3 here (its richer model cannot hold k4 k5 k6 at zero; a row of ours is without it too). Ours and OpenCV start
without a guess; pycolmap, and ours in rows of their own, from internals 3 % off (pycolmap also from poses 0.01 rad off,
ours from none). Of pycolmap only the solving counts, not the making of its model; its residuals and ours are summed up
after the clock has stopped. A peer that is not installed is left out, and what takes a minute is timed once. "rms" is
that of a pixel coordinate at the end: the same for all who arrive.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.geometry import rotation as so3

SIZE = (1280, 960)
TRUE = Camera.from_focal(SIZE, 1100.0, fy=1103.0, cx=652.0, cy=471.0, lens=BrownConrady(-0.2, 0.1, 1e-3, -5e-4, -0.02))
TERMS = ("k1", "k2", "p1", "p2", "k3")


Timed = Callable[[], tuple[float, float]]  # CPU time, s, and rms of a pixel coordinate


@dataclass(frozen=True)
class Job:
    """A board (100, 3) mm, its pixels (k, 100, 2), and the true poses R (k, 3, 3), t (k, 3)."""

    board: Array
    q: Array
    R: Array
    t: Array


def job(views: int, rng: np.random.Generator) -> Job:
    x, y = np.meshgrid(np.arange(10) * 20.0 - 90, np.arange(10) * 20.0 - 90)
    board = np.column_stack([x.ravel(), y.ravel(), np.zeros(100)])
    R = so3.exp(rng.normal(size=(views, 3)) * [0.4, 0.4, 0.8])
    t = np.column_stack([rng.uniform(-60, 60, (views, 2)), rng.uniform(350, 600, views)])
    q = TRUE.project(board @ np.swapaxes(R, -1, -2) + t[:, None])
    return Job(board, q + 0.2 * rng.normal(size=q.shape), R, t)


def ours(work: Job, guess: Camera | None = None, terms: tuple[str, ...] = TERMS) -> Timed:
    views = [Observations(work.board, q) for q in work.q]

    def call() -> tuple[float, float]:
        start = time.process_time()
        found = calibrate_jointly(views, SIZE, fixed={"skew": 0}, lens=BrownConrady(), free_lens=terms, guess=guess)
        return time.process_time() - start, found.rms_px

    return call


def opencv(work: Job, *, sigmas: bool) -> Callable[[], float]:
    import cv2

    cv2.setNumThreads(1)
    board = [work.board.astype(np.float32)] * len(work.q)
    pixels = [q.astype(np.float32) for q in work.q]

    def call() -> float:
        function = cv2.calibrateCameraExtended if sigmas else cv2.calibrateCamera
        return float(function(board, pixels, SIZE, None, None)[0]) / float(np.sqrt(2))

    return call


def colmap(work: Job) -> Timed:
    """Return a call whose time is that of the solving alone, not of making the model in Python."""
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.refine_points3D = False
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1

    def call() -> tuple[float, float]:
        world = _colmap_world(work)
        config = pycolmap.BundleAdjustmentConfig()
        for image in world.images:
            config.add_image(image)
        adjuster = pycolmap.create_default_bundle_adjuster(options, config, world)
        start = time.process_time()
        adjuster.solve()
        seconds = time.process_time() - start
        world.update_point_3d_errors()
        q = [world.images[j + 1].project_point(x) for j in range(len(work.q)) for x in work.board]
        return seconds, float(np.sqrt(np.mean((np.array(q) - 0.5 - work.q.reshape(-1, 2)) ** 2)))

    return call


def _colmap_world(work: Job) -> Any:
    import pycolmap

    world = pycolmap.Reconstruction()
    values = [0.97 * TRUE.fx, 0.97 * TRUE.fy, SIZE[0] / 2, SIZE[1] / 2, 0, 0, 0, 0]
    turned = work.R @ so3.exp(np.random.default_rng(0).normal(size=work.t.shape) * 0.01)
    camera = pycolmap.Camera(model="OPENCV", width=SIZE[0], height=SIZE[1], params=values, camera_id=1)
    world.add_camera_with_trivial_rig(camera)
    for j, q in enumerate(work.q):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turned[j]), work.t[j])
        image = pycolmap.Image(name=str(j), keypoints=q + 0.5, camera_id=1, image_id=j + 1)
        world.add_image_with_trivial_frame(image, pose)
    for i, x in enumerate(work.board):
        track = pycolmap.Track()
        for j in range(len(work.q)):
            track.add_element(j + 1, i)
        world.add_point3D(x, track)
    return world


def timed(call: Callable[[], float]) -> Timed:
    """Return a call that also says how much CPU time it took, s."""

    def whole() -> tuple[float, float]:
        start = time.process_time()
        rms = call()
        return time.process_time() - start, rms

    return whole


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--views", type=int, nargs="+", default=[50, 500])
    arguments.add_argument("--repeats", type=int, default=5)
    given = arguments.parse_args()
    rng = np.random.default_rng(20261121)
    for views in given.views:
        work = job(views, rng)
        near = Camera.from_focal(SIZE, 0.97 * TRUE.fx)
        calls: dict[str, Timed] = {
            "cadcam, full covariance": ours(work),
            "cadcam, full covariance, guess given": ours(work, near),
            "cadcam, no k3, full covariance, guess given": ours(work, near, TERMS[:4]),
        }
        for sigmas in (False, True):
            try:
                name = "OpenCV, with standard deviations" if sigmas else "OpenCV, no covariance"
                calls[name] = timed(opencv(work, sigmas=sigmas))
            except ImportError:
                print("OpenCV is not installed")
        try:
            calls["pycolmap, no k3, no covariance, guess and poses given"] = colmap(work)
        except ImportError:
            print("pycolmap is not installed")
        times: dict[str, list[float]] = {name: [] for name in calls}
        rms: dict[str, float] = {}
        for turn in range(given.repeats + 1):
            for name, call in calls.items():
                if "deviations" in name and views > 100 and turn != 1:
                    continue  # a minute
                seconds, rms[name] = call()
                times[name] += [seconds] if turn else []
        print(f"\n{views} views x 100 points, 9 internals\n\n| | CPU ms | rms px |\n|---|---|---|")
        for name in calls:
            print(f"| {name} | {1e3 * statistics.median(times[name]):.0f} | {rms[name]:.5f} |")


if __name__ == "__main__":
    main()
