"""Rotated template matching: time, accuracy and failures, compared with cv2.matchTemplate over 360 angles.

    python benchmarks/match.py [--photos ../shared/data] [--cases 200] [--peer-cases 8]

A case is a picture of 768 x 576 px and a 64 x 64 px template of the same scene, taken at a random place and angle with
its own pixels, noise, gain and offset, where noise of 8/255 leaves its place known to 0.1 px and its angle to 0.3
degrees (that is, not along a bare straight edge). Where it truly lies is known exactly: both are area means of a finer
picture. Scenes: dead leaves (overlapping discs of all sizes, whose statistics are those of photos: Lee, Mumford and
Huang, IJCV 2001), drawn anew for each case, and, with --photos, real photos, enlarged.

failed: an error above 2 px or 3 degrees; lost: of these, the ones where the correlation at the true place is higher
than what was found, so that the search is to blame and not the scene, which shows the same thing twice; told: failures
that a gap below 0.05, a score below 0.5 or an incomplete search gives away. rms / sigma: of the position's errors by
their predicted standard deviations. Times are CPU times of one thread. The peer, if installed, gets the largest square
that is known at all angles, and parabolas through its maxima.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.image.correlate import correlate, register
from cadcam.image.picture import read_picture, to_gray
from cadcam.image.template import Template

SIZE, SIDE, FINE = (768, 576), 64, 3
FAILED_PX, FAILED_DEG = 2.0, 3.0
TOLD_GAP, TOLD_SCORE = 0.05, 0.5


@dataclass(frozen=True)
class Case:
    """A picture, a template, and x, y (px), angle (rad) of the template in it."""

    picture: Picture
    template: Picture
    truth: Array


@dataclass
class Result:
    """What one way of matching found: errors (N, 2) px and degrees, seconds, of which failures were told."""

    error: list[tuple[float, float]]
    seconds: list[float]
    told: list[bool]
    lost: list[bool]
    normalised: list[float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photos", type=Path, help="folder of photos, searched with all below it")
    parser.add_argument("--cases", type=int, default=200, help="cases a row")
    parser.add_argument("--peer-cases", type=int, default=8, help="cases a row of the slow peer")
    arguments = parser.parse_args()
    scenes: dict[str, Callable[[np.random.Generator], Array]] = {"dead leaves": dead_leaves}
    if arguments.photos:
        photos = photos_in(arguments.photos)
        scenes["photos"] = lambda rng: photo_canvas(photos[int(rng.integers(len(photos)))])
    heads = ("scene", "noise of 255", "by", "cases", "failed", "lost", "told", "CPU ms", "median px", "95 % px")
    print(f"| {' | '.join((*heads, 'median deg', '95 % deg', 'rms / sigma'))} |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for name, canvas in scenes.items():
        for noise in (0.0, 3.0, 8.0):
            row(f"{name} | {noise:.0f} | cadcam", ours, cases(canvas, noise, arguments.cases))
            if arguments.peer_cases and peer_is_there():
                row(f"{name} | {noise:.0f} | cv2", peer, cases(canvas, noise, arguments.peer_cases))
    preparation()


def row(title: str, method: Callable[[Case, Result], None], of: Iterator[Case]) -> None:
    """Run a method over cases and print its row."""
    result = Result([], [], [], [], [])
    for case in of:
        method(case, result)
    error = np.array(result.error)
    failed = (error[:, 0] > FAILED_PX) | (error[:, 1] > FAILED_DEG) | ~np.isfinite(error).all(axis=1)
    good = error[~failed]
    told, lost = (str(int(np.sum(failed & np.array(w)))) if w else "-" for w in (result.told, result.lost))
    normalised = np.array(result.normalised)
    rms = f"{math.sqrt(np.mean(normalised[normalised < 1e3] ** 2)):.2f}" if len(normalised) else "-"
    columns = [np.quantile(good[:, k], q) for k in (0, 1) for q in (0.5, 0.95)]
    milliseconds = 1e3 * float(np.median(result.seconds))
    print(
        f"| {title} | {len(error)} | {int(failed.sum())} | {lost} | {told} | {milliseconds:.1f} | "
        + " | ".join(f"{c:.3f}" for c in columns)
        + f" | {rms} |",
        flush=True,
    )


def ours(case: Case, result: Result) -> None:
    """Match with cadcam, the template prepared beforehand."""
    template = Template(case.template)
    correlate(case.picture[:200, :200], template)  # prepares it
    start = time.process_time()
    peaks = correlate(case.picture, template)
    result.seconds.append(time.process_time() - start)
    there = register(case.picture, template, np.append(case.truth, 1.0))
    result.lost.append(bool(len(there) and there.score[0] > float(peaks.score[:1].max(initial=0)) + 1e-4))
    if not len(peaks):
        result.error.append((math.inf, math.inf))
        result.told.append(True)
        return
    error = errors_of(peaks.q[0], float(peaks.angle[0]), case)
    result.error.append(error)
    clear = len(peaks) < 2 or peaks.gap[0] > TOLD_GAP
    result.told.append(not (clear and peaks.score[0] > TOLD_SCORE and peaks.complete))
    if error[0] <= FAILED_PX and error[1] <= FAILED_DEG:
        result.normalised.extend((peaks.q[0] - case.truth[:2]) / peaks.sigma[0, :2])


def peer_is_there() -> bool:
    """Return whether OpenCV is installed."""
    return importlib.util.find_spec("cv2") is not None


def peer(case: Case, result: Result) -> None:
    """Match with cv2.matchTemplate at every degree; parabolas in x, y and angle."""
    import cv2

    cv2.setNumThreads(1)
    start = time.process_time()
    picture = (case.picture * 255).astype(np.uint8)
    patch = (np.clip(case.template, 0, 1) * 255).astype(np.uint8)
    side, best = int(SIDE / math.sqrt(2)), []
    middle = (SIDE - 1) / 2
    for degrees in range(360):
        turned = cv2.warpAffine(patch, _turn(math.radians(degrees), middle, (side - 1) / 2), (side, side))
        scores = cv2.matchTemplate(picture, turned, cv2.TM_CCOEFF_NORMED)
        _, value, _, (x, y) = cv2.minMaxLoc(scores)
        dx, dy = _parabola(scores[y, x - 1 : x + 2]), _parabola(scores[y - 1 : y + 2, x])
        best.append((value, x + dx + (side - 1) / 2, y + dy + (side - 1) / 2))
    highest = np.array([b[0] for b in best])
    k = int(highest.argmax())
    angle = math.radians(k + _parabola(highest[[k - 1, k, (k + 1) % 360]]))
    result.seconds.append(time.process_time() - start)
    result.error.append(errors_of(np.array(best[k][1:]), angle, case))


def _turn(angle: float, middle: float, to: float) -> Array:
    """Return the 2 x 3 matrix that turns about (middle, middle) and moves it to (to, to)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, to - c * middle + s * middle], [s, c, to - s * middle - c * middle]])


def _parabola(three: Any) -> float:
    if len(three) < 3:
        return 0.0
    a, b, c = (float(v) for v in three)
    return 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0


def errors_of(q: Array, angle: float, case: Case) -> tuple[float, float]:
    """Return the errors of a match in px and degrees."""
    turn = (angle - float(case.truth[2]) + math.pi) % (2 * math.pi) - math.pi
    return float(np.hypot(*(q - case.truth[:2]))), abs(math.degrees(turn))


def preparation() -> None:
    """Print what the preparation of a template costs."""
    rng = np.random.default_rng(1)
    case, times = next(cases(dead_leaves, 3.0, 1)), []
    for _ in range(10):
        start = time.process_time()
        correlate(case.picture[:100, :100], Template(case.template + rng.normal(scale=1e-3, size=(SIDE, SIDE))))
        times.append(time.process_time() - start)
    print(f"\npreparing a template, once: {1e3 * float(np.median(times)):.0f} ms")


def cases(canvas: Callable[[np.random.Generator], Array], noise: float, count: int) -> Iterator[Case]:
    """Yield cases; the same ones for every method."""
    rng = np.random.default_rng(7)
    while count > 0:
        fine = canvas(rng)
        picture = fine.reshape(SIZE[1], FINE, SIZE[0], FINE).mean(axis=(1, 3))
        margin = SIDE * 0.75
        x, y = rng.uniform(margin, SIZE[0] - margin), rng.uniform(margin, SIZE[1] - margin)
        angle = rng.uniform(-math.pi, math.pi)
        patch = rotated_view(fine, x, y, angle)
        if not determined(patch):
            continue
        gain, offset = rng.uniform(0.6, 1.2), rng.uniform(-0.1, 0.1)
        patch = gain * patch + offset + rng.normal(scale=noise / 255, size=patch.shape)
        picture = picture + rng.normal(scale=noise / 255, size=picture.shape)
        yield Case(quantised(picture), quantised(patch), np.array([x, y, angle]))
        count -= 1


def determined(patch: Array) -> bool:
    """Return whether a template holds its place and angle against noise of 8/255."""
    if patch.std() < 5 / 255:
        return False
    inverse = Template(patch).points(1, 3).inverse * (8 / 255) ** 2 / (patch.var() * patch.size)
    sigma = np.sqrt(np.diag(inverse))
    return bool(sigma[0] < 0.1 and sigma[1] < 0.1 and sigma[2] < math.radians(0.3))


def quantised(picture: Array) -> Picture:
    """Return a picture as eight bits hold it."""
    return np.asarray(np.round(np.clip(picture, 0, 1) * 255) / 255, np.float32)


def rotated_view(fine: Array, x: float, y: float, angle: float) -> Array:
    """Return the template (SIDE, SIDE) centred at picture point (x, y): area means of turned pixels."""
    from scipy.ndimage import map_coordinates

    part = (np.arange(SIDE * FINE) + 0.5) / FINE - 0.5 - (SIDE - 1) / 2
    v, u = np.meshgrid(part, part, indexing="ij")
    c, s = math.cos(angle), math.sin(angle)
    at = [(w + 0.5) * FINE - 0.5 for w in (y + s * u + c * v, x + c * u - s * v)]
    sampled = map_coordinates(fine, at, order=1, mode="nearest")
    return np.asarray(sampled.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3)))


def dead_leaves(rng: np.random.Generator) -> Array:
    """Return overlapping discs of radii with density r^-3, on a canvas of FINE x FINE points a pixel."""
    w, h = SIZE[0] * FINE, SIZE[1] * FINE
    canvas = np.full((h, w), np.nan, np.float64)
    u = rng.uniform(size=6000)
    low, high = 2.0 * FINE, 120.0 * FINE
    radius = 1 / np.sqrt(u / low**2 + (1 - u) / high**2)
    canvas[:] = rng.uniform(0.2, 0.8)
    for r in radius:
        x, y, value = rng.uniform(0, w), rng.uniform(0, h), rng.uniform(0.05, 0.95)
        x0, x1, y0, y1 = (int(np.clip(v, 0, n)) for v, n in ((x - r, w), (x + r + 1, w), (y - r, h), (y + r + 1, h)))
        yy, xx = np.ogrid[y0:y1, x0:x1]
        canvas[y0:y1, x0:x1][(xx - x) ** 2 + (yy - y) ** 2 <= r * r] = value
    return canvas


def photos_in(folder: Path) -> list[Path]:
    """Return the photos in a folder and below, at least 600 x 450 px, at most 2 of each subfolder."""
    from PIL import Image

    found: dict[Path, list[Path]] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".tif") and "overlay" not in path.name:
            with Image.open(path) as image:
                if image.size[0] >= 600 and image.size[1] >= 450:
                    found.setdefault(path.parent, []).append(path)
    return [path for paths in found.values() for path in paths[:: -(-len(paths) // 2)]]


@lru_cache(maxsize=32)
def photo_canvas(path: Path) -> Array:
    """Return the middle of a photo, enlarged or cut to FINE x FINE points a pixel."""
    from scipy.ndimage import zoom

    gray = to_gray(read_picture(path)).astype(np.float64)
    w, h = SIZE[0] * FINE, SIZE[1] * FINE
    scale = max(w / gray.shape[1], h / gray.shape[0])
    gray = zoom(gray.astype(np.float32), scale * (1 + 1e-3), order=3)
    x, y = (gray.shape[1] - w) // 2, (gray.shape[0] - h) // 2
    return np.asarray(gray[y : y + h, x : x + w])


if __name__ == "__main__":
    main()
