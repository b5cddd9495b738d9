"""How far edges are off as wholes, as `cadcam verify` estimates it (tau): what a layout takes beside a datum.

    python benchmarks/edge_errors.py DATA [--only drawn,real] [--pictures 3]

drawn: good pictures of the parts of benchmarks/verify_parts.py, a part that is as its CAD; real: frames of the cube and
the tea box of ViSP in DATA (one camera), whose models are plain boxes. Each part is located, then verified.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cadcam.errors import CadcamError
from cadcam.image.picture import read_picture
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from cadcam.verify.inspection import inspect
from verify_parts import DEFECTS, shots, verified
from video_sets import clips, part_of

PARTS = ("bracket: hole off", "flange: rim off", "step block: step too high", "fixture: block off")
FRAMES = {"mono": (0, 10, 20, 30), "left": (0, 10, 20), "cube": (0, 20, 40, 60, 80)}


def drawn(pictures: int) -> Iterator[tuple[str, float]]:
    """Yield the error of edges in each picture of a part as drawn."""
    for name in PARTS:
        defect = DEFECTS[name]
        for case, good, _ in shots(defect, "plain", pictures, 1):
            seen = verified(case, good, defect).inspection
            yield name.partition(":")[0], np.nan if seen is None or not seen.found else seen.tau_px


def real(data: Path) -> Iterator[tuple[str, float]]:
    """Yield the error of edges in each photo."""
    for name, frames in FRAMES.items():
        clip = clips(data)[name]
        part, poses, pictures = part_of(clip), clip.world_from_part(clip.refined), sorted(clip.folder.iterdir())
        view = clip.viewpoint
        for i in frames:
            photos = [Photo.of(read_picture(pictures[i]), view.camera, view.camera_from_world)]
            try:
                seen = inspect(part, photos, locate_part(part, photos, poses[i]).pose.world_from_part)
            except CadcamError as error:
                print(f"{name} {i}: {error}")
                continue
            yield name, seen.tau_px if seen.found else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default="drawn,real")
    parser.add_argument("--pictures", type=int, default=3)
    arguments = parser.parse_args()
    for kind in arguments.only.split(","):
        found = []
        for name, tau in drawn(arguments.pictures) if kind == "drawn" else real(arguments.data):
            print(f"{name}: {tau:.3f}", flush=True)
            found.append(tau)
        every = np.array(found)
        least, middle, most = np.nanquantile(every, [0, 0.5, 1])
        print(f"{kind}: median {middle:.3f} px, {least:.3f} to {most:.3f}, {len(every)} pictures", flush=True)


if __name__ == "__main__":
    main()
