"""Marks in pictures: error of every sub-pixel rule over its Cramer-Rao bound, and detection in real photos.

    python benchmarks/targets.py [--only rendered,grid,robust,speed,real] [--samples 64] [--data ../shared/data]
                                 [--pictures FOLDER]

rendered: single marks, exact area coverage, Gaussian blur, uniform noise; the truth is where the camera sees the mark's
centre. The bound is that of the grey values with all but the position known, from differences of the renderer's own
pictures. "ratio" is rms error by bound, "bias" the mean error's length, "told" the rms error by the one predicted,
through the camera and, of upright marks, without it.
Peers: OpenCV (extra `boards`), left out where it is not installed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.errors import CadcamError
from cadcam.geometry.rigid import Rigid
from cadcam.image.draw import draw_points, draw_polylines
from cadcam.image.picture import read_picture, to_gray, write_picture
from cadcam.target.boards.opencv import has_opencv
from cadcam.target.marks.cross import Taps, surface, taps, template
from cadcam.target.marks.find import FoundMark, MarkOptions, find_marks
from cadcam.target.marks.fit import fit_marks
from cadcam.target.marks.ideal import board_picture, marks_picture
from cadcam.target.marks.mark import Mark, MarkSheet, dot, dot_and_ring, inverted
from cadcam.target.marks.pose_ambiguity import fit_both_tilts
from cadcam.target.marks.subpixel import Peak, centroid, parabola

SIDE, FOCAL, RADIUS = 72, 800.0, 12.0  # px
PAPER, INK = 0.8, 0.2
MARKS = (dot(24.0), dot_and_ring(8.0, 16.0, 24.0))
TILTS = (0.0, 30.0, 45.0, 60.0)
NORMAL_SD = np.radians(3.0)  # of what is known of the plane
CASES = ((2, 1.0), (5, 1.0), (15, 1.0), (5, 0.5), (5, 1.5))  # noise in grey levels of 255, blur in px
Rule = Callable[[Picture], Array]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--only", default="rendered,grid,robust,speed,real")
    arguments.add_argument("--samples", type=int, default=64)
    arguments.add_argument("--marks", type=int, nargs="+", default=range(len(MARKS)))
    arguments.add_argument("--tilts", type=float, nargs="+", default=TILTS)
    arguments.add_argument("--data", type=Path)
    arguments.add_argument("--pictures", type=Path)
    arguments.add_argument(
        "--sets", nargs="+", default=[], help="of the real ones, such as visp_circles dbat_camcal/P8250021"
    )
    given = arguments.parse_args()
    studies: dict[str, Callable[[], None]] = {
        "rendered": lambda: rendered(given.samples, [MARKS[k] for k in given.marks], given.tilts),
        "grid": grid,
        "robust": robust,
        "speed": speed,
        "real": lambda: real(given.data, given.pictures, given.sets),
    }
    if not has_opencv():
        print("OpenCV is not installed: its columns are left out\n")
    for name in given.only.split(","):
        if name == "real" and given.data is None:
            print("real: no --data given\n")
            continue
        studies[name]()
        sys.stdout.flush()


def camera_at(phase: Array) -> Camera:
    """Return a camera that sees what lies on (0, 0, z) at `phase` px from the middle of its picture, off its axis.

    The principal point lies far beside the picture, as it does for most marks of a large one.
    """
    cx, cy = (SIDE - 1) / 2 + phase
    return Camera.from_focal((SIDE, SIDE), FOCAL, cx=cx, cy=cy)


def pose_of(tilt: float, turn: float = 0.7) -> Rigid:
    """Return camera_from_mark of a mark of 12 px radius if upright, tilted about an axis `turn` rad in the picture."""
    tilted = Rigid.exp([0, 0, 0, 0, 0, turn]) @ Rigid.exp([0, 0, 0, np.radians(tilt), 0, 0])
    return Rigid(tilted.rotation, np.array([0.0, 0.0, FOCAL * 12.0 / RADIUS]))


def clean(mark: Mark, tilt: float, phase: Array) -> tuple[Picture, Camera]:
    """Return the sharp picture of a mark, paper all around, and its camera."""
    camera = camera_at(phase)
    picture = marks_picture([mark], camera, [pose_of(tilt)], paper=PAPER, ink=INK, background=PAPER)
    return picture, camera


def blurred(picture: Picture, blur: float) -> Picture:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(picture, blur, mode="nearest", truncate=6.0), np.float32)


def bound(mark: Mark, tilt: float, blur: float, noise: float) -> float:
    """Return the Cramer-Rao bound of one coordinate, rms over x and y, px."""
    h = 0.25
    information = np.zeros((2, 2))
    for phase in (np.zeros(2), np.array([0.5, 0.25])):
        slopes = [
            (blurred(clean(mark, tilt, phase + e)[0], blur) - blurred(clean(mark, tilt, phase - e)[0], blur)) / (2 * h)
            for e in h * np.eye(2)
        ]
        J = np.stack([s.ravel() for s in slopes], axis=1).astype(np.float64)
        information += J.T @ J / 2
    return float(noise * np.sqrt(np.trace(np.linalg.inv(information)) / 2))


def rendered(samples: int, marks: Sequence[Mark], tilts: Sequence[float]) -> None:
    for mark in marks:
        contrast = 255 * (PAPER - INK)
        print(f"{mark}, 12 px radius, contrast {contrast:.0f} of 255: rms error by the Cramer-Rao bound (bias px)\n")
        names: list[str] | None = None
        for tilt in tilts:
            pictures = [clean(mark, tilt, phase) for phase in _phases(max(8, samples // 8))]
            for level, blur in CASES:
                errors, told = _errors(mark, tilt, pictures, level, blur, samples)
                least = bound(mark, tilt, blur, np.sqrt(level**2 + 1 / 12) / 255)  # with the rounding
                if names is None:
                    names = list(errors)
                    print("| tilt | noise | blur | bound px | " + " | ".join(names) + " | told | affine |")
                    print("|" + "---|" * (6 + len(names)))
                cells = [_cell(errors[name], least) for name in names]
                print(f"| {tilt:.0f} | {level} | {blur} | {least:.4f} | " + " | ".join(cells) + f" | {told} |")
                sys.stdout.flush()
        print()


def _phases(count: int) -> Array:
    """Return places within a pixel, evenly spread (a Fibonacci lattice)."""
    k = np.arange(count)
    return np.column_stack([(k + 0.5) / count, (k * 0.6180339887) % 1.0]) - 0.5


def _cell(errors: Array, least: float) -> str:
    lost = ~np.isfinite(errors).all(axis=1)
    if lost.mean() > 0.1:
        return f"lost {lost.mean():.0%}"
    kept = errors[~lost]
    return f"{np.sqrt(np.mean(kept**2)) / least:.2f} ({np.hypot(*kept.mean(axis=0)):.4f})"


def _errors(
    mark: Mark, tilt: float, pictures: list[tuple[Picture, Camera]], level: float, blur: float, samples: int
) -> tuple[dict[str, Array], str]:
    rng = np.random.default_rng(int(1000 * tilt + 10 * level + 100 * blur))
    soft = [blurred(picture, blur) for picture, _ in pictures]
    errors: dict[str, list[Array]] = {"photometric, camera": []}
    predicted: dict[str, list[float]] = {"photometric, camera": [], "photometric, affine": []}
    for k in range(samples):
        picture, camera = soft[k % len(soft)], pictures[k % len(soft)][1]
        noisy = np.clip(picture + rng.normal(0, level / 255, picture.shape), 0, 1)
        noisy8: Picture = (np.rint(noisy * 255) / 255).astype(np.float32)
        truth = camera.principal_point
        start = pose_of(tilt + np.degrees(rng.normal(0, NORMAL_SD)), 0.7 + rng.normal(0, 0.05))
        S = (camera.project_with_jacobian(start.translation)[1] @ start.rotation[:, :2])[None]
        affine = fit_marks(noisy8, mark, truth[None] + np.array([0.4, -0.3]), S)
        errors.setdefault("photometric, affine", []).append(affine.q[0] - truth)
        fit = fit_both_tilts(noisy8, mark, camera, affine, normal=start.rotation[:, 2], normal_sd=NORMAL_SD)
        for name, one in (("photometric, camera", fit), ("photometric, affine", affine)):
            predicted[name].append(one.covariance[0].trace() / 2)
        errors.setdefault("photometric, camera", []).append(fit.q[0] - truth)
        for name, rule in _rules(mark, truth, camera, start):
            errors.setdefault(name, []).append(rule(noisy8) - truth)
    arrays = {name: np.array(e) for name, e in errors.items()}
    told = [np.sqrt(np.mean(arrays[name] ** 2) / np.mean(sigma2)) for name, sigma2 in predicted.items()]
    return arrays, f"{told[0]:.2f} | {told[1]:.2f}" if tilt == 0 else f"{told[0]:.2f} | "


def _rules(mark: Mark, truth: Array, camera: Camera, start: Rigid) -> Iterator[tuple[str, Rule]]:
    """Yield the rules that need no camera; all start half a pixel off."""
    at = truth + np.array([0.4, -0.3])
    S = (camera.project_with_jacobian(start.translation)[1] @ start.rotation[:, :2])[None]
    if len(mark.sectors) > 1:
        yield "photometric, perspective", lambda g: fit_marks(g, mark, at[None], S, perspective=True).q[0]
    ideal = template(mark, RADIUS, blur=1.0)
    of, peak = taps(ideal), Peak.of_template(ideal)
    yield "dissertation, continuous", lambda g: _by_peak(g, at, of, peak, None)
    yield "dissertation, 0.02 px grid", lambda g: _by_peak(g, at, of, peak, 0.02)
    yield "parabola", lambda g: _by_parabola(g, at, of, True)
    yield "parabola, EQ 7.1", lambda g: _by_parabola(g, at, of, False)
    yield "centroid", lambda g: centroid(g, at, RADIUS)
    if has_opencv():
        yield "cv2 blob", lambda g: _cv2_blob(g, truth)
        yield "cv2 fitEllipse", lambda g: _cv2_ellipse(g, truth)


def _by_peak(gray: Picture, at: Array, of: Taps, peak: Peak, step: float | None) -> Array:
    window, top = surface(gray, at[None], of, peak.l)
    return np.asarray(top[0] - peak.shift(window[0], grid=step)[0])


def _by_parabola(gray: Picture, at: Array, of: Taps, zero_mean: bool) -> Array:
    window, top = surface(gray, at[None], of, 1, zero_mean=zero_mean)
    return np.asarray(top[0] + parabola(window)[0])


def _cv2_blob(gray: Picture, truth: Array) -> Array:
    cv2: Any = import_module("cv2")  # its stubs do not know the detector
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.minArea, parameters.maxArea = 20, 5000
    parameters.filterByConvexity = parameters.filterByInertia = parameters.filterByCircularity = False
    found = cv2.SimpleBlobDetector_create(parameters).detect((255 * gray).astype(np.uint8))
    return _nearest(np.array([k.pt for k in found]), truth)


def _cv2_ellipse(gray: Picture, truth: Array) -> Array:
    import cv2

    _, binary = cv2.threshold((255 * gray).astype(np.uint8), 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
    contours = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not contours:
        return np.full(2, np.nan)
    largest = max(contours, key=len)
    return np.array(cv2.fitEllipse(largest)[0]) if len(largest) >= 6 else np.full(2, np.nan)


def _nearest(q: Array, truth: Array) -> Array:
    if not len(q):
        return np.full(2, np.nan)
    away = np.hypot(*(q - truth).T)
    return np.asarray(q[np.argmin(away)]) if away.min() < 4 else np.full(2, np.nan)


def grid() -> None:
    """Compare a grid of dots found by us and by OpenCV."""
    camera = Camera.from_focal((640, 480), 800.0)
    plate = MarkSheet.grid((dot(14.0),), 7, 5, 30.0)
    print("7 x 5 dots of 10 px radius or less, 640 x 480, noise 5, blur 1: rms error px (found of 35)\n")
    print("| tilt | find_marks with the camera | find_marks | cv2.findCirclesGrid |\n|---|---|---|---|")
    for tilt in TILTS:
        middle = Rigid(np.eye(3), np.array([-90.0, -60.0, 0.0]))
        pose = Rigid(np.eye(3), np.array([0.0, 0.0, 500.0])) @ Rigid.exp([0, 0, 0, np.radians(tilt), 0, 0]) @ middle
        rng = np.random.default_rng(3)
        picture = board_picture(plate, camera, pose, blur_px=1.0, noise=5 / 255, rng=rng).clip(0, 1)
        truth = camera.project(pose @ plate.points)
        with_camera = find_marks(
            picture, dot(14.0), camera=camera, normal=pose.rotation[:, 2], options=MarkOptions(margin=0.5)
        )
        plain = find_marks(picture, dot(14.0), options=MarkOptions(margin=0.5))
        cells = [_matched(np.array([m.pixel for m in f]).reshape(-1, 2), truth) for f in (with_camera, plain)]
        print(f"| {tilt:.0f} | {cells[0]} | {cells[1]} | {_cv2_grid(picture, truth)} |")
    print()


def _cv2_grid(picture: Picture, truth: Array) -> str:
    if not has_opencv():
        return "-"
    import cv2

    found, q = cv2.findCirclesGrid((255 * picture).astype(np.uint8), (7, 5), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    return _matched(np.asarray(q).reshape(-1, 2), truth) if found else "not found"


def _matched(q: Array, truth: Array, reach: float = 3.0) -> str:
    if not len(q):
        return "0"
    away = np.linalg.norm(q[:, None] - truth, axis=2)
    near = away.min(axis=0) < reach
    error = (q[away.argmin(axis=0)] - truth)[near]
    return f"{np.sqrt(np.mean(error**2)):.4f} ({near.sum()})" if near.any() else "0"


def robust() -> None:
    """Count marks found under light that varies threefold, half hidden, and among clutter."""
    camera = Camera.from_focal((640, 480), 800.0)
    mark = dot_and_ring(10.0, 20.0, 30.0)
    plate = MarkSheet.grid((mark,), 4, 3, 60.0)
    pose = Rigid(np.eye(3), np.array([-90.0, -60.0, 600.0]))
    truth = camera.project(pose @ plate.points)
    flat = board_picture(plate, camera, pose, blur_px=0.8, margin_mm=60.0)
    light = (1 / (1 + 2 * np.linspace(0, 1, 640))).astype(np.float32)
    rng = np.random.default_rng(4)
    hidden = flat.copy()
    for q in truth:
        hidden[round(q[1]) - 22 : round(q[1]) + 22, round(q[0]) + 8 : round(q[0]) + 22] = rng.uniform(0.1, 0.9)
    clutter = flat.copy()
    for _ in range(400):
        x0, y0 = rng.uniform(0, 640), rng.uniform(0, 480)
        if np.min(np.hypot(*(truth - [x0, y0]).T)) > 32:
            a, b = rng.uniform(2, 12, 2)
            clutter[int(y0) : int(y0 + b), int(x0) : int(x0 + a)] = rng.uniform(0, 1)
    print("12 marks of 20 px radius, noise 3: found, false, rms error px\n")
    print("| picture | blobs | spots | correlation |\n|---|---|---|---|")
    for name, picture in (
        ("plain", flat),
        ("light 3:1", flat * light),
        ("a sixth hidden", hidden),
        ("clutter", clutter),
    ):
        noisy = (picture + rng.normal(0, 3 / 255, picture.shape)).clip(0, 1).astype(np.float32)
        cells = []
        for method in ("blobs", "spots", "correlation"):
            found = find_marks(noisy, mark, radius_px=None if method == "blobs" else 20.0, options=MarkOptions(method))
            q = np.array([m.pixel for m in found]).reshape(-1, 2)
            true = np.linalg.norm(q[:, None] - truth, axis=2).min(axis=1) < 3 if len(q) else np.zeros(0, bool)
            cells.append(f"{_matched(q, truth)}, {np.sum(~true)} false")
        print(f"| {name} | " + " | ".join(cells) + " |")
        sys.stdout.flush()
    print()


def speed() -> None:
    """Time the daily job: one mark found and measured in 768 x 576 px."""
    camera = Camera.from_focal((768, 576), 800.0)
    print("one mark found and measured, 768 x 576 px: CPU ms, median of 15\n")
    print("| radius px | spots + fit |\n|---|---|")
    for radius in (6.0, 12.0, 25.0, 45.0):
        mark = dot_and_ring(40.0, 80.0, 120.0)
        pose = Rigid(np.eye(3), np.array([20.0, 10.0, 800.0 * 60 / radius]))
        rng = np.random.default_rng(1)
        picture = marks_picture([mark], camera, [pose], blur_px=0.8, noise=0.01, rng=rng, margin_mm=60.0)
        times = []
        for _ in range(15):
            start = time.process_time()
            find_marks(picture, mark, radius_px=radius, count=1)
            times.append(1e3 * (time.process_time() - start))
        print(f"| {radius:g} | {np.median(times):.1f} |")
    print()


def real(data: Path, pictures: Path | None, sets: Sequence[str]) -> None:
    """Find marks in real photos; where a set names places, compare."""
    print("| picture | mark | found | expected | of those | rms to the published px | CPU s |")
    print("|---|---|---|---|---|---|---|")
    for name, file, mark, options, published, expected in _sets(data):
        if sets and not name.startswith(tuple(sets)):
            continue
        start = time.process_time()
        try:
            found = find_marks(to_gray(read_picture(file)), mark, **options)
        except CadcamError as error:
            print(f"| {name} | {mark} | {error} | {expected} | | | |")
            continue
        seconds = time.process_time() - start
        q = np.array([m.pixel for m in found]).reshape(-1, 2)
        hits, rms = "", ""
        if published is not None and len(q):
            offset = np.zeros(2)
            away = np.linalg.norm(q[:, None] - published, axis=2)
            near = away.min(axis=0) < 2.0
            error_ = (q[away.argmin(axis=0)] - published - offset)[near]
            hits, rms = str(int(near.sum())), f"{np.sqrt(np.mean((error_ - error_.mean(axis=0)) ** 2)):.3f}"
        print(f"| {name} | {mark} | {len(q)} | {expected} | {hits} | {rms} | {seconds:.1f} |")
        sys.stdout.flush()
        if pictures is not None:
            _draw(pictures / f"{name.replace('/', '_')}.png", file, mark, found)


def _draw(path: Path, file: Path, mark: Mark, found: list[FoundMark]) -> None:
    picture = draw_polylines(
        read_picture(file), [one.outline(mark.radius) for one in found], color=(0.1, 0.9, 0.2), width=2.0
    )
    if found:
        q = np.array([one.pixel for one in found])
        picture = draw_points(picture, q, color=(1, 0, 0), mark="plus", size=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_picture(path, picture)


Set = tuple[str, Path, Mark, dict[str, Any], "Array | None", str]


def _sets(data: Path) -> Iterator[Set]:
    for k in (1, 3, 5):
        yield (
            f"visp_circles/0{k}",
            data / f"visp_circles/circles-0{k}.jpg",
            dot(20.0),
            {"radius_px": (6.0, 40.0), "options": MarkOptions("blobs")},
            None,
            "36",
        )
    for k in (1, 2, 3, 4):
        file = data / f"openptv_cavity/cal/cam{k}.tif"
        listed = np.loadtxt(file.with_suffix(".tif_targets"), skiprows=1, usecols=(1, 2))
        options: dict[str, object] = {"radius_px": (3.0, 14.0), "options": MarkOptions("blobs")}
        yield f"openptv_cavity/cam{k}", file, inverted(dot(2.0)), options, listed, "43-71 of 73"
    measured = _dbat(data / "dbat_camcal/pmexports/weighted-with-orient-2dpts.txt")
    for k, photo in enumerate(sorted((data / "dbat_camcal/images").glob("*.JPG"))[:3], 1):
        q = measured.get(k, np.zeros((0, 2)))
        yield (
            f"dbat_camcal/{photo.stem}",
            photo,
            dot(10.0),
            {"radius_px": (4.0, 30.0), "options": MarkOptions("blobs")},
            q,
            str(len(q)),
        )
    yield (
        "opencsp_dots/DSC03992", data / "opencsp_dots/data_measurement/images/DSC03992.JPG", dot(10.0),
        {"radius_px": (2.5, 12.0), "options": MarkOptions("blobs")}, None, "about 4000",
    )  # fmt: skip
    for k in (1, 2):  # the white disc inside three rings, the widths of which differ from mark to mark
        rings: dict[str, object] = {"radius_px": (6.0, 60.0), "options": MarkOptions("blobs", margin=0.15)}
        yield (
            f"cctag_rings/0{k}",
            data / f"cctag_rings/0{k}.png",
            inverted(dot(20.0)),
            rings,
            None,
            ("4, 1 cut", "6")[k - 1],
        )
    ring = dot_and_ring(8.0, 16.0, 24.0)
    for place in (
        "visp_mbt_cube/cube/image0000.png",
        "shipblock_clean/n0/images/0000.png",
        "apriltag_test/33369213973_9d9bb4cc96_c.jpg",
    ):  # photos without any mark, searched for marks of a known radius
        for mark, radius in ((dot(10.0), 8.0), (ring, 12.0), (ring, 20.0)):
            yield f"{place.split('/')[0]}, {radius:g} px", data / place, mark, {"radius_px": radius}, None, "0"


def _dbat(path: Path) -> dict[int, Array]:
    """Return what PhotoModeler measured, photo by photo; its pixels begin at the corner of the first one."""
    rows: dict[int, list[tuple[float, float]]] = {}
    for line in path.read_text().splitlines():
        parts = line.replace(",", " ").split()
        if len(parts) >= 4 and parts[0].isdecimal() and parts[1].isdecimal():
            rows.setdefault(int(parts[1]), []).append((float(parts[2]) - 0.5, float(parts[3]) - 0.5))
    return {photo: np.array(q) for photo, q in rows.items()}


if __name__ == "__main__":
    main()
