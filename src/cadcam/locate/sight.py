"""One photo with the part's samples in it: what the search and the measurement ask of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import Steps, blur_of, candidates, noise_of, steps
from cadcam.locate.edges import EdgeSamples, Projected, project, sample_lines
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.wireframe import LineOptions

_LINES = LineOptions(margin_px=0.0)
_STRONG = 100  # cells that tell the blur
_APART = 1.5  # blurs: a cell ends that far before the next line
_NEIGHBOURS = 2  # cells to each side that the contrast is averaged with


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A photo, its noise (sd of a pixel), and the samples of the part's lines visible from where it was drawn."""

    photo: Photo
    noise: float
    drawn: Rigid
    samples: EdgeSamples

    @classmethod
    def of(
        cls, part: Part, photo: Photo, world_from_part: Rigid, *, step_px: float, reach_px: float, noise: float = np.nan
    ) -> Sight:
        """Return the sight of the part at a pose; hidden lines are removed as seen from there."""
        camera_from_part = photo.viewpoint.camera_from_world @ world_from_part
        lines = part.lines.draw(photo.camera, camera_from_part, options=_LINES).visible
        samples = sample_lines(lines, photo.camera, step_px=step_px, reach_px=reach_px)
        return cls(photo, noise_of(photo.gray) if np.isnan(noise) else noise, world_from_part, samples)

    def project(self, world_from_part: Rigid) -> Projected:
        """Return the samples in the photo."""
        return project(self.samples, self.photo.camera, self.photo.viewpoint.camera_from_world @ world_from_part)

    def moved_px(self, world_from_part: Rigid) -> float:
        """Return how far the lines moved across themselves since they were drawn: the largest of nine tenths of them."""
        few = self.thinned(100)
        now, before = few.project(world_from_part), few.project(self.drawn)
        shift = np.abs(np.einsum("ij,ij->i", now.q - before.q, before.normal))
        return float(np.quantile(shift, 0.9)) if len(shift) else 0.0

    def thinned(self, most: int) -> Sight:
        """Return the sight with at most about `most` of its samples."""
        every = max(1, len(self.samples) // most)
        return Sight(self.photo, self.noise, self.drawn, self.samples.select(np.arange(0, len(self.samples), every)))

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
class Cells:
    """Which of a sight's samples have room for a cell, how far the cells reach, and the light they are seen in.

    which (N,): numbers of the samples; below, above (N,) px; half_length, blur (px). kink (N,): variance of a pixel over
    that of the change of slope at the step (`image.profile.steps`).
    """

    which: Array
    below: Array
    above: Array
    kink: Array
    half_length: float
    blur: float

    @classmethod
    def of(cls, sight: Sight, at: Projected, *, half_length: float, reach_px: float, room_px: float) -> Cells:
        """Return the cells of a sight; room_px is what a cell needs on each side of its line."""
        blur = sight.blur(at, half_length=half_length, reach_px=reach_px)
        below, above = (np.minimum(side - _APART * blur, reach_px) for side in (sight.samples.below, sight.samples.above))
        which = np.flatnonzero((below >= room_px) & (above >= room_px) & np.isfinite(at.q).all(axis=1))
        free = cls(which, below[which], above[which], np.zeros(len(which)), half_length, blur)
        found = free.steps(sight, at)
        kink = (found.noise / _spread(found)) ** 2
        return cls(which, free.below, free.above, np.where(np.isfinite(kink), kink, 0.0), half_length, blur)

    def steps(self, sight: Sight, at: Projected) -> Steps:
        """Return what the photo shows in the cells."""
        return steps(
            sight.photo.gray,
            at.q[self.which],
            at.normal[self.which],
            below=self.below,
            above=self.above,
            half_length=self.half_length,
            blur=self.blur,
            kink=self.kink,
            noise=0.5 * sight.noise,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Offsets (N,) px of the photo's steps from the model's lines, their sd by noise, contrast, and which are usable."""

    offset: Array
    sigma: Array
    contrast: Array
    usable: Mask


def measure(sight: Sight, at: Projected, cells: Cells, *, farthest: float) -> Measured:
    """Return the steps' offsets by the linear fit at the samples themselves.

    farthest: offsets beyond are not believed (the fit is linear in them).
    """
    n = len(sight.samples)
    offset, sigma, contrast = (np.full(n, np.nan) for _ in range(3))
    usable = np.zeros(n, bool)
    which = cells.which
    if not len(which):
        return Measured(offset, sigma, contrast, usable)
    found = cells.steps(sight, at)
    c, sd_c = _along_run(found.contrast, found.sd_contrast, sight.samples.run[which])
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
    begins = np.flatnonzero(np.diff(run, prepend=-1))
    length = np.diff(begins, append=n)
    first, last = np.repeat(begins, length), np.repeat(begins + length, length)
    i = np.arange(n)
    low, high = np.maximum(first, i - _NEIGHBOURS), np.minimum(last, i + _NEIGHBOURS + 1)
    count = np.maximum(one[high] - one[low], 1e-9)
    return (value[high] - value[low]) / count, np.sqrt(var[high] - var[low]) / count
