"""One photo with the part's samples in it: what the search and the measurement ask of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import Candidates, Steps, blur_of, candidates, noise_of, steps
from cadcam.locate.edges import EdgeSamples, Projected, project, sample_lines
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.wireframe import LineOptions

_LINES = LineOptions(margin_px=0.0)
_STRONG = 150  # cells that tell the blur
_APART = 1.5  # blurs: a cell ends that far before the next line
_NEIGHBOURS = 2  # cells to each side that the contrast is averaged with


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A photo, the samples of the part's visible lines there, and the photo's noise (sd of a pixel)."""

    photo: Photo
    samples: EdgeSamples
    noise: float

    @classmethod
    def of(
        cls,
        part: Part,
        photo: Photo,
        world_from_part: Rigid,
        *,
        step_px: float,
        reach_px: float,
        noise: float | None = None,
    ) -> Sight:
        """Return the sight of the part at a pose; hidden lines are removed as seen from there."""
        camera_from_part = photo.viewpoint.camera_from_world @ world_from_part
        lines = part.lines.draw(photo.camera, camera_from_part, options=_LINES).visible
        samples = sample_lines(lines, photo.camera, step_px=step_px, reach_px=reach_px)
        return cls(photo, samples, noise_of(photo.gray) if noise is None else noise)

    def project(self, world_from_part: Rigid) -> Projected:
        """Return the samples in the photo."""
        return project(self.samples, self.photo.camera, self.photo.viewpoint.camera_from_world @ world_from_part)

    def candidates(self, at: Projected, *, reach: int, half_length: float) -> Candidates:
        """Return the slopes along the samples' normals."""
        return candidates(
            self.photo.gray, at.q, at.normal, half_length=half_length, reach=reach, noise=self.noise
        )

    def blur(self, at: Projected, *, half_length: float, reach_px: float) -> float:
        """Return the blur of the photo's steps (px), from the strongest of the part's lines."""
        free = np.flatnonzero(np.minimum(self.samples.below, self.samples.above) >= reach_px)
        found = candidates(
            self.photo.gray, at.q[free], at.normal[free], half_length=half_length, reach=2, noise=self.noise, most=1
        )
        strength = np.nan_to_num(np.abs(found.slope[:, 0]))
        best = np.argsort(-strength)[:_STRONG]
        best = best[strength[best] > 0]
        q = at.q[free[best]] + found.offset[best] * at.normal[free[best]]
        reach = np.full(len(best), reach_px - 1.0)
        return blur_of(self.photo.gray, q, at.normal[free[best]], reach=reach, half_length=half_length)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Offsets (N,) px of the photo's steps from the model's lines, their sd by noise, and which are usable."""

    offset: Array
    sigma: Array
    contrast: Array
    usable: Mask


def measure(
    sight: Sight, at: Projected, *, half_length: float, reach_px: float, room_px: float, blur: float, farthest: float
) -> Measured:
    """Return the steps' offsets by the linear fit at the samples themselves.

    room_px: how much free space a cell needs on each side; farthest: offsets beyond are not believed (the fit is linear
    in them).
    """
    s = sight.samples
    below = np.minimum(s.below - _APART * blur, reach_px)
    above = np.minimum(s.above - _APART * blur, reach_px)
    roomy = (below >= room_px) & (above >= room_px) & np.isfinite(at.q).all(axis=1)
    offset, sigma, contrast = (np.full(len(s), np.nan) for _ in range(3))
    usable = np.zeros(len(s), bool)
    which = np.flatnonzero(roomy)
    if not len(which):
        return Measured(offset, sigma, contrast, usable)
    cell = (at.q[which], at.normal[which])
    room = {"below": below[which], "above": above[which], "half_length": half_length, "blur": blur}
    found = steps(sight.photo.gray, *cell, **room, kink=np.zeros(len(which)), noise=0.5 * sight.noise)
    bend = _spread(found)
    found = steps(sight.photo.gray, *cell, **room, kink=(found.noise / bend) ** 2, noise=0.5 * sight.noise)
    c, sd_c = _along_run(found.contrast, found.sd_contrast, s.run[which])
    with np.errstate(all="ignore"):
        offset[which], sigma[which] = -found.moment / c, found.sd_moment / np.abs(c)
        usable[which] = (np.abs(c) > 5 * sd_c) & (np.abs(offset[which]) < farthest) & (found.clipped < 0.7)
    contrast[which] = c
    return Measured(offset, sigma, contrast, usable)


def _spread(found: Steps) -> float:
    """Return the sd of the bends in the photo beyond what noise makes of them."""
    seen = np.isfinite(found.bend)
    if not seen.any():
        return 1e-6
    beyond = float(np.median(found.bend[seen] ** 2)) / 0.455 - float(np.median(found.sd_bend[seen] ** 2))
    return float(np.sqrt(max(beyond, 1e-12)))


def _along_run(c: Array, sd: Array, run: Array) -> tuple[Array, Array]:
    """Return the contrast averaged with that of neighbours on the same run, and its sd."""
    n = len(c)
    value, var, one = (np.concatenate([[0.0], np.cumsum(np.nan_to_num(v))]) for v in (c, sd**2, np.isfinite(c)))
    first = np.searchsorted(run, run, side="left")
    last = np.searchsorted(run, run, side="right")
    i = np.arange(n)
    low, high = np.maximum(first, i - _NEIGHBOURS), np.minimum(last, i + _NEIGHBOURS + 1)
    count = np.maximum(one[high] - one[low], 1e-9)
    return (value[high] - value[low]) / count, np.sqrt(var[high] - var[low]) / count
