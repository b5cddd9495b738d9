"""Success rate and CPU time of putting marks into the order of their plan.

    python benchmarks/order.py --plans 20

Random plans of M marks in a square, seen by a camera of 768 x 576 px from 0 to 60 degrees of tilt at any turn; some of
the marks missing, as many false ones among them, 0.3 px of noise. "right": plans in which every true mark got its
number. "CPU ms": of one order, median and slowest.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.camera.camera import Camera
from cadcam.errors import NoOrder
from cadcam.geometry.rigid import Rigid
from cadcam.target.order.ordering import order_marks

CAMERA = Camera.from_focal((768, 576), 900.0)
NOISE = 0.3  # px


def scattered(rng: np.random.Generator, count: int) -> Array:
    plan: list[Array] = []
    while len(plan) < count:
        p = rng.uniform(-0.5, 0.5, 2)
        if all(np.hypot(*(p - other)) > 0.6 / np.sqrt(count) for other in plan):
            plan.append(p)
    return np.array(plan)


def seen(rng: np.random.Generator, plan: Array, tilt: float, spoilt: int) -> tuple[Array, Ids]:
    turned = Rigid.exp([0, 0, 0, np.radians(tilt), 0, 0]) @ Rigid.exp([0, 0, 0, 0, 0, rng.uniform(0, 2 * np.pi)])
    at = Rigid(translation=np.array([0, 0, 1.6])) @ turned
    kept = rng.permutation(len(plan))[spoilt:]
    q = CAMERA.project(at @ np.column_stack([plan, np.zeros(len(plan))]))[kept] + rng.normal(0, NOISE, (len(kept), 2))
    q = np.concatenate([q, rng.uniform(q.min(axis=0), q.max(axis=0), (spoilt, 2))])
    return q, np.concatenate([kept, np.full(spoilt, -1)]).astype(np.int32)


def rows(plans: int) -> Iterator[str]:
    for count, spoilt in ((8, 0), (12, 2), (20, 4), (60, 12), (200, 40)):
        for tilt in (0, 30, 45, 60):
            right = refused = ambiguous = 0
            cpu = []
            for seed in range(plans):
                rng = np.random.default_rng([seed, count, tilt])
                plan = scattered(rng, count)
                q, truth = seen(rng, plan, tilt, spoilt)
                start = time.process_time()
                try:
                    found = order_marks(q, plan)
                    right += bool((found.plan_index == truth)[truth >= 0].all())
                    ambiguous += found.ambiguous
                except NoOrder:
                    refused += 1
                cpu.append(1e3 * (time.process_time() - start))
            yield (
                f"| {count} | {spoilt} | {tilt} | {right}/{plans} | {ambiguous} | {refused} | {np.median(cpu):.0f} | "
                f"{max(cpu):.0f} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=20, help="random plans a row")
    plans = parser.parse_args().plans
    plan = scattered(np.random.default_rng(0), 20)
    order_marks(300 * plan, plan)  # imports
    print("| marks | missing, false | tilt | right | ambiguous | refused | CPU ms | slowest |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows(plans):
        print(row, flush=True)


if __name__ == "__main__":
    main()
