"""Errors of measured points on a real target with four cameras, and whether their sigmas predict them.

    python benchmarks/measure.py ../shared/data/openptv_cavity

The folder is the calibration set of OpenPTV's test_cavity (github.com/OpenPTV/test_cavity, MIT): 73 dots in two and a
half levels, 70 x 50 x 16 mm, in a water-filled box, seen by four cameras of 1280 x 1024 px. The dots' detections are
matched from the four clicks of each camera; then every dot is left out in turn, all cameras are calibrated from the
others, and the dot is measured with them. "error" is the rms distance from the drawing; "sigma" what the measurement
says of it; "cover" the share of coordinates within 1.96 sigma; "chi2/3" the mean Mahalanobis square by its freedom, 1
if sigmas are right and the drawing exact.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.calibrate.measure.points import METHODS, Method, measure_points
from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.observations import Observations
from cadcam.camera.plane_camera import PlaneCamera
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import CadcamError
from cadcam.fit.dlt import dlt

SIZE = (1280, 1024)
LEAST_AREA = 60  # px: smaller detections are noise
RADII = (30, 20, 12, 8, 6, 5, 5)  # px: how far a detection may be from where the fit before expects it
SETS = {"1, 2": (0, 1), "3, 4": (2, 3), "1, 2, 3, 4": (0, 1, 2, 3)}


def matched(folder: Path) -> tuple[Array, Array]:
    """Return the dots (N, 3) mm and their pixels (4, N, 2), NaN where a camera does not see them."""
    target = np.loadtxt(folder / "cal" / "target_on_a_side.txt")
    clicks = np.loadtxt(folder / "parameters" / "man_ori.dat").reshape(4, 4, 2)
    clicked = np.loadtxt(folder / "parameters" / "man_ori.par", dtype=int).reshape(4, 4)
    dots, q = target[:, 1:4], np.full((4, len(target), 2), np.nan)
    for camera in range(4):
        found = np.loadtxt(folder / "cal" / f"cam{camera + 1}.tif_targets", skiprows=1)
        spots = found[found[:, 3] > LEAST_AREA, 1:3]
        at = np.searchsorted(target[:, 0], clicked[camera])
        flat = PlaneCamera(dlt(dots[at, :2], clicks[camera])).facing(dots[at, :2])
        index, seen = grown(dots, spots, flat.project(dots[:, :2]))
        q[camera, seen] = spots[index[seen]]
    return dots, q


def grown(dots: Array, spots: Array, expected: Array) -> tuple[Longs, Mask]:
    """Return each dot's spot and whether it has one, from a rough expectation, by linear transforms in turns."""
    for radius in RADII:
        distance = np.linalg.norm(expected[:, None] - spots, axis=-1)
        index, seen = distance.argmin(axis=1), distance.min(axis=1) < radius
        u = np.column_stack([dots, np.ones(len(dots))]) @ dlt(dots[seen], spots[index[seen]]).T
        expected = u[:, :2] / u[:, 2:]
    return index, seen


def calibrated(dots: Array, q: Array) -> CameraEstimate:
    seen = np.isfinite(q).all(axis=-1)
    return calibrate_camera(Observations(dots[seen], q[seen]), SIZE)


def left_out(dots: Array, q: Array) -> list[list[CameraEstimate | None]]:
    """Return for every dot the four cameras calibrated without it; None where a calibration is refused."""
    whole = [calibrated(dots, pixels) for pixels in q]
    out: list[list[CameraEstimate | None]] = []
    for i in range(len(dots)):
        row: list[CameraEstimate | None] = []
        for camera, pixels in enumerate(q):
            if np.isnan(pixels[i]).any():
                row.append(whole[camera])
                continue
            try:
                row.append(calibrated(np.delete(dots, i, axis=0), np.delete(pixels, i, axis=0)))
            except CadcamError:
                row.append(None)
        out.append(row)
    return out


def errors(
    dots: Array, q: Array, cameras: tuple[int, ...], estimates: list[list[CameraEstimate | None]], method: Method
) -> tuple[Array, Array, Array]:
    """Return errors, sigmas (n, 3) mm and Mahalanobis squares (n,) of the dots that at least two of the cameras see."""
    error, sigma, square = [], [], []
    for i, row in enumerate(estimates):
        known = [(c, e) for c in cameras if (e := row[c]) is not None and np.isfinite(q[c, i]).all()]
        if len(known) < 2:
            continue
        views = [Viewpoint.fixed(f"{c + 1}", estimate) for c, estimate in known]
        measured = measure_points(views, [q[c, i : i + 1] for c, _ in known], method=method)
        error.append(measured.points[0] - dots[i])
        sigma.append(measured.sigma[0])
        square.append(error[-1] @ np.linalg.solve(measured.covariance[0], error[-1]))
    return np.array(error), np.array(sigma), np.array(square)


def opencv_errors(
    dots: Array, q: Array, cameras: tuple[int, ...], estimates: list[list[CameraEstimate | None]]
) -> Array | None:
    """Return what cv2.triangulatePoints makes of pairs of the same cameras; None where OpenCV is not installed."""
    try:
        import cv2
    except ImportError:
        return None
    error = []
    for i, row in enumerate(estimates):
        known = [(c, e) for c in cameras if (e := row[c]) is not None and np.isfinite(q[c, i]).all()]
        if len(known) == 2:
            P = [matrix(e.camera, e) for _, e in known]
            X = cv2.triangulatePoints(P[0], P[1], q[known[0][0], i], q[known[1][0], i])[:, 0]
            error.append(X[:3] / X[3] - dots[i])
    return np.array(error)


def matrix(camera: Camera, estimate: CameraEstimate) -> Array:
    pose = estimate.camera_from_world
    return np.asarray(camera.K @ np.column_stack([pose.rotation, pose.translation]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="calibration set of test_cavity: ../shared/data/openptv_cavity")
    dots, q = matched(parser.parse_args().folder)
    counts = np.isfinite(q).all(axis=-1).sum(axis=1)
    whole = [calibrated(dots, pixels) for pixels in q]
    print("| camera | dots | residual, px | focal, px |\n|---|---|---|---|")
    for camera, (estimate, count) in enumerate(zip(whole, counts, strict=True), 1):
        focal = f"{estimate.value('focal'):.0f} +- {estimate.sigma('focal'):.0f}"
        print(f"| {camera} | {count} | {estimate.thesis_residual:.3f} | {focal} |")
    estimates = left_out(dots, q)
    refused = sum(e is None for row in estimates for e in row)
    print(f"\nleave one out; {refused} calibrations refused\n")
    print(
        "| cameras | method | dots | error X, Y, Z, mm | sigma X, Y, Z, mm | cover | chi2/3 |\n"
        "|---|---|---|---|---|---|---|"
    )
    for name, cameras in SETS.items():
        for method in METHODS:
            error, sigma, square = errors(dots, q, cameras, estimates, method)
            rms, said = (", ".join(f"{v:.3f}" for v in np.sqrt(np.mean(x**2, axis=0))) for x in (error, sigma))
            cover = 100 * np.mean(np.abs(error) < 1.96 * sigma)
            print(f"| {name} | {method} | {len(error)} | {rms} | {said} | {cover:.0f} % | {square.mean() / 3:.2f} |")
        theirs = opencv_errors(dots, q, cameras, estimates) if len(cameras) == 2 else None
        if theirs is not None:
            rms = ", ".join(f"{v:.3f}" for v in np.sqrt(np.mean(theirs**2, axis=0)))
            print(f"| {name} | cv2.triangulatePoints | {len(theirs)} | {rms} | | | |")


if __name__ == "__main__":
    main()
