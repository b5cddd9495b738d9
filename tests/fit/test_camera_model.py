"""The reprojection problem: its Jacobian through its own step, batches, and states that are no camera."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES, ExtendedPinhole, angles_of, internals_of, rotation_of
from cadcam.camera.lens import (
    LENSES,
    BrownConrady,
    Division,
    DoubleSphere,
    ExtendedUnified,
    FieldOfView,
    Fisheye,
    Ideal,
    InverseBrownConrady,
    OddRadial,
    TiltedBrownConrady,
)
from cadcam.fit.camera_model import CameraModel, angles, rotations_of
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)
D = np.radians
SAMPLES = [
    Ideal(),
    BrownConrady(-0.2, 0.05, 0.002, -0.001, 0.01, 0.02, -0.01, 0.005, 0.001, 0.002, -0.001, 0.001),
    OddRadial(0.01, -0.1, 0.02, 0.003),
    Division(-0.15),
    Fisheye(-0.03, 0.01, 0.002, -0.001),
    TiltedBrownConrady(-0.2, 0.05, 0.002, -0.001, tau_x=0.05, tau_y=-0.1),
    InverseBrownConrady(0.2, -0.05, 0.002, -0.001, 0.01),
    FieldOfView(0.8),
    ExtendedUnified(0.5, 1.2),
    DoubleSphere(-0.2, 0.6),
]


def scene(lens, free=NAMES, lens_terms=True):
    e = ExtendedPinhole(10.0, 20.0, -30.0, D(20), D(-35), D(75), 1.02, 700.0, D(2), 300.0, 350.0)
    camera, pose = e.camera(SIZE, lens), e.camera_from_world
    in_camera = np.random.default_rng(3).uniform(-1, 1, (7, 3)) * [200, 150, 80] + [0, 0, 500]
    p = pose.inv @ in_camera
    q = camera.project(in_camera) + 3.0
    model = CameraModel(p, q, (*free, *(lens.parameters if lens_terms else ())), lens)
    return model, model.state_of(camera, pose)


def test_every_lens_is_sampled():
    assert {type(lens) for lens in SAMPLES} == set(LENSES.values())


@pytest.mark.parametrize(
    ("lens", "free"),
    [
        pytest.param(
            lens, free, marks=[pytest.mark.slow] * (k > 1 and free != NAMES), id=f"{lens.name}-{'-'.join(free)}"
        )
        for k, lens in enumerate(SAMPLES)
        for free in (NAMES, ("X", "b", "c", "focal"), ("a",), EXTERNALS)
    ],
)
def test_the_jacobian_is_that_of_the_models_own_step(lens, free):
    """Central differences through `retract`; a step of h leaves h^2 of curvature: 1e-7 of the column."""
    model, state = scene(lens, free)
    _, J = model.residuals_and_jacobian(state)
    h = 1e-5
    for i, name in enumerate(model.free):
        step = h * np.eye(len(model.free))[i]
        r = [model.residuals_and_jacobian(model.retract(state, s * step))[0] for s in (1, -1)]
        assert (r[0] - r[1]) / (2 * h) == pytest.approx(J[:, i], abs=2e-6 * np.abs(J[:, i]).max() + 1e-7), name


@pytest.mark.parametrize("free", [NAMES, ("X", "b", "c", "focal")], ids="-".join)
@pytest.mark.parametrize("lens", SAMPLES, ids=lambda x: x.name)
def test_a_batch_is_its_members(rng, lens, free):
    model, state = scene(lens, free)
    states = np.stack([model.retract(state, 1e-3 * rng.normal(size=len(model.free))) for _ in range(4)])
    r, J = model.residuals_and_jacobian(states)
    steps = 1e-3 * rng.normal(size=(4, len(model.free)))
    moved = model.retract(states, steps)
    for i in range(4):
        one = model.residuals_and_jacobian(states[i])
        assert r[i] == pytest.approx(one[0], abs=1e-9)
        assert J[i] == pytest.approx(one[1], abs=1e-9 * np.abs(one[1]).max())
        assert moved[i] == pytest.approx(model.retract(states[i], steps[i]), abs=1e-9)
    assert model.costs(states) == pytest.approx(np.sum(r**2, axis=1))


def test_a_state_gives_its_camera_and_pose_back():
    model, state = scene(SAMPLES[1])
    camera, pose = model.camera(state, SIZE), model.pose(state)
    assert camera.lens == SAMPLES[1]
    assert model.state_of(camera, pose) == pytest.approx(state, abs=1e-10)
    assert model.states(pose.origin, pose.rotation, internals_of(camera.K)) == pytest.approx(state, abs=1e-10)


def test_fixed_angles_do_not_move():
    model, state = scene(Ideal(), ("a", "c", "focal"))
    before = angles(state[3:12].reshape(3, 3))
    after = angles(model.retract(state, np.array([0.1, -0.2, 5.0]))[3:12].reshape(3, 3))
    assert after - before == pytest.approx([0.1, 0.0, -0.2], abs=1e-14)


def test_angles_broadcast_and_agree_with_the_extended_pinhole(rng):
    abc = rng.uniform(-1, 1, (5, 3)) * [3, 1.5, 3]
    R = rotations_of(abc)
    for i in range(5):
        e = ExtendedPinhole(0, 0, 0, *abc[i], 1, 1, 0, 0, 0)
        assert R[i] == pytest.approx(e.camera_from_world.rotation, abs=1e-14)
        assert angles(R)[i] == pytest.approx(angles_of(rotation_of(*abc[i])), abs=1e-14)


@pytest.mark.parametrize(("name", "step"), [("focal", -701.0), ("aspect", -1.1), ("skew", 2.0)])
def test_a_step_out_of_the_cameras_is_forbidden(name, step):
    model, state = scene(Ideal(), (name,))
    moved = model.retract(state, np.array([step]))
    assert np.isnan(model.residuals_and_jacobian(moved)[0]).all()
    assert model.costs(moved) == np.inf


def test_a_point_behind_the_camera_is_forbidden():
    model, state = scene(Ideal())
    behind = model.states(state[:3], Rigid(np.diag([1.0, -1, -1])).rotation @ state[3:12].reshape(3, 3), state[12:17])
    assert model.costs(behind) == np.inf
    assert np.isfinite(model.costs(state))


def test_the_camera_is_untouched_by_a_fixed_lens():
    lens = Division(-0.1)
    model, state = scene(lens, lens_terms=False)
    assert isinstance(model.camera(state, SIZE), Camera)
    assert model.camera(state, SIZE).lens is lens


def test_an_empty_batch_is_no_error():
    """No three-point solution is a batch of none."""
    model, state = scene(Ideal())
    none = state[None][:0]
    r, J = model.residuals_and_jacobian(none)
    assert r.shape == (0, 14)
    assert J.shape == (0, 14, 11)
    assert model.costs(none).shape == (0,)
