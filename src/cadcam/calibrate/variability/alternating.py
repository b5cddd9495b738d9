"""The variability of the internals where every draw has another camera pose (thesis, Tables 2.17, 2.18)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief, Mask, frozen
from cadcam.calibrate.points.camera import Method
from cadcam.calibrate.variability.methods import Variability, blocks, independent, noise_of
from cadcam.calibrate.variability.repeated import estimates, free_of, model_of, refuse_method, unwrapped
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.sampling import Progress
from cadcam.kinds import expect, expect_flag, expect_positive

_TRIES = 100  # sets of poses drawn per set of visible ones


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Alternating(Brief):
    """Estimates of a camera with another pose in every draw.

    errors: estimated minus drawn, added to the values of the estimate that was varied: those of the internals are the
    estimated internals. drawn: the externals (M, 6) of each draw, mm, rad.
    """

    errors: Variability
    drawn: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "drawn", frozen(self.drawn, "drawn externals", (len(self.errors.values), 6)))

    @property
    def correlation_with_drawn(self) -> Array:
        """Return the correlations (11, 11) of the externals *drawn* with the estimated internals: Table 2.18.

        They vanish for any camera, because the noise is independent of the pose; the correlation of the errors is
        `errors.correlation`.
        """
        found = self.errors.values[:, len(EXTERNALS) :]
        return np.corrcoef(np.column_stack([self.drawn, found]).T)


def alternating_externals(
    estimate: CameraEstimate,
    *,
    rng: np.random.Generator,
    spread_mm: float,
    spread_deg: float,
    draws: int = 2000,
    sigma_px: float | None = None,
    method: Method = "reprojection",
    visible: bool = True,
    progress: Progress | None = None,
) -> Alternating:
    """Return estimates of synthetic observations from poses drawn about the estimate's, its internals kept.

    Position and angles are drawn uniformly, within +-spread_mm and +-spread_deg of the estimated ones; poses from which
    a point lies behind the camera or outside the picture are drawn again. visible=False keeps them, as the thesis must
    have done: its matrix images points from behind too. Only a linear `method` can use those. All else as in
    `monte_carlo_variability`. Raises `DegenerateGeometry` for a spread that leaves hardly a visible pose, `BadValue`
    unless exactly the eleven parameters are free.
    """
    expect(estimate, "estimate", CameraEstimate)
    expect(rng, "rng", np.random.Generator)
    _refuse(estimate, method, visible, spread_mm, spread_deg)
    noise = noise_of(estimate, sigma_px)
    model, state = model_of(estimate)
    every = model.parameters(state)
    truth = free_of(model, every)
    spread = np.concatenate([np.full(3, spread_mm), np.full(3, np.radians(spread_deg))])
    values, drawn = [], []
    for count in blocks(draws):
        states = _poses(estimate, model, every, spread, visible, count, rng)
        q = _imaged(estimate, model, states)
        q = q + noise * rng.standard_normal(q.shape)
        p = np.broadcast_to(model.p_world, (count, *model.p_world.shape))
        found, good = estimates(replace(model, p_world=p, q=q), states, method, noise_px=noise)
        stood = free_of(model, model.parameters(states))[good]
        drawn.append(stood[:, :6])
        values.append(truth + unwrapped(found[good], NAMES, stood) - stood)
        if progress is not None:
            progress()
    errors = independent(NAMES, truth, np.concatenate(values), draws, noise, 0.0)
    return Alternating(errors, np.concatenate(drawn))


def _refuse(estimate: CameraEstimate, method: Method, visible: bool, spread_mm: float, spread_deg: float) -> None:
    refuse_method(method, estimate)
    expect_flag(visible, "visible")
    if estimate.free != NAMES:
        raise BadValue("free parameters", " ".join(estimate.free), "all eleven, and those only")
    if not visible and method == "reprojection":
        raise BadValue("visible", False, "True for least squares: there is nothing to see behind a camera")
    for what, value in (("spread_mm", spread_mm), ("spread_deg", spread_deg)):
        expect_positive(value, what, "0 or more", zero=True)


def _poses(
    estimate: CameraEstimate,
    model: CameraModel,
    parameters: Array,
    spread: Array,
    visible: bool,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """Return states (count, k), if `visible` only such that image all points."""
    kept = np.zeros((0, 6 + len(parameters)))
    for _ in range(_TRIES):
        values = np.repeat(parameters[None], count, axis=0)
        values[:, :6] += spread * rng.uniform(-1, 1, (count, 6))
        states = model.from_parameters(values)
        kept = np.concatenate([kept, states[_sees_all(estimate, model, states)] if visible else states])
        if len(kept) >= count:
            return kept[:count]
    raise DegenerateGeometry(
        f"of {_TRIES * count} poses within the spread only {len(kept)} see every point; make spread_mm or spread_deg "
        "smaller"
    )


def _sees_all(estimate: CameraEstimate, model: CameraModel, states: Array) -> Mask:
    return np.asarray(estimate.camera.sees(model.pixels(states)).all(axis=-1))


def _imaged(estimate: CameraEstimate, model: CameraModel, states: Array) -> Array:
    """Return the pixels (B, N, 2) of the points by the camera's matrix, which also images points behind it."""
    if estimate.camera.lens.parameters:
        return model.pixels(states)
    R = states[:, 3:12].reshape(-1, 3, 3)
    y = (model.p_world - states[:, None, :3]) @ np.swapaxes(R, 1, 2) @ estimate.camera.K.T
    return np.asarray(y[..., :2] / y[..., 2:])
