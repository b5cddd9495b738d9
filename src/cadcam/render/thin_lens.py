"""The pinhole at one point of a camera's aperture, through one point of its pixels: a photograph averages them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Floats
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal, Lens
from cadcam.camera.perspective import direction
from cadcam.geometry.rigid import Rigid
from cadcam.render.lens_tables import Around, plane_points


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """What pixels look at beside their centres: x/z, y/z in a plane (H, W, 2) of the centres' own, shifted in it.

    pixel (2,): px beside the centres; shift (2,): in the plane. Computed for the rows asked for, bit by bit as for all:
    of a large picture the slopes alone would take as much memory as all that is seen.
    """

    centres: Array
    pixel: Array
    shift: Array

    def points(self, rows: slice) -> Array:
        """Return the points (R, W, 2) of some rows."""
        top, end, _ = rows.indices(len(self.centres))
        above, below = max(top - 1, 0), min(end + 1, len(self.centres))  # the slopes of a row need its neighbours
        beside = Around(self.centres[above:below]).at(*self.pixel)
        return np.asarray(beside[top - above : end - above] - self.shift)


@dataclass(frozen=True, slots=True, eq=False)
class Pinhole:
    """A camera without an opening that stands at a point of another's; beside: where its pixels look."""

    camera: Camera
    camera_from_world: Rigid
    beside: Beside


class ThinLens:
    """A camera with an opening, or None for a pinhole: gives the pinholes that make it up."""

    def __init__(self, camera: Camera, aperture: Aperture | None) -> None:
        self._camera, self._aperture = camera, aperture
        self._plane = plane_points(camera)

    def pinhole(self, camera_from_world: Rigid, pixel: Array, opening: Array) -> Pinhole:
        """Return the pinhole at a point (2,) of the opening, a unit disc, looking through `pixel` beside the centres.

        Beside the centres a lens is extrapolated linearly: off by less than 1e-3 px, without a lens by nothing.
        """
        at, shift = self._at(opening), self._shift(opening)
        beside = Beside(self._plane, pixel, shift)
        pose = Rigid(translation=np.array([-at[0], -at[1], 0.0])) @ camera_from_world
        if isinstance(self._camera.lens, Ideal):
            K = self._camera.K.copy()
            K[:2, 2] += K[:2, :2] @ shift - pixel
            return Pinhole(Camera(self._camera.size, K), pose, beside)
        return Pinhole(Camera(self._camera.size, np.eye(3), _Known(self._camera, beside)), pose, beside)

    def _at(self, opening: Array) -> Array:
        return np.zeros(2) if self._aperture is None else opening * (self._aperture.diameter_mm / 2)

    def _shift(self, opening: Array) -> Array:
        """Return by how much x/z, y/z of what is in focus changes, seen from a point of the opening."""
        return np.zeros(2) if self._aperture is None else self._at(opening) / self._aperture.focus_mm


@dataclass(frozen=True, eq=False)
class _Known(Lens):
    """The lens of a pinhole, told in pixels: its camera's K is one. Known are the pixels' own points of the plane."""

    whole: Camera = field(repr=False)
    beside: Beside = field(repr=False)

    __eq__, __hash__ = object.__eq__, object.__hash__  # no two are alike: renderers keep tables by lens

    def __post_init__(self) -> None:
        pass

    @property
    def parameters(self) -> dict[str, float]:
        return {}

    @property
    def valid_radius(self) -> float:
        return self.whole.lens.valid_radius

    def project(self, p: Floats) -> Array:
        return np.asarray(self.whole.project(np.asarray(p) @ self._shear.T) - self.beside.pixel)

    def project_with_jacobians(self, p: Floats, terms: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        q, J = self.whole.project_with_jacobian(np.asarray(p) @ self._shear.T)
        return q - self.beside.pixel, J @ self._shear, np.zeros((*q.shape, 0))

    def unproject(self, m: Floats) -> Array:
        column, row = np.rint(np.moveaxis(np.asarray(m), -1, 0)).astype(np.int64)
        top = int(row.min(initial=len(self.beside.centres)))
        return direction(self.beside.points(slice(top, int(row.max(initial=top)) + 1))[row - top, column])

    @property
    def _shear(self) -> Array:
        (x, y) = self.beside.shift
        return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
