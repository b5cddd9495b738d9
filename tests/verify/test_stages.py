"""How far a verification has come is told, piece by piece."""

from __future__ import annotations

import numpy as np

from cadcam.geometry.rigid import Rigid
from cadcam.verify.inspection import inspect

from .scene import displaced, part, photo, plate


def test_every_stage_is_told_to_its_end(rng: np.random.Generator) -> None:
    """Of a body that is displaced and one that is missing; the places of a body are tried until one is right."""
    stands = displaced("bracket", None, displaced("block", np.array([2.0, 1.5, 0.0])))
    told: list[tuple[str, int, int]] = []
    inspect(part(), [photo(stands, rng)], Rigid(), tell=lambda *now: told.append(now))
    stages = {stage: [(done, pieces) for s, done, pieces in told if s == stage] for stage, _, _ in told}
    bodies = len(plate().part_names)
    for stage in ("looking for bodies", "comparing bodies", "measuring bodies", "doubting edges", "measuring edges"):
        assert stages[stage][0][0] == 0
        assert stages[stage][-1][0] == stages[stage][-1][1]
    assert {pieces for _, pieces in stages["looking for bodies"]} == {bodies}
    assert any(done == 0 < pieces for done, pieces in stages["trying other places"])
    assert all(0 <= done <= pieces for _, done, pieces in told)
