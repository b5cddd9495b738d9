"""Parts, cameras, light and pictures that nobody tuned on: where `locate` fails, and whether it says so.

    python benchmarks/locate_battery.py ../shared/data --seed 1 --keep PICTURES

Every condition below (a camera, a surface, a light, a thing in the way, a sensor, a file) is drawn with other parts,
views, cameras, grounds and starts by each seed; truth is exact. Starts are 10 to 20 degrees, 20 to 40 px and 5 to 10 %
of the depth off, or there are none. Pictures come from benchmarks/battery_pictures.py and, where it is installed,
pyrender; each is written to a file and read again. Prints by condition: how many answers are right (a corner in view at
most 2 px off), how many of those are called found, wrong ones called found (5 px off or more, or nothing to be found),
errors, whether the covariances are true, and CPU time.

In the last conditions something is wrong (benchmarks/battery_wrong.py): the model, the camera told, the picture, or
the start. A stretched model, or another camera, can look just like the true one from elsewhere: its answers are wrong
only where no pose brings the visible corners within 3 px of where the picture has them; where one does, the distance
to these corners counts. A model with other holes is right where the part is. Of two parts of a kind either is right.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from battery_cases import Case, case_of, picture_of
from battery_conditions import CONDITIONS
from cadcam.arrays import Array
from cadcam.errors import CadcamError, MissingExtra
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from locate_errors import CLOSE_PX, NEAR_PX, squared


@dataclass(frozen=True)
class Outcome:
    """How one start ended: px of the corner that is farthest off (inf: nothing to be found), xi' C^-1 xi, and costs.

    mm: how far the middle of the corners is off.
    """

    condition: str
    case: str
    px: float
    squared: float
    quality: float
    found: bool
    cpu_s: float
    words: str
    mm: float = np.nan

    @property
    def right(self) -> bool:
        """Whether it counts as right."""
        return self.px < CLOSE_PX

    @property
    def lie(self) -> bool:
        """Whether a wrong pose is called found."""
        return self.found and self.px > NEAR_PX

    @property
    def open(self) -> bool:
        """Whether it says that the part's mirror image may be what is seen."""
        return "mirror image either may be seen" in self.words


def outcomes(case: Case, photo: Photo) -> Iterator[Outcome]:
    """Yield how the starts of a case end; an error is an answer that found nothing, in its words."""
    name = case.name.split(": ")[0]
    for start in case.starts:
        began = time.process_time()
        try:
            location = locate_part(case.part, [photo], start, views=case.views)
        except CadcamError as error:
            cpu = time.process_time() - began
            yield Outcome(name, case.name, np.inf, np.nan, 0.0, False, cpu, f"{type(error).__name__}: {error}")
            continue
        cpu, pose = time.process_time() - began, location.pose.world_from_part
        px, like = min((corner_error(case, pose @ same), k) for k, same in enumerate(case.part.symmetries))
        xi = ((pose @ case.part.symmetries[like]).inv @ case.truth).log()
        m2 = squared(xi, location.pose.covariance)
        px = px if case.possible else np.inf
        middle = case.part.scene.mesh.vertices.mean(axis=0)
        mm = float(np.linalg.norm(pose @ case.part.symmetries[like] @ middle - case.truth @ middle))
        yield Outcome(name, case.name, px, m2, location.quality, location.found, cpu, location.reason, mm)


def corner_error(case: Case, pose: Rigid) -> float:
    """Return the largest distance in px between the pictures of a corner that is in view; inf where one is behind."""
    p = case.told.project(pose @ case.part.scene.mesh.vertices[case.corners])
    return min(_farthest(case, p, case.camera.project(truth @ case.places[case.corners])) for truth in case.truths)


def _farthest(case: Case, p: Array, t: Array) -> float:
    seen = case.camera.sees(t)
    d = np.linalg.norm(p[seen] - t[seen], axis=1)
    return float(d.max()) if len(d) and np.isfinite(d).all() else np.inf


def table(results: Sequence[Outcome]) -> Iterator[str]:
    """Yield a line a condition, and one of all."""
    yield (
        "| condition | starts | right | of them found | wrong, called found (said to be open)"
        " | error, median / most, px | normalised | CPU median / most, s |\n|---|---|---|---|---|---|---|---|"
    )
    for name in [*dict.fromkeys(o.condition for o in results), "all"]:
        own = [o for o in results if name in (o.condition, "all")]
        right = [o for o in own if o.right]
        px = f"{np.median([o.px for o in right]):.2f} / {max(o.px for o in right):.2f}" if right else ""
        norm = f"{np.sqrt(np.mean([o.squared for o in right]) / 6):.2f}" if right else ""
        cpu = [o.cpu_s for o in own]
        yield (
            f"| {name} | {len(own)} | {len(right)} | {sum(o.found for o in right)} | {sum(o.lie for o in own)}"
            f" ({sum(o.lie and o.open for o in own)})"
            f" | {px} | {norm} | {np.median(cpu):.2f} / {max(cpu):.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?", help="folder of public data, for the parts of cad_nist_ctc")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn (default %(default)s)")
    parser.add_argument("--parts", type=int, default=2, help="pictures of a condition (default %(default)s)")
    parser.add_argument("--starts", type=int, default=3, help="rough starts of a picture (default %(default)s)")
    parser.add_argument("--part", default="", help="take this part alone (default: drawn)")
    parser.add_argument(
        "--only", nargs="+", choices=CONDITIONS, metavar="CONDITION", help="these conditions, as the table names them"
    )
    parser.add_argument("--keep", type=Path, help="folder to keep the pictures in, and to take those that are there")
    parser.add_argument("--list", action="store_true", help="tell every start that is not right and found, in words")
    a = parser.parse_args()
    results: list[Outcome] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = a.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for name in a.only or CONDITIONS:
            for k in range(a.parts):
                case = case_of(name, k, a.seed, a.data, folder, a.starts, a.part)
                try:
                    photo = Photo.of(picture_of(case, folder), case.told)
                except (MissingExtra, ModuleNotFoundError) as error:  # a CAD kernel, or another renderer
                    print(f"{name} left out: {error}")
                    break
                answers = list(outcomes(case, photo))
                results += answers
                for o in answers if a.list else ():
                    if not (o.right and o.found) and (o.found or case.possible):
                        print(
                            f"{o.case}: {o.px:.1f} px, quality {o.quality:.2f}, {o.cpu_s:.2f} s: {o.words}", flush=True
                        )
    for line in table(results):
        print(line)


if __name__ == "__main__":
    main()
