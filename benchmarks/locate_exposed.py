"""How well a part is located that the photo shows white, because the exposure was too long.

    python benchmarks/locate_exposed.py ../shared/data/shipblock_clean

The noise-free photos of a scene with exact poses, times an exposure, with noise, clipped at white, in eight bits, as
JPEG files or not; located from the true poses. For each exposure: the share of the picture that is white; how many are
found; of those that end below 2 px the centroid's error, its mean over the photos (bias) in camera axes, and the
normalised pose error (1: as stated).
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from PIL import Image

from cadcam.arrays import Array
from cadcam.image.profile import BRIGHT
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import FOUND
from cadcam.locate.photo import Photo
from locate_errors import judged, summary
from locate_sets import PhotoSet, Start

EXPOSURES = (1.0, 1.3, 1.5, 1.7, 2.0)


def taken(light: Array, noise: float, jpeg: int, rng: np.random.Generator) -> Array:
    """Return the picture of light, with noise of so many grey levels, in eight bits, from a JPEG file or not (0)."""
    seen = np.round(255 * np.clip(light + noise / 255 * rng.standard_normal(light.shape), 0, 1)).astype(np.uint8)
    if jpeg:
        file = io.BytesIO()
        Image.fromarray(seen).save(file, "JPEG", quality=jpeg)
        seen = np.asarray(Image.open(file))
    return seen / 255


def row(photos: PhotoSet, exposure: float, noise: float, jpeg: int) -> str:
    """Return the table's row of an exposure."""
    rng, white, results = np.random.default_rng(1), [], []
    for frame, truth in photos.truth.items():
        seen = taken(exposure * photos.gray(0, frame).astype(np.float64), noise, jpeg, rng)
        white.append(np.mean(seen >= BRIGHT))
        start = Start(-1, frame, truth)
        location = locate_part(photos.part, [Photo.of(seen, photos.camera)], truth)
        results.append(judged(photos, start, location, 0.0))
    s = summary(results)
    found = sum(one.quality >= FOUND for one in results)
    bias = ", ".join(f"{v:+.3f}" for v in s.bias)
    return (
        f"| {exposure:g} | {np.mean(white):.0%} | {found} of {len(results)} | {s.median_mm:.3f} / {s.rms_mm:.3f}"
        f" | {bias} | {s.normalised:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    parser.add_argument("--noise", type=float, default=3.0, help="of a pixel, grey levels (default %(default)s)")
    parser.add_argument("--exposures", type=float, nargs="+", default=EXPOSURES, help="1: as the photos are")
    parser.add_argument("--jpeg", type=int, default=0, help="quality of JPEG files (default: none)")
    a = parser.parse_args()
    photos = PhotoSet(a.scene)
    print("| exposure | white | found | centroid median / rms, mm | bias x, y, z, mm | normalised |")
    print("|---|---|---|---|---|---|")
    for exposure in a.exposures:
        print(row(photos, exposure, a.noise, a.jpeg), flush=True)


if __name__ == "__main__":
    main()
