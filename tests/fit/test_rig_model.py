"""The rig's Jacobians against differences through its own step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.camera.lens import BrownConrady
from cadcam.fit.joint_model import JointModel
from cadcam.fit.rig_model import RigModel, RigState
from cadcam.fit.schur import Step
from cadcam.geometry import rotation as so3

FREE = ("aspect", "focal", "skew", "U0", "V0", "k1", "p1")


def model(rng: np.random.Generator) -> tuple[RigModel, RigState]:
    """Two cameras, three frames; the second camera misses the middle one and some points; noise differs."""
    cameras, frames = [], [np.array([0, 1, 2]), np.array([0, 2])]
    for seen, N in zip(frames, (7, 5), strict=True):
        p = rng.uniform(-1, 1, (len(seen), N, 3)) * [80, 60, 40]
        measured = np.ones((len(seen), N), dtype=bool)
        measured[-1, -2:] = False
        q = rng.uniform(0, 800, (len(seen), N, 2))
        cameras.append(JointModel(p, q, measured, FREE, BrownConrady(), np.full(len(seen), N / 10)))
    internals = tuple(np.array([1.02, f, 0.01, 400.0, 500.0]) for f in (900.0, 1100.0))
    lens = tuple(np.array([k, 0.02, 1e-3, *np.zeros(9)])[: len(BrownConrady().parameters)] for k in (-0.1, -0.2))
    state = RigState(
        internals,
        lens,
        np.stack([np.eye(3), so3.exp(np.array([0.1, 0.3, -0.2]))]),
        np.array([[0.0, 0, 0], [-120, 8, 5]]),
        so3.exp(rng.normal(size=(3, 3)) * 0.3),
        np.array([0, 0, 500.0]) + 30 * rng.normal(size=(3, 3)),
    )
    return RigModel(("left", "right"), tuple(cameras), tuple(frames), 3), state


def test_jacobians_are_the_differences_of_the_residuals(rng):
    """Central differences of 1e-5 of the residuals' scale: agreement to 1e-6 of the largest entry of each column."""
    rig, state = model(rng)
    blocks = rig.blocks(state)
    k, n, own = blocks.sizes
    assert (n, own) == (2 * len(FREE) + 6, 6) == (len(rig.shared), 6)
    for i in range(n + own):
        size = 1e-5
        both = []
        for h in (size, -size):
            shared, poses = np.zeros(n), np.zeros((k, own))
            if i < n:
                shared[i] = h
            else:
                poses[:, i - n] = h
            both.append(rig.blocks(rig.retract(state, Step(shared, poses))).r)
        difference = (both[0] - both[1]) / (2 * size)
        column = blocks.by_shared[..., i] if i < n else blocks.by_own[..., i - n]
        assert np.abs(difference - column).max() < 1e-6 * max(1.0, np.abs(column).max())


def test_what_a_camera_did_not_see_counts_nothing(rng):
    """Rows that were not measured, and frames that a camera missed, are zero and no equations."""
    rig, state = model(rng)
    blocks = rig.blocks(state)
    assert blocks.measured is not None
    assert blocks.rows == int(blocks.measured.sum()) == 2 * (3 * 7 - 2 + 2 * 5 - 2)
    for values in (blocks.r, blocks.by_shared, blocks.by_own):
        assert not values[~blocks.measured].any()


def test_a_point_behind_one_camera_forbids_the_state(rng):
    rig, state = model(rng)
    assert not np.isfinite(rig.blocks(replace(state, t=-state.t)).r).all()
