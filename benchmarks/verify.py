"""Are displaced and missing parts found, how often is one blamed wrongly, do the stated uncertainties hold: simulated.

    python benchmarks/verify.py [--pictures 200] [--case NAME ...] [--seed 1]

Pictures of a block of a ship's double bottom, 2.4 x 2.4 x 1.2 m (`cadcam.cad.parts.shipblock`, without its pipe, whose
facets a photo would not show), 768 x 576 px, focal length 1185 px, from 1.55 m: poses, lights and their strengths are
drawn anew for each, blur 0.5 px, noise sigma 3/255, eight bits. In the pictured block one part is displaced by 1 mm
across the line of sight, or by 5 mm, or is not there; the CAD is the nominal one. As in `cadcam verify` the part is
located, from a start some pixels off, and where it is not found there is no verdict. A picture counts if at least
2500 px of the block's lines, 300 px of them the part's own, should be visible in it, and 150 px of those with a step of
8 grey levels (of 255) or more.

found: the part is called displaced (or missing). no pose: pictures in which the block was not found. alarms: pictures
in which any other part is called so. error: of the displacement found, in the directions that the photo shows; z: rms
of its components over their sigmas; U: median of 2 sigma, in the worst of these directions; in U: share of pictures in
which the displacement's length is within U of the truth. PASS, FAIL, undecided: verdicts on a position limit of 0.5 mm.
What was not as it should be is told on stderr. A picture takes about 0.8 s of CPU time, a third of it to render: 100 of
each case ten minutes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from cadcam.arrays import Array, Picture
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shipblock import ship_block
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene
from cadcam.verify.deviations.deviation import State
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.tolerances.tolerance import Limit, Quantity
from cadcam.verify.tolerances.verdict import Verdict
from verify_blocks import across, blamed, built, drawn, in_words, table, verdict

CAMERA = Camera.from_focal((768, 576), 1185.0)
DISTANCE, BLUR, NOISE, LIMIT = 1550.0, 0.5, 3.0 / 255, 0.5
STIFFENER, BRACKET = "bar 1.1 port", "bracket 2.1 port"
LEAST_PX, LEAST_OF_ALL_PX = 300.0, 2500.0
LEAST_WITH_STEP_PX, LEAST_STEP = 150.0, 8.0 / 255
FAR = 5.0  # sigmas of an error that is told
CASES = {
    "nothing wrong": (None, 0.0),
    "stiffener 1 mm off": (STIFFENER, 1.0),
    "bracket 1 mm off": (BRACKET, 1.0),
    "stiffener 5 mm off": (STIFFENER, 5.0),
    "bracket 5 mm off": (BRACKET, 5.0),
    "stiffener missing": (STIFFENER, np.nan),
    "bracket missing": (BRACKET, np.nan),
}


@dataclass
class Tally:
    """What a case came to."""

    pictures: int = 0
    found: int = 0
    alarms: int = 0
    lost: int = 0
    error: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    within: list[bool] = field(default_factory=list)
    U: list[float] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


@cache
def block() -> Mesh:
    whole = ship_block(triangles=29_000, size=(2400.0, 2400.0, 1200.0))
    return whole.subset([name for name in whole.part_names if name != "pipe" and "flange" not in name])


def pose(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera that looks between two floors."""
    target = np.array([850.0, 640.0, 180.0]) + rng.normal(0, [40, 20, 30])
    eye = np.array([850.0, 1150.0, 1600.0]) + rng.normal(0, [250, 120, 100])
    away = eye - target
    up = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.15, 3)
    return Rigid.look_at(target + away / np.linalg.norm(away) * DISTANCE, target, up=up)


def lights(rng: np.random.Generator) -> Look:
    """Return lights drawn at random."""
    x, y, z = rng.normal([-0.5, -0.8, -0.3], 0.5)
    return Look(
        head=rng.uniform(0.3, 0.6),
        fill=rng.uniform(0.2, 0.5),
        back=rng.uniform(0.1, 0.3),
        ambient=rng.uniform(0.15, 0.3),
        fill_from=(x, y, z),
        background=(0.7, 0.7, 0.7),
        supersampling=4,
    )


def rendered(mesh: Mesh, camera_from_part: Rigid, look: Look) -> Picture:
    """Return the grey picture of a mesh, blurred as a lens would, without noise."""
    view = open_renderer(Scene.of(mesh, edges=NO_EDGES)).render(
        CAMERA, camera_from_part, channels=Channel.IMAGE, look=look
    )
    return np.asarray(gaussian_filter(view.gray, BLUR), np.float32)


def shows(camera_from_part: Rigid, name: str | None, look: Look) -> bool:
    """Return whether enough of the block and of one of its parts is in the picture, the part's with contrast."""
    lines = drawn(block()).lines.draw(CAMERA, camera_from_part).visible
    q, normal, line, _ = lines.points_along(2.0)
    inside = CAMERA.sees(q)
    if 2 * inside.sum() < LEAST_OF_ALL_PX or name is None:
        return bool(2 * inside.sum() >= LEAST_OF_ALL_PX)
    mine = inside & (lines.part[line] == block().part_names.index(name))
    if 2 * mine.sum() < LEAST_PX:
        return False
    gray = rendered(block(), camera_from_part, look)
    sides = [map_coordinates(gray, (q[mine] + t * normal[mine]).T[::-1], order=1, mode="nearest") for t in (-2, 2)]
    return bool(2 * (np.abs(sides[1] - sides[0]) >= LEAST_STEP).sum() >= LEAST_WITH_STEP_PX)


def shots(case: str, pictures: int, seed: int) -> Iterator[tuple[Photo, Rigid, Array | None]]:
    """Yield photos (the world is the true part), a start for the part's pose, and the displacement (3,) mm."""
    name, size = CASES[case]
    rng = np.random.default_rng([seed, list(CASES).index(case)])
    made = 0
    while made < pictures:
        camera_from_part, look = pose(rng), lights(rng)
        if not shows(camera_from_part, name, look):
            continue
        by = None if name is None or np.isnan(size) else across(camera_from_part, size, rng)
        moved = {} if name is None or by is None else {name: by}
        gone = () if name is None or by is not None else (name,)
        clean = rendered(built(block(), moved, gone), camera_from_part, look)
        gray = np.clip(np.round((clean + rng.normal(0, NOISE, clean.shape)) * 255) / 255, 0, 1)
        start = Rigid.exp(rng.normal(0, 1, 6) * np.repeat([2.0, 2e-3], 3))
        made += 1
        yield Photo.of(gray, CAMERA, camera_from_part), start, by


def count_flagged(out: Tally, case: str, seen: Inspection, name: str | None, wanted: State) -> None:
    """Count whether the body of that name is flagged as what it is, and whether another is; tell what is wrong."""
    flagged = {f.name: f.state for f in seen.features if blamed(f)}
    out.found += flagged.get(name or "") is wanted
    out.alarms += bool(set(flagged) - {name})
    if set(flagged) - {name} or (name and flagged.get(name) is not wanted):
        tell(case, out.pictures, seen, name)


def study(case: str, pictures: int, seed: int) -> Tally:
    """Return how a case came out."""
    name, size = CASES[case]
    out = Tally()
    wanted = State.MISSING if np.isnan(size) else State.DISPLACED
    for photo, start, by in shots(case, pictures, seed):
        began = time.process_time()
        located = locate_part(drawn(block()), [photo], start)
        seen = inspect(drawn(block()), [photo], located.pose.world_from_part) if located.found else None
        out.seconds.append(time.process_time() - began)
        out.pictures += 1
        if seen is None or not seen.found:
            out.lost += 1
            print(f"{case} {out.pictures}: {located.reason if seen is None else seen.reason}", file=sys.stderr)
            continue
        count_flagged(out, case, seen, name, wanted)
        for target in (STIFFENER, BRACKET) if name is None else (name,):
            if measure(out, seen, target, by) > FAR:
                tell(case, out.pictures, seen, target)
    return out


def tell(case: str, number: int, seen: Inspection, name: str | None) -> None:
    """Say on stderr what was not as it should be."""
    for f in seen.features:
        if f.name == name or blamed(f):
            print(f"{case} {number}: {f.name} {in_words(f)}", file=sys.stderr)


def measure(out: Tally, seen: Inspection, name: str, by: Array | None) -> float:
    """Note the error of the displacement found of a part, and the verdict on it; return the error over its sigma."""
    found = next((f for f in seen.features if f.name == name), None)
    if found is None or found.displacement is None:
        return 0.0
    out.verdicts.append(verdict(seen, name, Limit(Quantity.POSITION, LIMIT)))
    truth = found.seen.T @ (np.zeros(3) if by is None else by)
    off = found.displacement.value - truth
    root = np.linalg.cholesky(found.displacement.covariance)
    out.error.append(float(np.linalg.norm(off)))
    z = np.linalg.solve(root, off)
    out.z += z.tolist()
    out.U.append(2 * found.sigma)
    out.within.append(bool(abs(found.size - np.linalg.norm(truth)) <= 2 * found.sigma))
    return float(np.abs(z).max(initial=0.0))


def row(case: str, tally: Tally) -> str:
    name, size = CASES[case]
    n = tally.pictures
    found = "" if name is None else f"{100 * tally.found / n:.1f} %"
    cells = [case, str(n), found, str(tally.lost), f"{100 * tally.alarms / n:.1f} %"]
    if tally.error and not np.isnan(size):
        verdicts = [100 * tally.verdicts.count(v) / len(tally.verdicts) for v in (Verdict.PASS, Verdict.FAIL)]
        cells += [f"{np.median(tally.error):.3f}", f"{np.sqrt(np.mean(np.square(tally.z))):.2f}"]
        cells += [
            f"{np.median(tally.U):.2f}",
            f"{100 * np.mean(tally.within):.0f} %",
            f"{verdicts[0]:.0f} %",
            f"{verdicts[1]:.0f} %",
        ]
        cells.append(f"{100 - sum(verdicts):.0f} %")
    else:
        cells += [""] * 7
    return "| " + " | ".join([*cells, f"{1000 * np.median(tally.seconds):.0f}"]) + " |"


def main() -> None:
    columns = "found | no pose | alarms | error mm | z rms | U mm | in U | PASS | FAIL | undecided | CPU ms"
    table(__doc__, f"| pictured | pictures | {columns} |", CASES, 200, study, row)


if __name__ == "__main__":
    main()
