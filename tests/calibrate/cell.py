"""A measuring cell for tests: four cameras around a bench of targets, calibrated again and again with fresh noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS, NAMES
from cadcam.camera.lens import BrownConrady, Division, Ideal, Lens
from cadcam.camera.observations import Observations
from cadcam.fit.camera_model import CameraModel
from cadcam.fit.least_squares import cofactor, minimise
from cadcam.geometry.rigid import Rigid

SIGMA = 0.2
SIZE = (1280, 960)
POINT = np.array([35.0, -20.0, 60.0])
BENCH = np.array([[x, y, z] for z in (0.0, 150.0) for x in (-150.0, -50.0, 50.0, 150.0) for y in (-120.0, 0.0, 120.0)])

FEW = [0, 2, 7, 9, 12, 14, 19, 23]  # eight of the bench: 5 degrees of freedom are left


@dataclass(frozen=True)
class Eye:
    """A camera of the cell as it truly is, and which of its numbers a calibration looks for."""

    camera: Camera
    pose: Rigid
    free: tuple[str, ...]

    def calibrated(self, rng: np.random.Generator, *, stated: bool = True, targets: Array = BENCH) -> CameraEstimate:
        """Return a calibration from noisy pixels of the targets, by descent from the truth."""
        return self._estimated(rng, self.camera, self.pose, self.free, stated, targets)

    def located(self, rng: np.random.Generator, camera: Camera, pose: Rigid, targets: Array) -> CameraEstimate:
        """Return the pose found with the internals of `camera` from noisy pixels that this one sees at `pose`."""
        return self._estimated(rng, camera, pose, EXTERNALS, True, targets)

    def _estimated(
        self, rng: np.random.Generator, start: Camera, pose: Rigid, free: tuple[str, ...], stated: bool, p: Array
    ) -> CameraEstimate:
        q = self.see(rng, p, pose)
        model = CameraModel(p, q, free, start.lens)
        found = minimise(model, model.state_of(start, pose))
        names = (*NAMES, *start.lens.parameters)
        place = np.zeros((len(names), len(free)))
        place[[names.index(n) for n in free], np.arange(len(free))] = 1.0
        observations = Observations(p, q, sigma_px=SIGMA if stated else None)
        camera = start if free == EXTERNALS else model.camera(found.state, SIZE)
        covariance = place @ cofactor(found.jacobian, free) @ place.T
        return CameraEstimate(camera, model.pose(found.state), observations, free, covariance)

    def see(self, rng: np.random.Generator, p: Array, pose: Rigid | None = None) -> Array:
        """Return noisy pixels of points (N, 3)."""
        q = self.camera.project((self.pose if pose is None else pose) @ p)
        return q + SIGMA * rng.normal(size=q.shape)


def eye(place: tuple[float, float, float], focal: float, lens: Lens | None = None, terms: tuple[str, ...] = ()) -> Eye:
    """Return a camera at `place` looking at the bench."""
    camera = Camera.from_focal(SIZE, focal, fy=0.99 * focal, skew=0.5, lens=Ideal() if lens is None else lens)
    pose = Rigid.look_at(place, [0.0, 0.0, 70.0], up=(0.1, 0.2, 1.0))
    return Eye(camera, pose, (*NAMES, *terms))


EYES = (
    eye((-500.0, -500.0, 700.0), 1500.0),
    eye((600.0, -300.0, 600.0), 1400.0, BrownConrady(k1=-0.15, k2=0.05), ("k1",)),
    eye((300.0, 700.0, 500.0), 1700.0, Division(k=-0.1), ("k",)),
    eye((-700.0, 300.0, 400.0), 1600.0),
)
