"""Are bodies that stand beside shadows told: photographs of a block under a lamp, a flash and light from around.

    python benchmarks/verify_shadows.py [--pictures 30] [--case NAME ...] [--seed 1]

Photographs (`cadcam.render.photograph`) of a block of a ship's double bottom, 4 x 3 x 2 m, in a hall: 960 x 720 px, a
lamp that casts shadows with soft borders, a flash at the camera, blur 0.5 px, a machine-vision sensor's noise, eight
bits. Where the camera stands and what light there is are drawn anew for each. Pictured are the block as drawn, one body
missing, one displaced by 4 mm across the line of sight, or five defects at once (three displaced, two missing). Which
body that is is drawn among the bars, brackets and longitudinals of which at least 1500 px are in view. As in `cadcam
verify` the block is located first, from a start some pixels off.

found: defects that are called what they are. of which show: displaced bodies found, of those of which two edges or more
move by 0.5 px or more in the picture (a foot stays where its body sinks), be they seen or not. present: missing bodies
whose presence is a PASS. alarms: pictures in which any body is called displaced or missing that is not. in place,
unclear: states of the bodies in view (of which an edge should show) that are as drawn. PASS, undecided, FAIL: verdicts
on the presence of these. scatter: how far off their places edges of the block as drawn are as a whole, over what noise
alone makes of that; a robust standard deviation. CPU: of locating, and of verifying, a picture, its median and the
longest.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shipblock import ship_block
from cadcam.camera.camera import Camera
from cadcam.cli.demo.inputs import hall
from cadcam.cli.wires import scene_without_edges
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.image.sensor.presets import preset
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.light import Lamp, Light
from cadcam.render.photograph import Photographer
from cadcam.render.view import Channel
from cadcam.verify.deviations.deviation import State
from cadcam.verify.edges.survey import surveyed
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.tolerances.tolerance import Limit, Quantity, whole_parts
from cadcam.verify.tolerances.verdict import Verdict
from verify_blocks import across, blamed, built, drawn, in_words, table, verdict

CAMERA = Camera.from_focal((960, 720), 1200.0)
SAMPLES, DISPLACED_MM = 16, 4.0
SUBJECTS = ("bar", "bracket", "longitudinal")
LEAST_PX, LEAST_BODIES = 1500, 5
MOVES_PX, LEAST_PLACES, REACH_PX = 0.5, 4, 8.0  # of an edge that shows a displacement
CASES = {"as drawn": (0, 0), "one missing": (0, 1), "one displaced": (1, 0), "five defects": (3, 2)}


@dataclass(frozen=True)
class Shot:
    """A photo (the world is the true block), a start for the block's pose, and what is wrong with the block."""

    photo: Photo
    start: Rigid
    moved: dict[str, Array]
    gone: tuple[str, ...]

    def truth(self, name: str) -> State:
        """Return what became of a body."""
        if name in self.gone:
            return State.MISSING
        return State.DISPLACED if name in self.moved else State.IN_PLACE


@dataclass
class Tally:
    """What a case came to."""

    pictures: int = 0
    lost: int = 0
    defects: int = 0
    found: int = 0
    shows: list[bool] = field(default_factory=list)
    present: int = 0
    alarms: int = 0
    states: list[State] = field(default_factory=list)
    presences: list[Verdict] = field(default_factory=list)
    scatter: list[float] = field(default_factory=list)
    locating: list[float] = field(default_factory=list)
    verifying: list[float] = field(default_factory=list)


@cache
def block() -> Mesh:
    whole = ship_block(triangles=10_000)
    return whole.subset([name for name in whole.part_names if "pipe" not in name and "flange" not in name])


def pose(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera that looks into the block from its open side."""
    target = np.array([2000.0, 750.0, 350.0]) + rng.uniform(-1, 1, 3) * [1000, 250, 250]
    turn, rise = np.radians(rng.uniform(-60, 60)), np.radians(rng.uniform(20, 55))
    back = np.array([np.sin(turn) * np.cos(rise), -np.cos(turn) * np.cos(rise), np.sin(rise)])
    up = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.05, 3)
    return Rigid.look_at(target + rng.uniform(1700, 3000) * back, target, up=up)


def lights(rng: np.random.Generator) -> Light:
    """Return a lamp at random somewhere above, as wide as half a degree to four, a flash and what comes from around."""
    turn, rise = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(25, 80))
    towards = (np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise))
    lamp = Lamp((float(towards[0]), float(towards[1]), float(towards[2])), rng.uniform(0.4, 0.9), rng.uniform(0.5, 4.0))
    return Light((lamp,), flash=rng.uniform(0.2, 0.9), ambient=rng.uniform(0.15, 0.35))


def in_view(camera_from_part: Rigid) -> list[str]:
    """Return the bodies that may be displaced or missing: enough of each is to be seen."""
    view = open_renderer(drawn(block()).scene).render(CAMERA, camera_from_part, channels=Channel.PART)
    count = np.bincount(view.part[view.part >= 0], minlength=len(block().part_names))
    return [n for n, k in zip(block().part_names, count, strict=True) if k >= LEAST_PX and n.startswith(SUBJECTS)]


def photographed(mesh: Mesh, camera_from_part: Rigid, light: Light, rng: np.random.Generator) -> Picture:
    """Return the grey picture of a mesh in its hall."""
    seen = Photographer(scene_without_edges(merge([mesh, *hall()])))
    radiance = seen.radiance(CAMERA, camera_from_part, light=light, blur_px=0.5, samples=SAMPLES)
    return preset("global-shutter").apply(to_gray(radiance.over((0.3, 0.3, 0.3))), rng=rng)


def shots(case: str, pictures: int, seed: int) -> Iterator[Shot]:
    """Yield what is photographed."""
    n_moved, n_gone = CASES[case]
    rng = np.random.default_rng([seed, list(CASES).index(case)])
    made = 0
    while made < pictures:
        camera_from_part, light = pose(rng), lights(rng)
        names = in_view(camera_from_part)
        if len(names) < LEAST_BODIES:
            continue
        chosen = [str(name) for name in rng.permutation(names)]
        moved = {name: across(camera_from_part, DISPLACED_MM, rng) for name in chosen[:n_moved]}
        gone = tuple(chosen[n_moved : n_moved + n_gone])
        gray = photographed(built(block(), moved, gone), camera_from_part, light, rng)
        start = Rigid.exp(rng.normal(0, 1, 6) * np.repeat([3.0, 2e-3], 3))
        made += 1
        yield Shot(Photo.of(gray, CAMERA, camera_from_part), start, moved, gone)


def study(case: str, pictures: int, seed: int) -> Tally:
    """Return how a case came out."""
    out = Tally()
    for shot in shots(case, pictures, seed):
        judge(out, case, shot)
    return out


def judge(out: Tally, case: str, shot: Shot) -> None:
    """Note how a picture came out; what was not as it should be is told on stderr."""
    out.pictures += 1
    began = time.process_time()
    located = locate_part(drawn(block()), [shot.photo], shot.start)
    out.locating.append(time.process_time() - began)
    began = time.process_time()
    seen = inspect(drawn(block()), [shot.photo], located.pose.world_from_part) if located.found else None
    out.verifying.append(time.process_time() - began)
    if seen is None or not seen.found:
        out.lost += 1
        print(f"{case} {out.pictures}: {located.reason if seen is None else seen.reason}", file=sys.stderr)
        return
    if not shot.moved and not shot.gone:
        out.scatter += off_by_noise(seen)
    wrong = 0
    out.shows += [seen.feature(n).state is State.DISPLACED for n, by in shot.moved.items() if moving(shot, n, by) > 1]
    for f in seen.features:
        truth = shot.truth(f.name)
        out.defects += truth is not State.IN_PLACE
        out.found += truth is not State.IN_PLACE and f.state is truth
        alarm = blamed(f) and f.state is not truth
        wrong += alarm
        presence = verdict(seen, f.name, Limit(Quantity.PRESENCE, 1.0))
        out.present += truth is State.MISSING and presence is Verdict.PASS
        if alarm or (truth is not State.IN_PLACE and f.state is not truth):
            shows = f", {moving(shot, f.name, shot.moved[f.name])} edges move" if f.name in shot.moved else ""
            print(f"{case} {out.pictures}: {f.name}, {truth.value}{shows}, is {in_words(f)}", file=sys.stderr)
        if truth is State.IN_PLACE and f.presence.expected:
            out.states.append(f.state)
            out.presences.append(presence)
    out.alarms += wrong > 0


def moving(shot: Shot, name: str, by: Array) -> int:
    """Return how many edges of a body move by `MOVES_PX` or more in the photo when it is displaced by (3,) mm."""
    part = drawn(block())
    seen = surveyed(part, [shot.photo], Rigid(), whole_parts(part.scene), reach_px=REACH_PX)
    if name not in seen.names:
        return 0
    sinks = np.where(seen.ground @ by < 0, seen.lever, 0.0)
    px = np.abs((seen.lines.by_point - sinks[:, None] * seen.ground) @ by)
    rows = seen.rows(seen.names.index(name))
    edges = [px[rows & (seen.lines.edge == e)] for e in np.unique(seen.lines.edge[rows])]
    return sum(len(e) >= LEAST_PLACES and float(np.median(e)) >= MOVES_PX for e in edges)


def off_by_noise(seen: Inspection) -> list[float]:
    """Return of each edge without a twin its mean offset from the true place, over the sigma that noise gives it.

    The world is the true block: at the true pose it is at the origin.
    """
    assert seen.measured is not None
    m = seen.measured
    fitted = m.adjustment.pose().xi
    to_true_pose = (Rigid.exp(fitted) @ seen.pose.world_from_part.inv).log()
    offset, noise = m.adjustment.offset - m.lines.by_pose @ to_true_pose, m.own_noise
    sums = [np.bincount(noise.edge, x, noise.edges) for x in (offset / noise.sigma**2, 1 / noise.sigma**2)]
    return list((sums[0] / np.sqrt(sums[1]))[noise.tau == 0])


def row(case: str, tally: Tally) -> str:
    n, bodies = tally.pictures, max(len(tally.states), 1)
    found = f"{100 * tally.found / tally.defects:.1f} % of {tally.defects}" if tally.defects else ""
    states = [f"{100 * tally.states.count(s) / bodies:.1f} %" for s in (State.IN_PLACE, State.UNCLEAR)]
    verdicts = [
        f"{100 * tally.presences.count(v) / bodies:.1f} %" for v in (Verdict.PASS, Verdict.UNDECIDED, Verdict.FAIL)
    ]
    times = [f"{1000 * np.median(t):.0f}, {1000 * np.max(t):.0f}" for t in (tally.locating, tally.verifying)]
    scatter = f"{np.median(np.abs(tally.scatter)) / 0.6745:.2f}" if tally.scatter else ""
    cells = [
        case,
        str(n),
        found,
        f"{sum(tally.shows)} of {len(tally.shows)}" if tally.shows else "",
        str(tally.present),
        str(tally.lost),
        f"{100 * tally.alarms / n:.1f} %",
        str(len(tally.states)),
        *states,
    ]
    return "| " + " | ".join([*cells, *verdicts, scatter, *times]) + " |"


def main() -> None:
    columns = (
        "found | of which show | present | no pose | alarms | bodies | in place | unclear | PASS | undecided | FAIL"
    )
    head = f"| pictured | pictures | {columns} | scatter | locate CPU ms | verify CPU ms |"
    table(__doc__, head, CASES, 30, study, row)


if __name__ == "__main__":
    main()
