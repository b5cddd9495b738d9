"""Are verdicts, signed deviations and their uncertainty right on parts that they were not made on: honest pictures.

    python benchmarks/verify_parts.py [--pictures 6] [--defect NAME ...] [--condition NAME] [--seed 1]

Four parts (a machined bracket, a flange of two bodies, a stepped block, a fixture of five) on a table in light, among
things, pictured as in benchmarks/locate_battery.py; what is pictured has one defect, which the CAD has not: a hole or a
body displaced, a body or a slot turned, a hole too large, a step too high, a body missing or too much. The part is
located from a rough start, 10 to 20 degrees off, and verified as a tolerance file would have it: the feature is judged,
the rest is the datum.

found: the verdict is FAIL where the defect is beyond the limit, and PASS is said of none; good: the same tolerances on
a part without defect. alarms: pictures in which anything else is called displaced or missing. error: of the deviation
that is judged, mm or degrees, median; U: its expanded uncertainty (k = 2), median; in U: share of deviations whose
truth is within U of them; z: rms of the errors over sigma.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import battery_cases as battery
from battery_conditions import CONDITIONS, PLAIN
from battery_pictures import radiance
from cadcam.arrays import Array, Mask, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box, circle, extruded, filled
from cadcam.geometry.rotation import exp
from cadcam.image.picture import to_gray
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import State
from cadcam.verify.judge import Verification, verify_part
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from cadcam.verify.tolerances.verdict import Judgement, Verdict

Warp = Callable[[Mesh], Mesh]


@dataclass(frozen=True)
class Defect:
    """What is wrong with a part, the feature that it is in, and the limit on it; truth: its deviation.

    by (3,) mm: how far it is displaced.
    """

    part: str
    feature: Selection
    quantity: Quantity
    limit: float
    warp: Warp
    truth: float = 0.0
    by: tuple[float, float, float] | None = None
    extra: Mesh | None = None


@dataclass
class Tally:
    """What a case came to."""

    pictures: int = 0
    lost: int = 0
    verdicts: list[Verdict] = field(default_factory=list)
    alarms: int = 0
    extra: int = 0
    error: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    U: list[float] = field(default_factory=list)


def fixture() -> Mesh:
    """Return a plate with two ribs, a block and a pin."""
    plate = extruded([filled(np.array([(0, 0), (160, 0), (160, 110), (0, 110)], float), [circle((130, 25), 8, 96)])],
                     0, 12, name="plate", color=None)  # fmt: skip
    pin = extruded([filled(circle((40, 80), 7, 192))], 12, 34, name="pin", color=None)
    ribs = [box((15, y, 12), (75, y + 6, 38), name=name) for y, name in ((12, "rib 1"), (40, "rib 2"))]
    return merge([plate, *ribs, box((95, 55, 12), (135, 95, 42), name="block"), pin])


def moved(where: Callable[[Array], Mask], to: Callable[[Array], Array]) -> Warp:
    """Return what moves the vertices (N, 3) of a mesh that lie `where`."""

    def warp(mesh: Mesh) -> Mesh:
        p = mesh.vertices.copy()
        own = where(p)
        p[own] = to(p[own])
        return replace(mesh, vertices=p)

    return warp


def of_body(name: str, to: Callable[[Array], Array] | None) -> Warp:
    """Return what moves a body's vertices, or takes it away."""

    def warp(mesh: Mesh) -> Mesh:
        own = mesh.part == mesh.part_names.index(name)
        if to is None:
            return mesh.select(~own)
        p = mesh.vertices.copy()
        which = np.unique(mesh.faces[own])
        p[which] = to(p[which])
        return replace(mesh, vertices=p)

    return warp


def near(centre: tuple[float, float], radius: float) -> Callable[[Array], Mask]:
    return lambda p: np.asarray(np.hypot(p[:, 0] - centre[0], p[:, 1] - centre[1]) < radius)


def shift(by: tuple[float, float, float]) -> Callable[[Array], Array]:
    return lambda p: p + np.array(by)


def turn(centre: tuple[float, float], degrees: float) -> Callable[[Array], Array]:
    R, c = exp(np.array([0, 0, np.radians(degrees)])), np.array([*centre, 0.0])
    return lambda p: np.asarray((p - c) @ R.T + c)


def widened(centre: tuple[float, float], by: float) -> Callable[[Array], Array]:
    def to(p: Array) -> Array:
        d = p - np.array([*centre, 0.0])
        d[:, 2] = 0
        return np.asarray(p + by * d / np.linalg.norm(d, axis=1, keepdims=True))

    return to


def around(centre: tuple[float, float], reach: float, low: float, high: float, part: str = "*") -> Selection:
    x, y = centre
    return Selection(part, box=np.array([[x - reach, y - reach, low], [x + reach, y + reach, high]]))


HOLE, FLANGE_HOLE = (104.0, 64.0), (34.0, 0.0)
SLOT = (4.0, -10.0)
_P, _A, _F, _R = Quantity.POSITION, Quantity.ANGLE, Quantity.PROFILE, Quantity.PRESENCE
_BLOCK, _RIB, _PIN, _RIM = (Selection(name) for name in ("block", "rib 2", "pin", "rim"))
DEFECTS: dict[str, Defect] = {
    "bracket: hole off": Defect("bracket", around(HOLE, 5.5, 10, 13), _P, 0.3,
                                moved(near(HOLE, 5.5), shift((0.5, 0.4, 0))), 0.64, (0.5, 0.4, 0)),
    "bracket: hole too large": Defect("bracket", around(HOLE, 6.5, 10, 13), _F, 0.3,
                                      moved(near(HOLE, 5.5), widened(HOLE, 0.6)), 0.6),
    "flange: hole off": Defect("flange", around(FLANGE_HOLE, 6, 8, 10), _P, 0.3,
                               moved(near(FLANGE_HOLE, 6), shift((0, 0.7, 0))), 0.7, (0, 0.7, 0)),
    "flange: slot turned": Defect("flange", around(SLOT, 11, 8, 10), _A, np.radians(1.0),
                                  moved(lambda p: near(SLOT, 11.5)(p) & (np.hypot(p[:, 0], p[:, 1]) < 20) &
                                        (np.hypot(p[:, 0], p[:, 1] - 3) > 14), turn(SLOT, 3.0)), np.radians(3.0)),
    "flange: rim off": Defect("flange", _RIM, _P, 0.3, of_body("rim", shift((0.5, -0.5, 0))), 0.71, (0.5, -0.5, 0)),
    "step block: step too high": Defect("step block", Selection(box=np.array([[51, 21.9, -1], [91, 22.8, 39.0]])), _P,
                                        0.4, moved(lambda p: np.abs(p[:, 1] - 22) < 0.1, shift((0, 0.7, 0))), 0.7,
                                        (0, 0.7, 0)),
    "fixture: block off": Defect("fixture", _BLOCK, _P, 0.3, of_body("block", shift((0.5, 0.4, 0))), 0.64,
                                 (0.5, 0.4, 0)),
    "fixture: rib turned": Defect("fixture", _RIB, _A, np.radians(0.5), of_body("rib 2", turn((45, 43), 1.2)),
                                  np.radians(1.2)),
    "fixture: pin missing": Defect("fixture", _PIN, _R, 1.0, of_body("pin", None)),
    "fixture: block too much": Defect("fixture", _BLOCK, _P, 0.3, lambda mesh: mesh,
                                      extra=box((85, 14, 12), (110, 34, 30), name="extra")),
}  # fmt: skip
battery.PARTS["fixture"] = fixture


def pictured(case: battery.Case, warp: Warp, extra: Mesh | None) -> Picture:
    """Return the picture of a case, its part with a defect, something else standing on it."""
    things = [(warp(mesh) if k == 1 else mesh, surface) for k, (mesh, surface) in enumerate(case.stage.things)]
    things = [(_placed(mesh, case) if k == 1 else mesh, surface) for k, (mesh, surface) in enumerate(things)]
    if extra is not None:
        things.append((_placed(extra, case), PLAIN))
    linear = radiance(replace(case.stage, things=things), case.camera, case.truth @ case.world_from_part.inv)
    clean = battery.WHITE * linear / max(float(np.quantile(linear, 0.99)), 1e-6)
    taken = case.condition.sensor.apply(clean, rng=np.random.default_rng(case.seed))
    return np.asarray(np.round(to_gray(taken) * 255) / 255, np.float32)


def _placed(mesh: Mesh, case: battery.Case) -> Mesh:
    return mesh.transformed(case.world_from_part)


def shots(defect: Defect, condition: str, pictures: int, seed: int) -> Iterator[tuple[battery.Case, Picture, Picture]]:
    """Yield cases with the picture of a good part and of one with the defect."""
    with tempfile.TemporaryDirectory() as folder:
        for k in range(pictures):
            case = battery.case_of(condition, k, seed, None, Path(folder), 1, defect.part)
            own = battery.mesh_of(defect.part, None, True)
            things = [(own if i == 1 else m, surface) for i, (m, surface) in enumerate(case.stage.things)]
            case = replace(case, stage=replace(case.stage, things=things))
            yield case, pictured(case, lambda mesh: mesh, None), pictured(case, defect.warp, defect.extra)


def verified(case: battery.Case, picture: Picture, defect: Defect) -> Verification:
    """Return the verdict on what a picture shows."""
    photo = Photo.of(picture, case.camera, case.truth)
    located = locate_part(case.part, [photo], None if case.starts[0] is None else case.truth.inv @ case.starts[0])
    limits = [Limit(Quantity.PRESENCE, 1.0)]
    if defect.quantity is not Quantity.PRESENCE:
        limits.insert(0, Limit(defect.quantity, defect.limit))
    asked = Tolerances((Feature("judged", defect.feature, tuple(limits)),))
    return verify_part(case.part, [photo], located, asked)


def note(out: Tally, defect: Defect, seen: Verification, *, wrong: bool, said: str) -> None:
    """Note how a picture came out; what was not as it should be is told on stderr."""
    out.pictures += 1
    if seen.inspection is None or not seen.inspection.found:
        out.lost += 1
        print(f"{said}: {seen.reason}", file=sys.stderr)
        return
    judged = next(j for j in seen.judgements if j.limit.quantity is defect.quantity)
    out.verdicts.append(judged.verdict)
    others = [f for f in seen.inspection.features if f.name != "judged"]
    named = [f.name for f in others if f.state in (State.DISPLACED, State.MISSING)]
    out.alarms += bool(named)
    out.extra += defect.extra is not None and any(e.length_px > 40 for e in seen.inspection.extra)
    truth = _truth(defect, seen) if wrong and defect.extra is None else 0.0
    if np.isfinite(judged.deviation) and np.isfinite(truth):
        off = abs(judged.deviation) - abs(truth) if defect.quantity is Quantity.POSITION else judged.deviation - truth
        out.error.append(float(abs(off)))
        out.U.append(judged.U)
        out.z += _z(defect, seen, off, judged, wrong=wrong)
    right = Verdict.FAIL if wrong and defect.extra is None else Verdict.PASS
    if judged.verdict is not right or named or (np.isfinite(truth) and out.error and out.error[-1] > judged.U):
        what = f"{judged.verdict.value}, {judged.deviation:.3f} +- {judged.U:.3f} (truth {truth:.3f}), {judged.reason}"
        print(f"{said}: {what}; alarms {named}", file=sys.stderr)


def _truth(defect: Defect, seen: Verification) -> float:
    """Return the true deviation of what is judged, in the directions that the photo shows."""
    assert seen.inspection is not None
    if defect.quantity is Quantity.ANGLE:
        return float(defect.truth * seen.inspection.feature("judged").axis[2])  # of a turn about z, what is about it
    if defect.by is None:  # of a profile another share shows at each piece of it
        return float("nan")
    return float(np.linalg.norm(seen.inspection.feature("judged").seen.T @ np.array(defect.by)))


def _z(defect: Defect, seen: Verification, off: float, judged: Judgement, *, wrong: bool) -> list[float]:
    assert seen.inspection is not None
    found = seen.inspection.feature("judged")
    if defect.quantity is not Quantity.POSITION or found.displacement is None:
        return [2 * off / judged.U]
    truth = found.seen.T @ (np.array(defect.by) if wrong and defect.by is not None else np.zeros(3))
    root = np.linalg.cholesky(found.displacement.covariance)
    return list(np.linalg.solve(root, found.displacement.value - truth))


def row(name: str, defect: Defect, out: Tally) -> str:
    n = max(len(out.verdicts), 1)
    counts = [f"{100 * out.verdicts.count(v) / n:.0f} %" for v in (Verdict.PASS, Verdict.FAIL)]
    rest = f"{100 * (1 - sum(out.verdicts.count(v) for v in (Verdict.PASS, Verdict.FAIL)) / n):.0f} %"
    unit = np.degrees(1.0) if defect.quantity is Quantity.ANGLE else 1.0
    told = [""] * 4
    if out.error:
        inside = np.mean(np.array(out.error) <= np.array(out.U))
        z = np.sqrt(np.mean(np.square(out.z)))
        told = [
            f"{unit * np.median(out.error):.3f}",
            f"{unit * np.median(out.U):.3f}",
            f"{100 * inside:.0f} %",
            f"{z:.2f}",
        ]
    cells = [name, str(out.pictures), str(out.lost), *counts, rest, str(out.alarms), *told]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=6)
    parser.add_argument("--defect", action="append", choices=DEFECTS)
    parser.add_argument(
        "--condition",
        default="plain",
        choices=CONDITIONS,
        metavar="CONDITION",
        help="as in the table of locate_battery.py",
    )
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(
        f"| pictured | pictures | no pose | PASS | FAIL | undecided | alarms | error | U | in U | z |\n|{'---|' * 11}"
    )
    for name in arguments.defect or DEFECTS:
        defect, good, bad = DEFECTS[name], Tally(), Tally()
        for k, (case, fine, wrong) in enumerate(shots(defect, arguments.condition, arguments.pictures, arguments.seed)):
            note(good, defect, verified(case, fine, defect), wrong=False, said=f"{name}, good {k + 1}")
            note(bad, defect, verified(case, wrong, defect), wrong=True, said=f"{name} {k + 1}")
        print(row(f"{name}: good", defect, good), flush=True)
        print(row(name, defect, bad), flush=True)


if __name__ == "__main__":
    main()
