"""How much better a pose is known in a plane when the part can only move in that plane.

    python benchmarks/locate_planar.py ../shared/data/shipblock_clean

The part lies on a floor (its own x-y plane): two translations and one rotation are free. Prints, for each photo and
noise, how many times smaller their standard deviations at the part's centroid are than in the full fit: as the
estimates' covariances say; as theory says of the full fit's own information, cov = inv(B^T C^-1 B); as the intensity
information of the photo says (benchmarks/locate_bound.py); and the scatter of fits with fresh noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rotation import hat
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from locate_bound import information
from locate_sets import PhotoSet

IN_PLANE = [0, 1, 5]  # of (translation, rotation) in part axes
NAMES = ("x", "y", "turn")
FLOOR = Freedom.planar((0.0, 0.0, 1.0), frame="part")


def at_centroid(photos: PhotoSet) -> Array:
    """Return A (6, 6): the twist at the part's origin as one at its centroid, part axes."""
    A = np.eye(6)
    A[:3, 3:] = -hat(photos.centroid)
    return A


def told(photos: PhotoSet, noise: int, frame: int) -> tuple[Array, Array]:
    """Return the ratios (3,) of the covariances of both fits, and those that the full fit's covariance predicts."""
    photo, truth, A = photos.photo(noise, frame), photos.truth[frame], at_centroid(photos)
    full, flat = (A @ refine_pose(photos.part, [photo], truth, freedom=f).pose.covariance @ A.T for f in (FREE, FLOOR))
    expected = np.linalg.inv(np.linalg.inv(full)[np.ix_(IN_PLANE, IN_PLANE)])
    wide = np.diag(full)[IN_PLANE]
    return np.sqrt(wide / np.diag(flat)[IN_PLANE]), np.sqrt(wide / np.diag(expected))


def ideal(photos: PhotoSet, frame: int) -> Array:
    """Return the ratios (3,) of the Cramer-Rao bounds; the noise does not matter to them."""
    truth = photos.truth[frame]
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = truth.rotation  # part axes to camera axes
    fisher = turn.T @ information(photos.gray(photos.noises[0], frame), photos.part, photos.camera, truth, 1.0) @ turn
    wide = np.diag(np.linalg.inv(fisher))[IN_PLANE]
    return np.sqrt(wide / np.diag(np.linalg.inv(fisher[np.ix_(IN_PLANE, IN_PLANE)])))


def scattered(photos: PhotoSet, noise: int, frame: int, n: int) -> Array:
    """Return the sample variances (2, 3) of the full and the planar fit over n pictures with fresh noise."""
    rng = np.random.default_rng(frame)
    clean, truth, A = photos.gray(0, frame), photos.truth[frame], at_centroid(photos)
    errors = np.zeros((2, n, 3))
    for k in range(n):
        photo = Photo.of(np.clip(clean + noise / 255 * rng.standard_normal(clean.shape), 0, 1), photos.camera)
        for i, freedom in enumerate((FREE, FLOOR)):
            found = refine_pose(photos.part, [photo], truth, freedom=freedom).pose.world_from_part
            errors[i, k] = (A @ (truth.inv @ found).log())[IN_PLANE]
    return np.asarray(errors.var(axis=1, ddof=1))


def row(values: Array) -> str:
    return ", ".join(f"{v:.2f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    parser.add_argument("--noise", type=int, nargs="+", default=[3, 8], help="noise levels (default 3 8)")
    parser.add_argument("--frames", type=int, nargs="+", help="photos (default: all)")
    parser.add_argument("--fresh", type=int, default=8, help="noisy pictures of each photo (default %(default)s)")
    a = parser.parse_args()
    photos = PhotoSet(a.scene)
    frames: Sequence[int] = a.frames or sorted(photos.truth)
    print(f"sigma of the full fit over sigma in the plane, {' / '.join(NAMES)}; means over {len(frames)} photos\n")
    print("| noise | told | expected of the full fit | told / expected, extremes | intensity bound | scatter |")
    print("|---|---|---|---|---|---|")
    bound = np.mean([ideal(photos, frame) for frame in frames], axis=0)
    for noise in a.noise:
        both = np.array([told(photos, noise, frame) for frame in frames])
        quotient = both[:, 0] / both[:, 1]
        mean = np.mean([scattered(photos, noise, frame, a.fresh) for frame in frames], axis=0)
        print(
            f"| {noise} | {row(both[:, 0].mean(axis=0))} | {row(both[:, 1].mean(axis=0))}"
            f" | {quotient.min():.2f} to {quotient.max():.2f} | {row(bound)} | {row(np.sqrt(mean[0] / mean[1]))} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
