"""How far off matches are by their own sigmas, where a template shows an edge, a line, a strip, a corner or texture.

    python benchmarks/match_edges.py --draws 50

A template of 48 x 48 px and a picture of 240 x 200 px, both drawn anew with noise and rounded to eight bits, turned by
a random angle. Rms of error / sigma: of the place across the edge (of what has no open direction: of x and y), and of
the angle, whose rms error stands beside it. Searched at any angle, within 0.02 rad, and within 0.02 rad at scales 0.87
to 1.15 as well.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from cadcam.arrays import Array
from cadcam.image.correlate import ANY_ANGLE, CorrelateOptions, correlate
from cadcam.image.template import Template

SHAPE, SIDE = (200, 240), 48
KINDS = {"edge": True, "line": True, "strip": True, "corner": False, "texture": False}  # whether its place is open
WAVES = [(0.31, 0.05, 1.0), (-0.12, 0.27, 2.0), (0.21, 0.43, 5.0), (0.07, -0.19, 4.0), (0.39, -0.33, 0.5)]
SEARCHES = {
    "any angle": ANY_ANGLE,
    "angle known": CorrelateOptions(angles=(-0.02, 0.02)),
    "and scale free": CorrelateOptions(angles=(-0.02, 0.02), scales=(0.87, 1.15)),
}


def shown(kind: str, u: Array, v: Array) -> Array:
    def step(x: Array) -> Array:
        return np.asarray(0.5 + 0.5 * np.tanh(x / 0.8))

    if kind == "edge":
        return 0.3 + 0.4 * step(u)
    if kind == "line":
        return np.asarray(0.3 + 0.4 * np.exp(-0.5 * (u / 1.5) ** 2))
    if kind == "strip":
        return 0.3 + 0.4 * (step(u + 7) - step(u - 7))
    if kind == "corner":
        return 0.3 + 0.4 * step(u) * step(v)
    return np.asarray(0.5 + 0.07 * sum(np.sin(a * u + b * v + c) for a, b, c in WAVES))


def taken(kind: str, q: Array, angle: float, shape: tuple[int, int], noise: float, rng: np.random.Generator) -> Array:
    y, x = np.mgrid[: shape[0], : shape[1]]
    c, s = math.cos(angle), math.sin(angle)
    u, v = c * (x - q[0]) + s * (y - q[1]), c * (y - q[1]) - s * (x - q[0])
    picture = shown(kind, u, v) + rng.normal(scale=noise, size=shape)
    return np.asarray(np.round(np.clip(picture, 0, 1) * 255) / 255)


def error(kind: str, noise: float, options: CorrelateOptions, rng: np.random.Generator) -> list[float] | None:
    """Return errors of place and angle of one match over their sigmas, and of the angle (rad); None if not found."""
    free = options.angles == ANY_ANGLE.angles
    tilt, turn = rng.uniform(-math.pi, math.pi), rng.uniform(-math.pi, math.pi) if free else rng.uniform(-0.01, 0.01)
    q = np.array(SHAPE[::-1]) / 2 + rng.uniform(-3, 3, 2)
    template = Template(taken(kind, np.full(2, (SIDE - 1) / 2), tilt, (SIDE, SIDE), noise, rng))
    peaks = correlate(taken(kind, q, tilt + turn, SHAPE, noise, rng), template, options=options)
    if not len(peaks):
        return None
    off, C = peaks.q[0] - q, peaks.covariance[0, :2, :2]
    wrong = (peaks.angle[0] - turn + math.pi) % (2 * math.pi) - math.pi
    if not KINDS[kind]:
        return [*np.linalg.solve(np.linalg.cholesky(C), off), wrong / peaks.sigma[0, 2], wrong]
    if kind != "edge" and abs(wrong) > math.pi / 2:  # a line or a strip looks the same turned over
        wrong -= math.copysign(math.pi, wrong)
    across = np.array([math.cos(tilt + turn), math.sin(tilt + turn)])
    return [across @ off / math.sqrt(across @ C @ across), wrong / peaks.sigma[0, 2], wrong]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("| template | noise of 255 | search | found | place, rms / sigma | angle, rms / sigma | angle, rms deg |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for kind in KINDS:
        for noise in (3, 0):
            for search, options in SEARCHES.items():
                rng = np.random.default_rng(arguments.seed)
                every = [error(kind, noise / 255, options, rng) for _ in range(arguments.draws)]
                found = np.array([one for one in every if one is not None])
                rms = np.sqrt(np.mean(found**2, axis=0))
                place = ", ".join(f"{v:.2f}" for v in rms[:-2])
                angle = f"{rms[-2]:.2f} | {math.degrees(rms[-1]):.3f}"
                print(f"| {kind} | {noise} | {search} | {len(found)} | {place} | {angle} |", flush=True)


if __name__ == "__main__":
    main()
