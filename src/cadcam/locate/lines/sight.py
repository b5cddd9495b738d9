"""One photo with the samples of the part's visible lines, and the brightness steps along their normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask, quantile
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import BRIGHT, StepCandidates, blur_matrix, noise_of, step_candidates
from cadcam.locate.lines.edges import EdgeSamples, Projected, project, sample_lines
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.native.profiles import values_at
from cadcam.render.lines.wireframe import LineOptions

_LINES = LineOptions(margin_px=0.0)
_STRONG = 240  # cells from which the blur is estimated
_TELLING, _ENOUGH = 3.0, 12  # blurs that a cell must reach to be evidence of its blur; wide cells that suffice
_BESIDE_PX = 2.0  # from a step, where its sides are asked whether they are white
_TOUCHING = 1e-3  # radii: what lies this near before a line touches it rather than hiding it
_FAINT = 0.4  # share of the strongest slope nearby below which a step is no edge


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A photo, its noise (sd of a pixel), and the samples of the part's lines visible from the pose `drawn`."""

    photo: Photo
    noise: float
    drawn: Rigid
    samples: EdgeSamples

    @classmethod
    def of(
        cls, part: Part, photo: Photo, world_from_part: Rigid, *, step_px: float, reach_px: float, noise: float = np.nan
    ) -> Sight:
        """Return the sight of the part at a pose, with lines that are hidden there removed."""
        camera_from_part = photo.camera_from_world @ world_from_part
        lines = part.lines.draw(photo.camera, camera_from_part, options=_LINES).visible
        samples = sample_lines(lines, photo.camera, step_px=step_px, reach_px=reach_px, bulges=part.lines.bulges)
        return cls(photo, noise_of(photo.gray) if np.isnan(noise) else noise, world_from_part, samples)

    def project(self, world_from_part: Rigid) -> Projected:
        """Return the samples in the photo."""
        return project(self.samples, self.photo.camera, self.photo.camera_from_world @ world_from_part)

    def towards(self, point: Array, world_from_part: Rigid) -> Array:
        """Return the vector (3,) mm from the camera to a point (3,) of the part at a pose, in the part's frame."""
        return point - (self.photo.camera_from_world @ world_from_part).origin

    def moved_px(self, one: Rigid, other: Rigid) -> float:
        """Return how far (px) the lines move between two poses: the 90th percentile over the samples."""
        few = self.select(slice(None, None, max(1, len(self.samples) // 60)))
        apart = np.hypot(*(few.project(one).q - few.project(other).q).T)
        apart = apart[np.isfinite(apart)]
        return quantile(apart, 0.9) if len(apart) else 0.0

    def thinned(self, most: int, *, together: int = 1, among: Mask | None = None) -> Sight:
        """Return the sight with about `most` of its samples, or of `among`, in groups of `together` neighbours."""
        some = np.arange(len(self.samples)) if among is None else np.flatnonzero(among)
        n = len(some)
        return self.select(some[np.arange(n) // together % max(1, round(n / most)) == 0])

    def select(self, which: Mask | Longs | slice) -> Sight:
        """Return the sight with the chosen samples."""
        return Sight(self.photo, self.noise, self.drawn, self.samples.select(which))

    def unoccluded(self, part: Part, others: Sequence[Rigid]) -> Sight:
        """Return the sight without the samples that other instances of the part, at these world_from_part, hide."""
        hidden = np.zeros(len(self.samples), bool)
        for other in others:
            p = other.inv @ self.drawn @ self.samples.p
            away = (self.photo.camera_from_world @ other).origin - p
            reach = np.linalg.norm(away, axis=1)
            sight = away / reach[:, None]
            slack = _TOUCHING * part.caster.radius
            hidden |= part.caster.first_hit(p + slack * sight, sight, reach - slack) >= 0
        return self.select(~hidden) if hidden.any() else self

    def candidates(
        self, q: Array, normal: Array, *, half_length: float, reach: int, most: int = 4, clear: float = 4.0
    ) -> StepCandidates:
        """Return where the photo steps along normals (N, 2) at places q (N, 2) px (`image.profile.step_candidates`)."""
        return step_candidates(
            self.photo.lines,
            q,
            normal,
            half_length=half_length,
            reach=reach,
            noise=self.noise,
            most=most,
            spread=self.photo.spread,
            clear=clear,
        )

    def blur(self, at: Projected, *, half_length: float, reach_px: float) -> Array:
        """Return the blur of the photo's steps (2, 2) px^2 (`image.profile.blur_matrix`), from the strongest lines.

        A cell not much wider than a step shows only a slope, which any larger blur fits as well: where the blur seems
        large, wider cells are tried, if there is room for them.
        """
        blur, _ = self._blur(at, half_length, reach_px)
        if np.linalg.eigvalsh(blur)[-1] <= (reach_px / _TELLING) ** 2:
            return blur
        wide, cells = self._blur(at, half_length, 2 * reach_px)
        return wide if cells >= _ENOUGH else blur

    def _blur(self, at: Projected, half_length: float, reach_px: float) -> tuple[Array, int]:
        """Return the blur, and the number of cells of that reach from which it was estimated."""
        free = np.flatnonzero(np.minimum(self.samples.below, self.samples.above) >= reach_px)
        found = self.candidates(at.q[free], at.normal[free], half_length=half_length, reach=2, most=1)
        strength = np.nan_to_num(np.abs(found.slope[:, 0]))
        below_white = strength * ~self._up_to_white(at.q[free], at.normal[free], found)
        if np.count_nonzero(below_white) >= _ENOUGH:
            strength = below_white
        best = np.argsort(-strength)[:_STRONG]
        best = best[strength[best] > 0]
        q = at.q[free[best]] + found.offset[best] * at.normal[free[best]]
        reach = np.full(len(best), reach_px - 1.0)
        return blur_matrix(self.photo.gray, q, at.normal[free[best]], reach=reach, half_length=half_length), len(best)

    def white_beside(self, at: Projected) -> Mask:
        """Return beside which samples (N,) the photo is white."""
        sides = at.q + np.array([-_BESIDE_PX, _BESIDE_PX])[:, None, None] * at.normal
        return np.asarray((values_at(self.photo.gray[..., None], sides)[..., 0] >= BRIGHT).any(axis=0))

    def _up_to_white(self, q: Array, normal: Array, found: StepCandidates) -> Mask:
        """Return whether the strongest step near each place (N,) ends in white: cut off, it looks too sharp."""
        beyond = found.offset[:, 0] + _BESIDE_PX * np.sign(found.slope[:, 0])
        bright = values_at(self.photo.gray[..., None], q + np.nan_to_num(beyond)[:, None] * normal)[:, 0]
        return np.asarray(bright >= BRIGHT)


def in_noise(sights: Sequence[Sight]) -> bool:
    """Return whether lines are searched for in smoothed photos, because noise hides them in the originals."""
    return any(s.photo.calm is not None for s in sights)


def nearest_steps(sight: Sight, at: Projected, *, half_length: float, reach: int) -> Array:
    """Return the offset (N,) px along each normal of the photo's step nearest to the line; 0 where there is none."""
    found = sight.candidates(at.q, at.normal, half_length=half_length, reach=reach, most=3)
    strong = np.abs(found.slope) > _FAINT * np.abs(found.slope[:, :1])
    far = np.where(strong, np.abs(found.offset), np.inf)
    best = np.argmin(far, axis=1)
    return np.asarray(np.nan_to_num(found.offset[np.arange(len(best)), best]))
