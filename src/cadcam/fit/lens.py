"""A camera with one lens approximated by another: the nearest coefficients and intrinsics of a given model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.difference import picture_grid
from cadcam.camera.lens import LENSES, Lens
from cadcam.errors import BadValue
from cadcam.fit.least_squares import minimise


@dataclass(frozen=True, slots=True, eq=False)
class Refit:
    """A camera with another lens, and its difference from the original: largest and rms distance in px."""

    camera: Camera
    max_px: float
    rms_px: float


def refitted(camera: Camera, model: str, terms: Sequence[str]) -> Refit:
    """Return the camera with lens `model`, of which only `terms` are free, that is nearest to the given one.

    Least squares of pixel distances over 21 x 15 pixels of the picture, in fx, fy, cx, cy and the terms; skew is kept.
    Raises `NotConverged` where the model cannot image the picture at all.
    """
    q = picture_grid(camera.size, 21, 15).reshape(-1, 2)
    directions = camera.unproject(q)
    seen = ~np.isnan(directions).any(axis=1)
    problem = _Problem(camera, LENSES[model], tuple(terms), directions[seen], q[seen])
    found = minimise(problem, problem.start())
    distance = np.linalg.norm(found.residuals.reshape(-1, 2), axis=1)
    return Refit(problem.camera(found.state), float(distance.max()), float(np.sqrt(np.mean(distance**2))))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    given: Camera
    model: type[Lens]
    terms: tuple[str, ...]
    directions: Array
    q: Array

    def camera(self, x: Array) -> Camera:
        fx, fy, cx, cy, *coefficients = x.tolist()
        K = np.array([[fx, self.given.skew, cx], [0, fy, cy], [0, 0, 1.0]])
        return replace(self.given, K=K, lens=self.model(**dict(zip(self.terms, coefficients, strict=True))))

    def start(self) -> Array:
        c = self.given
        first = {**self.model().parameters, **self.model.start}
        return np.array([c.fx, c.fy, *c.principal_point, *(first[term] for term in self.terms)])

    def residuals_and_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return the distances (2 N,) px in x and y and their Jacobian; not finite where the state is not a camera."""
        try:
            camera = self.camera(state)
        except BadValue:
            return np.full(1, np.inf), np.zeros((1, state.size))
        m, _, by_coefficient = camera.lens.project_with_jacobians(self.directions)
        columns = [list(camera.lens.parameters).index(term) for term in self.terms]
        J = np.zeros((len(m), 2, state.size))
        J[:, 0, 0], J[:, 1, 1], J[:, 0, 2], J[:, 1, 3] = m[:, 0], m[:, 1], 1.0, 1.0
        J[:, :, 4:] = camera.K[:2, :2] @ by_coefficient[:, :, columns]
        return (camera.pixel_of(m) - self.q).ravel(), J.reshape(-1, state.size)

    def retract(self, state: Array, step: Array) -> Array:
        """Return the state moved."""
        return state + step
