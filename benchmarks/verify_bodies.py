"""Do the stated uncertainties of displacements and of turns of bodies hold: displaced any way, turned, sunk, in place.

    python benchmarks/verify_bodies.py [--pictures 32] [--case NAME ...] [--seed 1]

One photo, 480 x 360 px, focal length 740 px, of a plate of 300 x 200 mm with two ribs, a block and a bracket, from 0.8
to 1 m and from any side: 1 mm is 0.8 px. The camera's place, the body that is not as drawn and its motion are drawn
anew for each; blur 0.5 px, noise sigma 3/255, eight bits. displaced: by 0.3 to 8 mm any way. turned and sunk: by 0.2 to
3 deg about the upright, displaced along the plate by up to 3 mm and sunk by 0.05 to 0.6 mm. turned upright: by as much
about the upright alone. tilted: by as much about any axis. The part is verified from 0.3 mm and 0.3 mrad off its pose.

displaced: bodies called so; lost: those called missing; alarms: pictures in which another one is called either. mm:
median error of the displacement found of a body's middle, in the directions that the photo shows. rms: of its
components over their sigmas, 1 where these are true; > 2, > 4: how many of them are beyond so many sigmas, of 100 where
all is well 5 and none. sigma: geometric mean, in mm, in the worst direction. The same of the turn about the line of
sight, in deg. Whatever is more than 4 sigmas off is told on stderr.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Longs
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Scene
from cadcam.verify.deviations.deviation import FeatureDeviation, State
from cadcam.verify.inspection import inspect
from verify_blocks import blamed, drawn, in_words, table

CAMERA = Camera.from_focal((480, 360), 740.0)
BLUR, NOISE, FAR = 0.5, 3.0 / 255, 4.0
LOOK = Look(supersampling=4, background=(0.9, 0.9, 0.9), back=0.35)
BODIES = ("rib 1", "rib 2", "block", "bracket")
CASES = ("displaced", "turned and sunk", "turned upright", "tilted", "in place")


@cache
def plate() -> Mesh:
    """Return the plate with its four bodies, as in the tests of `verify`."""
    color = (0.55, 0.55, 0.6)
    return merge(
        [
            box((-150, -100, 0), (150, 100, 12), name="plate", color=color),
            box((-120, -60, 12), (40, -48, 52), name="rib 1", color=color),
            box((-120, 30, 12), (40, 42, 52), name="rib 2", color=color),
            box((70, -70, 12), (120, -10, 45), name="block", color=color),
            box((75, 30, 12), (125, 70, 40), name="bracket", color=color),
        ]
    )


@dataclass(frozen=True)
class Motion:
    """A body's motion: turned by w (3,) rad about its middle, then shifted by d (3,) mm."""

    name: str
    w: Array
    d: Array

    @classmethod
    def drawn(cls, case: str, rng: np.random.Generator) -> Motion:
        """Return a motion of a case, as chance has it."""
        name, way, axis = str(rng.choice(BODIES)), rng.normal(size=3), rng.normal(size=3)
        size, turn = np.exp(rng.uniform(np.log([0.3, 0.2]), np.log([8.0, 3.0])))
        slid, sunk, sign = rng.uniform(-3, 3, 2), rng.uniform(0.05, 0.6), rng.choice([-1.0, 1.0])
        if case != "tilted":
            axis = np.array([0, 0, sign])
        d = {"displaced": size * way / np.linalg.norm(way), "turned and sunk": np.array([*slid, -sunk])}
        w = np.radians(turn) * axis / np.linalg.norm(axis) if case in CASES[1:4] else np.zeros(3)
        return cls(name, w, d.get(case, np.zeros(3)))

    @property
    def own(self) -> Longs:
        """The vertices of the body."""
        return np.unique(plate().faces[plate().part == plate().part_names.index(self.name)])

    @property
    def moved(self) -> Rigid:
        """The motion of the part frame with the body."""
        middle, R = plate().vertices[self.own].mean(axis=0), exp(self.w)
        return Rigid(R, middle + self.d - R @ middle)

    def built(self) -> Mesh:
        """Return the plate with the body where it came to."""
        vertices = plate().vertices.copy()
        vertices[self.own] = self.moved @ vertices[self.own]
        return replace(plate(), vertices=vertices)


@dataclass
class Tally:
    """What a case came to: of displacements and turns the errors, these over their sigmas, and the sigmas."""

    states: list[State] = field(default_factory=list)
    alarms: int = 0
    mm: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)
    turn_z: list[float] = field(default_factory=list)
    turn_sigma: list[float] = field(default_factory=list)


def pose(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera somewhere above."""
    turn, rise = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(30, 60))
    away = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    return Rigid.look_at(rng.uniform(800, 1000) * away, rng.uniform(-10, 10, 3))


def shots(case: str, pictures: int, seed: int) -> Iterator[tuple[Photo, Rigid, Motion]]:
    """Yield photos (the world is the plate), a pose to verify it from, and what became of one of its bodies."""
    rng = np.random.default_rng([seed, CASES.index(case)])
    for _ in range(pictures):
        camera_from_part, motion = pose(rng), Motion.drawn(case, rng)
        view = open_renderer(Scene.of(motion.built(), edges=NO_EDGES)).render(
            CAMERA, camera_from_part, channels=Channel.IMAGE, look=LOOK
        )
        gray = gaussian_filter(view.gray, BLUR) + rng.normal(0, NOISE, view.gray.shape)
        gray = np.clip(np.round(gray * 255) / 255, 0, 1).astype(np.float32)
        start = Rigid.exp(rng.normal(0, 1, 6) * np.repeat([0.3, 3e-4], 3))
        yield Photo.of(gray, CAMERA, camera_from_part), start, motion


def study(case: str, pictures: int, seed: int) -> Tally:
    """Return how a case came out; errors beyond 4 sigmas are told on stderr."""
    out = Tally()
    for number, (photo, start, motion) in enumerate(shots(case, pictures, seed)):
        seen = inspect(drawn(plate()), [photo], start)
        if not seen.found:
            print(f"{case} {number}: {seen.reason}", file=sys.stderr)
            continue
        found, others = seen.feature(motion.name), [f for f in seen.features if f.name != motion.name]
        out.alarms += any(blamed(f) for f in others)
        worst = measure(out, found, motion)
        if worst > FAR:
            told = f"{np.round(motion.d, 2)} mm, {np.round(np.degrees(motion.w), 2)} deg: {in_words(found)}"
            turns = f"turned by {np.degrees(found.turn):.2f} +- {np.degrees(found.turn_sigma):.2f} deg"
            print(f"{case} {number}: {found.name} {told}, {turns}, {worst:.1f} sigmas off", file=sys.stderr)
    return out


def measure(out: Tally, found: FeatureDeviation, motion: Motion) -> float:
    """Note the errors of what was found of a body, in sigmas; return the worst.

    A displacement is that of what now is where edges were measured: of a body that turns by w and shifts by d it
    differs from that of what was there by w x d, more than sigma sometimes.
    """
    out.states.append(found.state)
    if found.displacement is None:
        return 0.0
    off = found.displacement.value - found.seen.T @ (found.p - motion.moved.inv @ found.p)
    z = np.linalg.solve(np.linalg.cholesky(found.displacement.covariance), off)
    out.mm.append(float(np.linalg.norm(off)))
    out.z += z.tolist()
    out.sigma.append(found.sigma)
    turn_z = float((found.turn - found.axis @ motion.w) / found.turn_sigma)
    if np.isfinite(turn_z):
        out.turn_z.append(turn_z)
        out.turn_sigma.append(float(np.degrees(found.turn_sigma)))
    return float(np.abs([*z, np.nan_to_num(turn_z)]).max())


def spread(z: Collection[float], sigma: Collection[float]) -> list[str]:
    """Return cells: how normalised errors scatter, how many are far off, and the geometric mean of sigmas."""
    if not z:
        return [""] * 4
    size = np.abs(np.array(list(z)))
    beyond = [f"{(size > k).sum()} of {len(size)}" for k in (2, FAR)]
    return [f"{np.sqrt(np.mean(size**2)):.2f}", *beyond, f"{np.exp(np.mean(np.log(list(sigma)))):.3f}"]


def row(case: str, tally: Tally) -> str:
    states = [str(tally.states.count(s)) for s in (State.DISPLACED, State.IN_PLACE, State.UNCLEAR, State.MISSING)]
    median = f"{np.median(tally.mm):.3f}" if tally.mm else ""
    told = [str(tally.alarms), median, *spread(tally.z, tally.sigma), *spread(tally.turn_z, tally.turn_sigma)]
    return "| " + " | ".join([case, str(len(tally.states)), *states, *told]) + " |"


def main() -> None:
    columns = "mm | rms | > 2 | > 4 | sigma | turn rms | > 2 | > 4 | sigma deg"
    states = "displaced | in place | unclear | lost | alarms"
    table(__doc__, f"| pictured | bodies | {states} | {columns} |", CASES, 32, study, row)


if __name__ == "__main__":
    main()
