"""Are diameters, positions, distances of holes right, and their uncertainty, whatever else is wrong: a drilled plate.

    python benchmarks/verify_holes.py [--pictures 7] [--seed 1]

A drilled plate from three places, one photo each, 3 px a mm, noise of 3 grey levels: all holes right; or A 0.6 mm off,
B 0.5 mm too large, C both. error: rms, mm; U: mean (k 2); z: rms of errors over sigma; wrong: limits (0.3 mm across the
axis, of the diameter, and of the distance to another hole) that PASS or FAIL and should not.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

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
from cadcam.verify.tolerances.verdict import Verdict

CAMERA = Camera.from_focal((1200, 900), 2250.0)
EYES = ((25.0, -35.0, 560.0), (220.0, -400.0, 330.0), (-330.0, 240.0, 390.0))
HOLES = {"A": (-60.0, -35.0, 9.0), "B": (0.0, -35.0, 6.0), "C": (60.0, -35.0, 9.0), "D": (60.0, 35.0, 12.0)}
WRONG = {"A": (0.0, 0.6, 0.0), "B": (0.0, 0.0, 0.25), "C": (0.4, -0.4, 0.25)}
PAIRS = (("A", "B"), ("A", "C"), ("C", "D"), ("B", "D"))
LIMITS = (Limit(Quantity.POSITION, 0.3, axis=np.array([0.0, 0.0, 1.0])), Limit(Quantity.DIAMETER, 0.3))


@dataclass
class Tally:
    """Errors and U of what was measured, undecided and wrong verdicts."""

    error: list[float] = field(default_factory=list)
    U: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    undecided: int = 0
    wrong: int = 0


def drilled(wrong: dict[str, tuple[float, float, float]]) -> Mesh:
    rims = [np.add(of, wrong.get(name, (0.0, 0.0, 0.0))) for name, of in HOLES.items()]
    outline = np.array([(-100, -70), (100, -70), (100, 70), (-100, 70)], float)
    cells = [filled(outline, [circle((x, y), r, 192) for x, y, r in rims])]
    return extruded(cells, 0, 12, name="plate", color=(0.55, 0.55, 0.6))


def pictured(mesh: Mesh, world: Rigid, rng: np.random.Generator) -> Photo:
    look = Look(supersampling=4, background=(0.9, 0.9, 0.9), back=0.35)
    gray = open_renderer(Scene.of(mesh, edges=NO_EDGES)).render(CAMERA, world, channels=Channel.IMAGE, look=look).gray
    noisy = gaussian_filter(gray, 0.5) + rng.normal(0, 3 / 255, gray.shape)
    return Photo.of(np.asarray(np.clip(np.round(noisy * 255) / 255, 0, 1), np.float32), CAMERA, world)


def true(name: str, quantity: Quantity, wrong: dict[str, tuple[float, float, float]]) -> float:
    if quantity is Quantity.DISTANCE:
        one, other = (np.array([HOLES[hole], np.add(HOLES[hole], wrong.get(hole, (0.0, 0.0, 0.0)))]) for hole in name)
        drawn, built = np.linalg.norm((one - other)[:, :2], axis=1)
        return float(built - drawn)
    x, y, r = wrong.get(name, (0.0, 0.0, 0.0))
    return 2 * r if quantity is Quantity.DIAMETER else float(np.hypot(x, y))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=7, help="of each kind, from each place")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    part = Part.of(drilled({}))
    boxes = {n: np.array([[x - r - 3, y - r - 3, -1], [x + r + 3, y + r + 3, 13]]) for n, (x, y, r) in HOLES.items()}
    holes = tuple(Feature(n, Selection("plate", box=box), LIMITS) for n, box in boxes.items())
    apart = Limit(Quantity.DISTANCE, 0.3)
    asked = Tolerances(holes, distances=tuple(Distance(f"{one}{other}", (one, other), apart) for one, other in PAIRS))
    print(f"| holes | of | values | undecided | wrong | error | U | z |\n|{'---|' * 8}")
    for kind, wrong in (("right", {}), ("wrong", WRONG)):
        tallies = {limit.quantity: Tally() for limit in (*LIMITS, apart)}
        for eye in EYES:
            world, mesh = Rigid.look_at(eye, (0.0, 0.0, 5.0)), drilled(wrong)
            for k in range(arguments.pictures):
                photo = pictured(mesh, world, np.random.default_rng(arguments.seed + k))
                for j in verify_part(part, [photo], refine_pose(part, [photo], Rigid()), asked).judgements:
                    off = true(j.feature, j.limit.quantity, wrong)
                    out = tallies[j.limit.quantity]
                    if j.verdict is Verdict.UNDECIDED:
                        out.undecided += 1
                        continue
                    out.error.append(j.deviation - off)
                    out.U.append(j.U)
                    out.z.append((j.deviation - off) / j.sigma)
                    out.wrong += (j.verdict is Verdict.FAIL) is not (abs(off) > j.limit.value)
        for quantity, t in tallies.items():
            rms = [f"{np.sqrt(np.mean(np.square(v))):.{d}f}" for v, d in ((t.error, 3), (t.z, 2))]
            cells = [kind, quantity.name.lower(), len(t.z), t.undecided, t.wrong, rms[0], f"{np.mean(t.U):.3f}", rms[1]]
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
