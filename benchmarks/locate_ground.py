"""What the ground beside edges costs: how far even the best fit of a step stays above the intensity bound, and why.

The bound (benchmarks/locate_bound.py) takes all but the pose as known. A fit must find the levels on both sides of an
edge from the pixels there, and what lies there is not level: grain, texture and shading. Along the true edges of photos
without noise this takes how the ground varies away from them (the covariance of profiles of stretches that have no
other line near), and the best linear fit of a step on such ground: the one of least variance by noise and ground
together (best linear unbiased: levels and height of the step are free, the ground is a random process of that
covariance). Two factors on the bound come out: what that fit errs by noise alone, and by both. Stretches count as
independent: edges that err as a whole, by shading all along them, are worse.

    python benchmarks/locate_ground.py ../shared/data/shipblock_clean

tells both factors, by noise and total, for fits that look less or farther to the sides.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

import locate_bound
from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.edges import project, sample_lines
from cadcam.locate.part import Part
from locate_bound import edge_information
from locate_sets import PhotoSet

CELL_PX, STRETCH = 4.0, 10  # px along an edge; cells whose profiles are averaged
CLEAR_PX = 17.0  # no other line is so near
NEAR, FAR = 2, 14  # px from the edge: beyond its blur, and as far as the ground is looked at
LEVEL = 4  # px whose mean is the level of a profile
PLAIN = 0.9  # share of the profiles that are ground: the others cross a border of a shadow


@dataclass(frozen=True)
class Ground:
    """Covariance (n, n) of the ground 0 .. n - 1 px outward from an edge, of means over length_px along it."""

    covariance: Array
    length_px: float


@dataclass(frozen=True)
class Fit:
    """Standard deviations of a fit over the bound: by noise, and of all, by noise and ground."""

    by_noise: float
    total: float


def unknown_levels(blur_px: float, reach_px: float, *, slopes: bool = False) -> float:
    """Return by which factor a step is told less well where both levels are to be found within reach_px of it.

    slopes: the slopes of the ground on both sides too. Nothing of the bell's integral that these explain is left.
    """
    d = np.linspace(-reach_px, reach_px, 2001)
    step, bell = ndtr(d / blur_px), np.exp(-0.5 * (d / blur_px) ** 2)
    ramp = d * step + blur_px * bell / np.sqrt(2 * np.pi)
    design = np.column_stack([np.ones_like(d), step, *((d - ramp, ramp) if slopes else ())])
    left = bell - design @ np.linalg.lstsq(design, bell)[0]
    whole = np.sqrt(np.pi) * blur_px  # the integral of the bell's square over all places
    return float(np.sqrt(whole / (np.sum(left**2) * (d[1] - d[0]))))


def profiles(gray: Picture, part: Part, camera: Camera, camera_from_part: Rigid) -> Array:
    """Return profiles (P, FAR - NEAR + 1) of the ground, outward from the true edges, means over stretches of them."""
    lines = part.lines.draw(camera, camera_from_part).visible
    samples = sample_lines(lines, camera, step_px=CELL_PX, reach_px=CLEAR_PX + 1)
    at = project(samples, camera, camera_from_part)
    out, t = np.arange(NEAR, FAR + 1.0), (np.arange(CELL_PX) + 0.5) - CELL_PX / 2
    found = [np.zeros((0, len(out)))]
    for sign, room in ((-1.0, samples.below), (1.0, samples.above)):
        normal = sign * at.normal
        along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        q = at.q[:, None, None] + out[:, None, None] * normal[:, None, None] + t[:, None] * along[:, None, None]
        inside = ((q >= 0) & (q <= np.array(camera.size) - 1)).all(axis=(1, 2, 3)) & (room >= CLEAR_PX)
        values = map_coordinates(np.asarray(gray, float), (q[..., 1], q[..., 0]), order=3, mode="nearest").mean(axis=2)
        for run in np.unique(samples.run):
            here = values[inside & (samples.run == run)]
            n = len(here) // STRETCH
            found.append(here[: n * STRETCH].reshape(n, STRETCH, len(out)).mean(axis=1))
    return np.concatenate(found)


def ground_of(photos: PhotoSet, frames: Sequence[int]) -> tuple[Ground, float]:
    """Return the ground of photos without noise, and their blur in px."""
    found, blurs = [], []
    for k in frames:
        gray, truth = photos.gray(0, k), photos.truth[k]
        found.append(profiles(gray, photos.part, photos.camera, truth))
        blurs.append(locate_bound.photo_blur(gray, photos.part, photos.camera, truth))
    return of_profiles(np.concatenate(found)), float(np.mean(blurs))


def of_profiles(some: Array) -> Ground:
    """Return the ground that profiles (P, n) show, less their level, without those that cross a shadow's border."""
    d = some - some[:, :LEVEL].mean(axis=1, keepdims=True)
    rise = np.abs(d[:, -1])
    d = d[rise <= np.quantile(rise, PLAIN)]
    return Ground(d.T @ d / len(d), CELL_PX * STRETCH)


def best_fit(ground: Ground, blur_px: float, noise: float, *, reach_px: int = FAR - NEAR) -> Fit:
    """Return what the best linear fit of a step on such ground leaves, over the bound at this noise.

    reach_px: how far it looks to either side. From the edge on the ground is taken to vary as it does from `NEAR` on:
    what is nearer, the step's blur hides.
    """
    d, total = _variation(ground, blur_px, noise, reach_px)
    design = _design(d, blur_px)[:, :3]
    weighted = np.linalg.solve(total, design)
    return _judged(ground, blur_px, noise, np.linalg.solve(design.T @ weighted, weighted.T)[2], total)


def plain_fit(ground: Ground, blur_px: float, noise: float, *, reach_px: int) -> Fit:
    """Return the same of least squares with the slopes of the ground on both sides free, each pixel counting alike."""
    d, total = _variation(ground, blur_px, noise, reach_px)
    return _judged(ground, blur_px, noise, np.linalg.pinv(_design(d, blur_px))[2], total)


def _variation(ground: Ground, blur_px: float, noise: float, reach_px: int) -> tuple[Array, Array]:
    """Return places across an edge and the covariance of brightness there, by noise and ground."""
    d = np.arange(-reach_px, reach_px + 1)
    total = noise**2 / ground.length_px * np.eye(len(d))
    for sign in (-1, 1):
        share = ndtr(sign * d / blur_px)
        total += ground.covariance[np.ix_(np.abs(d), np.abs(d))] * np.outer(share, share)
    return d.astype(np.float64), total


def _design(d: Array, blur_px: float) -> Array:
    """Return columns of a level, a step, its place, and slopes on both sides, at places d across the edge."""
    step, bell = ndtr(d / blur_px), np.exp(-0.5 * (d / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
    ramp = d * step + blur_px**2 * bell
    return np.column_stack([np.ones(len(d)), step, bell, ramp, d - ramp])


def _judged(ground: Ground, blur_px: float, noise: float, w: Array, total: Array) -> Fit:
    of_noise = noise**2 / ground.length_px
    least = 1 / (float(edge_information(np.ones(1), blur_px, noise)[0]) * ground.length_px)
    return Fit(*(float(np.sqrt(v / least)) for v in (of_noise * w @ w, w @ total @ w)))


def report(photos: PhotoSet) -> Iterator[str]:
    """Yield a table of fits that look more or less far."""
    ground, blur = ground_of(photos, sorted(photos.truth))
    reaches = (3, 4, 5, 6, 8, FAR - NEAR)
    yield "| noise | fit | " + " | ".join(f"{r} px" for r in reaches) + " |\n|---|---|" + "---|" * len(reaches)
    for noise in (n for n in photos.noises if n):
        for name, of in (("levels and slopes free", plain_fit), ("best on this ground", best_fit)):
            fits = [of(ground, blur, noise / 255, reach_px=r) for r in reaches]
            yield f"| {noise} | {name} | " + " | ".join(f"{f.by_noise:.2f}, {f.total:.2f}" for f in fits) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    for line in report(PhotoSet(parser.parse_args().scene)):
        print(line)


if __name__ == "__main__":
    main()
