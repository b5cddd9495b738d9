"""Are diameters, positions, distances of holes right, and their uncertainty, whatever else is wrong: drilled plates.

    python benchmarks/verify_holes.py [--pictures 7] [--seed 1]
    python benchmarks/verify_holes.py --plates 150 [--by 1.2]

A drilled plate from three places, one photo each, 3 px a mm, noise of 3 grey levels: all holes right; or A 0.6 mm off,
B 0.5 mm too large, C both. Or plates drawn at random: 2 to 20 mm thick, holes of 5 to 28 mm, seen 0 to 55 degrees from
the normal at 3.5 to 5 px a mm, one hole off, one of another size, one both, by up to --by mm. error: rms, mm; U: mean
(k 2); z: rms of errors over sigma; worst: the largest; wrong: limits (0.3 mm across the axis, of the diameter, and of
the distance to another hole) that PASS or FAIL and should not. What is more than 4 sigma off is told on stderr.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import circle, extruded, filled
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene
from cadcam.verify.judge import verify_part
from cadcam.verify.tolerances.tolerance import Distance, Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

CAMERA = Camera.from_focal((1200, 900), 2250.0)
EYES = ((25.0, -35.0, 560.0), (220.0, -400.0, 330.0), (-330.0, 240.0, 390.0))
HOLES = {"A": (-60.0, -35.0, 9.0), "B": (0.0, -35.0, 6.0), "C": (60.0, -35.0, 9.0), "D": (60.0, 35.0, 12.0)}
WRONG = {"A": (0.0, 0.6, 0.0), "B": (0.0, 0.0, 0.25), "C": (0.4, -0.4, 0.25)}
PAIRS = (("A", "B"), ("A", "C"), ("C", "D"), ("B", "D"))
LIMITS = (Limit(Quantity.POSITION, 0.3, axis=np.array([0.0, 0.0, 1.0])), Limit(Quantity.DIAMETER, 0.3))
APART = Limit(Quantity.DISTANCE, 0.3)
CELLS = {name: (x, y) for name, (x, y) in zip("ABCDEFGH", np.mgrid[-66:67:44, -35:36:70].reshape(2, -1).T, strict=True)}
_FAR = 4.0  # sigmas


@dataclass(frozen=True)
class Plate:
    """A plate so many mm thick with holes (x, y, radius), what of them is wrong, and where the camera is."""

    holes: dict[str, tuple[float, float, float]]
    wrong: dict[str, tuple[float, float, float]]
    world: Rigid
    thick: float = 12.0
    pairs: tuple[tuple[str, str], ...] = PAIRS

    @classmethod
    def random(cls, rng: np.random.Generator, by: float) -> Plate:
        """Return a plate drawn at random, holes off by up to so many mm."""
        thick = rng.uniform(2, 20)
        places = {n: np.add(at, rng.uniform((-5, -8), (5, 8))) for n, at in CELLS.items() if rng.random() < 0.75}
        holes = {n: (*at, float(np.exp(rng.uniform(np.log(2.5), np.log(14))))) for n, at in places.items()}
        tilt, way = np.radians(rng.uniform(0, 55)), rng.uniform(0, 2 * np.pi)
        up = np.array([np.sin(tilt) * np.cos(way), np.sin(tilt) * np.sin(way), np.cos(tilt)])
        eye = rng.uniform(420, 650) * up + [*rng.uniform((-30, -20), (30, 20)), 0]
        wrong = {}
        for n, (off, larger) in zip(rng.permutation(list(holes)), ((1, 0), (0, 1), (1, 1)), strict=False):
            turn, most = rng.uniform(0, 2 * np.pi), min(1.0, holes[n][2] / 5)
            away = off * rng.uniform(0.1, 1) * by * np.array([np.cos(turn), np.sin(turn)])
            wrong[str(n)] = (*away, larger * rng.uniform(-0.4, 0.4) * by * most)
        return cls(holes, wrong, Rigid.look_at(eye, (0.0, 0.0, thick / 2)), thick, tuple(pairwise(holes)))

    def mesh(self, *, built: bool) -> Mesh:
        """Return the plate as it was built, or as drawn."""
        wrong = self.wrong if built else {}
        rims = [np.add(of, wrong.get(name, (0.0, 0.0, 0.0))) for name, of in self.holes.items()]
        outline = np.array([(-100, -70), (100, -70), (100, 70), (-100, 70)], float)
        cells = [filled(outline, [circle((x, y), r, 192) for x, y, r in rims])]
        return extruded(cells, 0, self.thick, name="plate", color=(0.55, 0.55, 0.6))

    def photo(self, rng: np.random.Generator) -> Photo:
        """Return a photo of the plate as built."""
        scene = Scene.of(self.mesh(built=True), edges=NO_EDGES)
        look = Look(supersampling=4, background=(0.9, 0.9, 0.9), back=0.35)
        gray = open_renderer(scene).render(CAMERA, self.world, channels=Channel.IMAGE, look=look).gray
        noisy = gaussian_filter(gray, 0.5) + rng.normal(0, 3 / 255, gray.shape)
        seen = np.asarray(np.clip(np.round(noisy * 255) / 255, 0, 1), np.float32)
        return Photo.of(seen, CAMERA, self.world)

    @property
    def asked(self) -> Tolerances:
        """Return what is asked of it: every hole's place and diameter, and the distances of pairs."""
        boxes = {
            n: np.array([[x - r - 3, y - r - 3, -1], [x + r + 3, y + r + 3, 25]]) for n, (x, y, r) in self.holes.items()
        }
        holes = tuple(Feature(n, Selection("plate", box=box), LIMITS) for n, box in boxes.items())
        return Tolerances(
            holes, distances=tuple(Distance(f"{one}{other}", (one, other), APART) for one, other in self.pairs)
        )

    def true(self, j: Judgement) -> float:
        """Return what a judgement's deviation ought to be, mm."""
        drawn = [np.array(self.holes[name]) for name in j.feature]
        off = [np.array(self.wrong.get(name, (0.0, 0.0, 0.0))) for name in j.feature]
        if j.limit.quantity is Quantity.DISTANCE:
            return _apart(np.subtract(*np.add(drawn, off))) - _apart(np.subtract(*drawn))
        return 2 * float(off[0][2]) if j.limit.quantity is Quantity.DIAMETER else _apart(off[0])


def _apart(v: Array) -> float:
    return float(np.hypot(*v[:2]))


@dataclass
class Tally:
    """Errors and U of what was measured, undecided and wrong verdicts."""

    error: list[float] = field(default_factory=list)
    U: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    undecided: int = 0
    wrong: int = 0

    def add(self, j: Judgement, true: float) -> None:
        """Add a judgement of what is `true`, mm."""
        if j.verdict not in (Verdict.PASS, Verdict.FAIL):
            self.undecided += 1
            return
        self.error.append(j.deviation - true)
        self.U.append(j.U)
        self.z.append((j.deviation - true) / j.sigma)
        self.wrong += (j.verdict is Verdict.FAIL) is not (abs(true) > j.limit.value)

    def row(self, kind: str, quantity: Quantity) -> str:
        """Return the table's row."""
        error, z = (f"{np.sqrt(np.mean(np.square(v))):.{d}f}" for v, d in ((self.error, 3), (self.z, 2)))
        worst = f"{np.abs(self.z).max():.1f}"
        cells = [
            kind,
            quantity.name.lower(),
            len(self.z),
            self.undecided,
            self.wrong,
            error,
            f"{np.mean(self.U):.3f}",
            z,
            worst,
        ]
        return "| " + " | ".join(map(str, cells)) + " |"


def pictures(arguments: argparse.Namespace) -> Iterator[tuple[str, Plate, Part, np.random.Generator]]:
    """Yield each picture to take: its kind, the plate, the part as drawn, and the noise's generator."""
    if arguments.plates:
        for k in range(arguments.plates):
            rng = np.random.default_rng([arguments.seed, k])
            plate = Plate.random(rng, arguments.by)
            yield "drawn", plate, Part.of(plate.mesh(built=False)), rng
        return
    part = Part.of(Plate(HOLES, {}, Rigid()).mesh(built=False))
    for kind, wrong in (("right", {}), ("wrong", WRONG)):
        for eye in EYES:
            for k in range(arguments.pictures):
                plate = Plate(HOLES, wrong, Rigid.look_at(eye, (0.0, 0.0, 5.0)))
                yield kind, plate, part, np.random.default_rng(arguments.seed + k)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=7, help="of each kind, from each place")
    parser.add_argument("--plates", type=int, default=0, help="as many plates drawn at random instead")
    parser.add_argument("--by", type=float, default=1.2, help="the most that holes of these are off, mm")
    parser.add_argument("--seed", type=int, default=1)
    tallies: dict[tuple[str, Quantity], Tally] = {}
    for kind, plate, part, rng in pictures(parser.parse_args()):
        photo = plate.photo(rng)
        for j in verify_part(part, [photo], refine_pose(part, [photo], Rigid()), plate.asked).judgements:
            true = plate.true(j)
            tallies.setdefault((kind, j.limit.quantity), Tally()).add(j, true)
            if abs(j.deviation - true) > _FAR * j.sigma:
                print(f"{j}, true {true:.3f}; {plate}", file=sys.stderr, flush=True)
    print(f"| holes | of | values | undecided | wrong | error | U | z | worst |\n|{'---|' * 9}")
    for (kind, quantity), tally in tallies.items():
        print(tally.row(kind, quantity), flush=True)


if __name__ == "__main__":
    main()
