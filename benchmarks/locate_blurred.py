"""How exactly, and how honestly, parts are located in blurred photos: out of focus, moved while the shutter was open.

    python benchmarks/locate_blurred.py ../shared/data --seed 9

Scenes of benchmarks/locate_battery.py (ten parts by turns, several cameras, light with shadows, a noisy sensor) are
drawn once each; the same light is then taken sharp and with every blur below, and the part located from rough starts 10
to 20 degrees, 20 to 40 px and 5 to 10 % of the depth off. Blurs are radii of discs (out of focus), standard deviations
(Gaussian: a poor lens) and paths in px (motion). Prints by blur: how many answers are right (no corner in view more
than 2 px off), how many of those are called found, wrong ones called found, and of the right ones the error of the
farthest corner in px and of the middle in mm, normalised errors (1 where covariances are true), and quality.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from battery_cases import Case, case_of, light_of, picture_of
from battery_conditions import CONDITIONS, SENSOR
from cadcam.image.sensor.charge import Noise
from cadcam.image.sensor.light import Blur, Motion
from cadcam.image.sensor.sensor import Sensor
from cadcam.locate.photo import Photo
from locate_battery import Outcome, outcomes

CAMERAS = ("plain", "640 x 480", "strong Brown-Conrady")  # conditions of the battery that the scenes are drawn by
NOISY = replace(SENSOR, noise=Noise(2_500, 24))  # 2 % of white
SENSORS: dict[str, Sensor] = {
    "sharp": SENSOR,
    "out of focus, 1.5 px": replace(SENSOR, blur=Blur(0.0, 1.5)),
    "out of focus, 3 px": replace(SENSOR, blur=Blur(0.0, 3.0)),
    "out of focus, 5 px": replace(SENSOR, blur=Blur(0.0, 5.0)),
    "Gaussian, 1 px": replace(SENSOR, blur=Blur(1.0, 0.0)),
    "Gaussian, 1.5 px": replace(SENSOR, blur=Blur(1.5, 0.0)),
    "motion 2.5 px, oblique": replace(SENSOR, motion=Motion((2.0, 1.5))),
    "motion 5 px, oblique": replace(SENSOR, motion=Motion((4.0, 3.0))),
    "motion 5 px, upright": replace(SENSOR, motion=Motion((0.0, 5.0))),
    "motion 10 px, oblique": replace(SENSOR, motion=Motion((8.0, -6.0))),
    "noisy, sharp": NOISY,
    "noisy, out of focus, 3 px": replace(NOISY, blur=Blur(0.0, 3.0)),
    "noisy, motion 5 px, oblique": replace(NOISY, motion=Motion((4.0, 3.0))),
}


def taken(case: Case, names: Sequence[str], folder: Path) -> Iterator[tuple[str, Case, Photo]]:
    """Yield the case as each of the sensors takes it, all of the same light."""
    light = cache(lambda: light_of(case))
    for name in names:
        own = folder / name.replace(" ", "-").replace(",", "")
        own.mkdir(parents=True, exist_ok=True)
        so = replace(case, condition=replace(case.condition, sensor=SENSORS[name]))
        yield name, so, Photo.of(picture_of(so, own, lambda _: light()), case.camera)


def row(name: str, some: Sequence[Outcome]) -> str:
    """Return a blur's line of the table."""
    right = [o for o in some if o.right]
    told = f"| {name} | {len(some)} | {len(right)} | {sum(o.found for o in right)} | {sum(o.lie for o in some)}"
    if not right:
        return told + " | | | | | |"
    px, mm = np.array([o.px for o in right]), np.array([o.mm for o in right])
    norm = np.sqrt([o.squared / 6 for o in right])
    return (
        f"{told} | {np.median(px):.2f}, {np.quantile(px, 0.9):.2f} | {np.median(mm):.2f}, {np.quantile(mm, 0.9):.2f}"
        f" | {np.sqrt(np.mean(norm**2)):.2f}, {np.median(norm):.2f} | {np.median([o.quality for o in right]):.2f}"
        f" | {1000 * np.median([o.cpu_s for o in some]):.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", help="folder of public data, for the parts of cad_nist_ctc")
    parser.add_argument("--seed", type=int, default=9, help="of all that is drawn (default %(default)s)")
    parser.add_argument("--scenes", type=int, default=4, help="scenes of each camera (default %(default)s)")
    parser.add_argument("--starts", type=int, default=1, help="rough starts of a picture (default %(default)s)")
    parser.add_argument("--cameras", nargs="+", choices=CONDITIONS, default=CAMERAS, metavar="CONDITION")
    parser.add_argument("--only", nargs="+", choices=SENSORS, default=list(SENSORS), metavar="BLUR")
    parser.add_argument("--keep", type=Path, help="folder to keep the pictures in, and to take those that are there")
    parser.add_argument("--list", action="store_true", help="tell every start that is not right and found, in words")
    a = parser.parse_args()
    results: list[tuple[str, Outcome]] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = a.keep or Path(scratch)
        for camera in a.cameras:
            for k in range(a.scenes):
                case = case_of(camera, k, a.seed, a.data, Path(scratch), a.starts)
                for name, so, photo in taken(case, a.only, folder):
                    results += [(name, o) for o in outcomes(so, photo)]
    for name, o in results if a.list else ():
        if not (o.right and o.found):
            print(f"{name}, {o.case}: {o.px:.2f} px, quality {o.quality:.2f}: {o.words}")
    print("| blur | starts | right | of them found | wrong, called found | px | mm | normalised | quality | CPU, ms |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in a.only:
        print(row(name, [o for of, o in results if of == name]))


if __name__ == "__main__":
    main()
