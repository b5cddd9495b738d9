"""How often, how accurately and how fast a part is located from rough starts.

    python benchmarks/locate.py ../shared/data/shipblock_clean
    python benchmarks/locate.py SCENE --noise 3 --frames 0 5 --profile

Scenes have exact poses: the path-traced ship block, or what benchmarks/locate_scene.py writes. For each noise level:
shares of starts that end below 2 and 5 px (largest reprojection error of a corner); error of the centroid; its mean
over the photos (bias) in camera axes; scatter with fresh noise on the noise-free photos against the intensity
Cramer-Rao bound (benchmarks/locate_bound.py), and against what the photos' uneven ground leaves of it
(benchmarks/locate_ground.py); normalised pose error; quality of right and wrong poses; CPU time of
the whole call, from rough start to covariance. What is computed once for a part is timed apart.
"""

from __future__ import annotations

import argparse
import cProfile
import csv
import pstats
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from locate_bound import REACH, bound, information
from locate_errors import Outcome, Summary, auc, judged, summary
from locate_ground import best_fit, ground_of, unknown_levels
from locate_sets import PhotoSet, Start

PROFILED = 24  # starts
FRESH = 24  # noisy pictures of each frame, for scatter
ROUNDED = 1 / np.sqrt(12)  # grey levels: the noise of a picture without any


def outcome(photos: PhotoSet, photo: Photo, start: Start) -> Outcome:
    """Return how one start ends; its CPU time is that of all threads."""
    began = time.process_time()
    location = locate_part(photos.part, [photo], start.pose)
    return judged(photos, start, location, time.process_time() - began)


def outcomes(photos: PhotoSet, noise: int, starts: Sequence[Start]) -> list[Outcome]:
    """Return how starts end at a noise level."""
    photo = {frame: photos.photo(noise, frame) for frame in {start.frame for start in starts}}
    return [outcome(photos, photo[start.frame], start) for start in starts]


def preparation(photos: PhotoSet, starts: Sequence[Start]) -> float:
    """Return the seconds that starts take longer at first than once more: for what the part keeps, its aspects most.

    What it is nearly like is asked for here, as not every start does.
    """
    began = time.process_time()
    assert photos.part.likenesses is not None
    likenesses = time.process_time() - began
    first, second = (sum(o.cpu_s for o in outcomes(photos, photos.noises[0], starts)) for _ in range(2))
    return likenesses + first - second


def fresh_scatter(photos: PhotoSet, noise: int, frames: Sequence[int]) -> Array:
    """Return the scatter (3,) mm of the centroid by noise alone, root mean square over frames.

    `FRESH` pictures of each frame with new noise on the one without, all started at the true pose.
    """
    rng = np.random.default_rng(noise)
    variances = []
    for frame in frames:
        clean, truth = photos.gray(0, frame), photos.truth[frame]
        start = Start(-1, frame, truth)
        shifts = []
        for _ in range(FRESH):
            noisy = np.clip(clean + noise / 255 * rng.standard_normal(clean.shape), 0, 1)
            photo = Photo.of(np.round(255 * noisy) / 255, photos.camera)
            shifts.append(outcome(photos, photo, start).shift)
        variances.append(np.var(shifts, axis=0, ddof=1))
    return np.asarray(np.sqrt(np.mean(variances, axis=0)))


def least_scatter(photos: PhotoSet, frames: Sequence[int]) -> Array:
    """Return the intensity bound (3,) mm of the centroid at a noise of one grey level, root mean square over frames."""
    least = [
        bound(information(photos.gray(0, k), photos.part, photos.camera, photos.truth[k], 1 / 255)) for k in frames
    ]
    return np.asarray(np.sqrt(np.mean(np.square(least), axis=0))[:3])


def against_bounds(
    photos: PhotoSet, noises: Sequence[int], frames: Sequence[int], found: dict[int, Summary]
) -> Iterator[str]:
    """Yield tables of scatter by noise and errors over photos, against the bound and the best fit on this ground."""
    least, (ground, blur) = least_scatter(photos, frames), ground_of(photos, frames)
    levels = unknown_levels(blur, REACH)
    yield (
        "\n| noise | scatter by noise x, y, z, mm | bound, mm | ratio | ratio to the bound with levels unknown"
        " | of the best fit on this ground: ratio |\n|---|---|---|---|---|---|"
    )
    for noise in (n for n in noises if n):
        scatter, at_noise = fresh_scatter(photos, noise, frames), noise * least
        yield (
            f"| {noise} | {_row(scatter, 4)} | {_row(at_noise, 4)} | {_row(scatter / at_noise, 2)}"
            f" | {_row(scatter / at_noise / levels, 2)} | {best_fit(ground, blur, noise / 255).by_noise:.2f} |"
        )
    yield "\n| noise | error of a photo, rms x, y, z, mm | best fit on this ground, mm | ratio |\n|---|---|---|---|"
    for noise in noises:
        s, sigma = found[noise], max(noise, ROUNDED)
        error, best = np.hypot(s.bias, s.scatter), sigma * least * best_fit(ground, blur, sigma / 255).total
        yield f"| {noise} | {_row(error)} | {_row(best)} | {_row(error / best, 2)} |"


def report(photos: PhotoSet, noises: Sequence[int], starts: Sequence[Start], save: Path | None) -> Iterator[str]:
    """Yield the tables."""
    frames = sorted({start.frame for start in starts})
    kept_s = preparation(photos, starts)
    yield f"{photos.name}: {len(frames)} photos, {len(starts)} starts; preparation {kept_s:.2f} s CPU\n"
    yield (
        "| noise | < 2 px | < 5 px | centroid median / rms, mm | bias x, y, z, mm | photo to photo, mm | normalised"
        " | lowest quality right / highest wrong | AUC | CPU mean / 95 %, ms |"
        "\n|---|---|---|---|---|---|---|---|---|---|"
    )
    found = {}
    for noise in noises:
        results = outcomes(photos, noise, starts)
        found[noise] = s = summary(results)
        times = [o.cpu_s for o in results]
        area = auc([o.quality for o in results if o.right], [o.quality for o in results if not o.right])
        yield (
            f"| {noise} | {s.close:.1%} | {s.near:.1%} | {s.median_mm:.3f} / {s.rms_mm:.3f} | {_row(s.bias)}"
            f" | {_row(s.scatter)} | {s.normalised:.2f} | {s.worst_quality_right:.2f} / {s.best_quality_wrong:.2f}"
            f" | {area:.3f} | {s.cpu_ms:.1f} / {1000 * np.quantile(times, 0.95):.1f} |"
        )
        if save is not None:
            write(save.with_name(f"{save.stem}_n{noise}.csv"), results)
    yield from against_bounds(photos, noises, frames, found)


def profile(photos: PhotoSet, noise: int, starts: Sequence[Start]) -> Iterator[str]:
    """Yield where the time goes, by module: own time of its functions, and of what they call outside the package."""
    some = starts[:: max(len(starts) // PROFILED, 1)][:PROFILED]
    profiler = cProfile.Profile()
    profiler.enable()
    outcomes(photos, noise, some)
    profiler.disable()
    own: dict[str, float] = {}
    for (file, _, _), (_, _, total, _, callers) in pstats.Stats(profiler).stats.items():  # type: ignore[attr-defined]  # undocumented
        for (caller, _, _), share in callers.items() or {(file, 0, ""): (0, 0, total, 0)}.items():
            name = next((_module(path) for path in (file, caller) if "cadcam" in path), "other")
            own[name] = own.get(name, 0.0) + share[2]
    whole = sum(own.values())
    yield "\n| step | ms a photo (profiled, so slower) | share |\n|---|---|---|"
    for name, seconds in sorted(own.items(), key=lambda item: -item[1])[:14]:
        yield f"| {name} | {1000 * seconds / len(some):.2f} | {seconds / whole:.0%} |"


def write(path: Path, results: Sequence[Outcome]) -> None:
    """Write one line a start."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        names = ("start", "frame", "vertex_px", "dx", "dy", "dz", *(f"xi{k}" for k in range(6)))
        rows.writerow([*names, "mahalanobis", "quality", "cpu_s"])
        for o in results:
            rows.writerow([o.start, o.frame, o.vertex_px, *o.shift, *o.xi, o.mahalanobis, o.quality, o.cpu_s])


def _row(values: Array, digits: int = 3) -> str:
    return ", ".join(f"{v:.{digits}f}" for v in values)


def _module(path: str) -> str:
    return path.split("cadcam/")[-1].removesuffix(".py") if "cadcam/" in path else path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    parser.add_argument("--noise", type=int, nargs="+", help="noise levels (default: all that the scene has)")
    parser.add_argument("--frames", type=int, nargs="+", help="photos (default: all)")
    parser.add_argument("--every", type=int, default=1, help="use every n-th start only (default %(default)s)")
    parser.add_argument("--save", type=Path, help="write a CSV of all starts beside this name, one a noise level")
    parser.add_argument("--profile", action="store_true", help="tell where the time goes too")
    a = parser.parse_args()
    photos = PhotoSet(a.scene)
    starts = [s for s in photos.starts if a.frames is None or s.frame in a.frames][:: a.every]
    noises = a.noise or photos.noises
    for line in report(photos, noises, starts, a.save):
        print(line, flush=True)
    if a.profile:
        for line in profile(photos, noises[-1], starts):
            print(line)


if __name__ == "__main__":
    main()
