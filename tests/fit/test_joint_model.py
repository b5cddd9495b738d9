"""The joint model's Jacobians against differences through its own step, every kind of parameter at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.camera.lens import BrownConrady, Division, Fisheye
from cadcam.fit.joint_model import BEND, Control, JointModel, JointState
from cadcam.fit.schur import Step
from cadcam.geometry import rotation as so3

K, N, P = 3, 7, 5


def model_and_state(rng, lens, *, noise=1.0, missing=0.0):
    p = rng.uniform(-80, 80, (K, N, 3))
    index = rng.integers(0, P + 1, (K, N))  # P: a fixed point
    model = JointModel(
        p=p,
        q=rng.uniform(0, 600, (K, N, 2)),
        measured=rng.random((K, N)) >= missing,
        free=("aspect", "focal", "skew", "U0", "V0", *lens.parameters, *BEND),
        lens=lens,
        noise=np.full(K, noise),
        bump=rng.uniform(0, 1, (K, N, 2)),
        control=Control(index, 1 / rng.uniform(0.1, 1, (P, 3))),
        priors=(("focal", 790.0, 3.0), ("bend_x", 0.1, 0.5)),
    )
    state = JointState(
        internals=np.array([1.01, 800, 0.01, 300, 330]),
        lens=np.array(list(lens.parameters.values())),
        bend=np.array([0.3, -0.2]),
        shift=0.1 * rng.normal(size=(P, 3)),
        R=so3.exp(0.5 * rng.normal(size=(K, 3))),
        t=np.array([5.0, -8.0, 400.0]) + rng.normal(size=(K, 3)),
    )
    return model, state


LENSES = [BrownConrady(-0.1, 0.05, 1e-3, 2e-3, 0.01, 0.02, 0.01, 0.0, 1e-3, 0, 2e-3, 0), Division(-0.1), Fisheye(-0.02)]


@pytest.mark.parametrize("lens", LENSES, ids=[lens.name for lens in LENSES])
@pytest.mark.parametrize(("noise", "missing"), [(1.0, 0.0), (0.3, 0.3)])
def test_jacobians_are_the_slopes_of_the_residuals(rng, lens, noise, missing):
    """Central differences: good to about 1e-7 of a column's length."""
    model, state = model_and_state(rng, lens, noise=noise, missing=missing)
    at = model.blocks(state)
    n = len(model.shared)
    assert at.sizes == (K, n, 6)
    assert at.dof == 2 * model.measured.sum() + 2 + 3 * P - n - 6 * K

    def slope(shared, own, h):
        plus, minus = (model.blocks(model.retract(state, Step(s * h * shared, s * h * own))) for s in (1, -1))
        return (plus.r - minus.r) / (2 * h), (plus.alone_r - minus.alone_r) / (2 * h)

    for i in range(n):
        h = 1e-4 if i in (1, 3, 4) or i >= len(model.free) else 1e-6
        r, alone = slope(np.eye(n)[i], np.zeros((K, 6)), h)
        assert at.by_shared[..., i] == pytest.approx(r, abs=1e-6 * max(1.0, np.abs(r).max())), model.shared[i]
        assert at.alone[:, i] == pytest.approx(alone, abs=1e-7)
    for i in range(6):
        r, _ = slope(np.zeros(n), np.tile(np.eye(6)[i], (K, 1)), 1e-4 if i < 3 else 1e-6)
        assert at.by_own[..., i] == pytest.approx(r, abs=1e-6 * max(1.0, np.abs(r).max()))


def test_pixels_without_jacobian_are_the_same_pixels(rng):
    model, state = model_and_state(rng, LENSES[0], noise=0.5, missing=0.3)
    r = model.residuals(state)
    assert np.isnan(r[~model.measured]).all()
    rows = np.concatenate([r[..., 0], r[..., 1]], axis=1) / 0.5
    assert model.blocks(state).r == pytest.approx(np.nan_to_num(rows), abs=1e-9)


def test_views_may_be_chosen_and_repeated(rng):
    model, state = model_and_state(rng, LENSES[1])
    twice = model.with_views([2, 2])
    chosen = replace(state, R=state.R[[2, 2]], t=state.t[[2, 2]])
    assert twice.blocks(chosen).r == pytest.approx(np.tile(model.blocks(state).r[2], (2, 1)))
