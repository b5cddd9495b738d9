"""The evidence of colour for a pose: whether the sides of the part's lines differ as part and surroundings do.

A part of one material has its colour on the inner side of its outline and on both sides of its other edges; beyond the
outline lies something else. Which colours these are is estimated from the photo itself: the colours beside all other
lines tell whether a side of this line is more likely part or surroundings. That is the posterior of two kernel
densities, as region-based trackers use histograms (V. Prisacariu and I. Reid, PWP3D, IJCV 98, 2012), but each line is
judged without its own colours, so that a pose cannot be made right by what it happens to cover. On a black and white
background full of lines, a coloured part stands out. Where the part is as grey as its surroundings, colour is no
evidence, neither for a pose nor against it.

An occluder in front of the part has the same colour on both sides of a line, and one that is neither the part's nor
that of its surroundings. Samples with such a colour, on one side of a straight border, are hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.quality.absent import behind_border
from cadcam.locate.quality.worth import distinct_lines
from cadcam.native.profiles import values_at

_BESIDE = np.array([2.0, 3.0, 4.0])  # px from a line where colours are taken: codecs blur this far
_ROOM_PX, _CLEAR_PX = 2.5, 1.5  # room that a side needs; distance kept from the next line
_ASKED, _TOGETHER = 400, 4  # samples tested, in all photos together, in groups of neighbours
_KNOWN = 100  # samples from which the two densities are estimated
_WIDTH = 15 / 255  # of the kernel: the variation of colour over one surface
_UNSEEN = 0.02  # density of colours that occur nowhere else
_SURE = 0.7  # posterior from which a side counts as part or as surroundings
_UNLIKE = 0.25  # density relative to the usual one among the part's colours below which a colour is not the part's
_BLENDED = 2  # samples next to a hidden one whose colour is a mixture
_OTHER = 3.0  # kernel widths by which an occluder's colour differs from all known ones
_MOST_HIDDEN = 0.5  # largest share of samples that may be hidden


@dataclass(frozen=True, slots=True, eq=False)
class ByColor:
    """The evidence of colour for a sight's samples: which are hidden (N,), and the share of the rest that it supports.

    share: samples with the right colour on both sides, less those with a wrong one; 0 where colour is no evidence.
    """

    share: float
    hidden: Mask


def by_color(part: Part, sight: Sight, world_from_part: Rigid) -> ByColor:
    """Return the evidence of the photo's colours for a pose."""
    chroma, n = sight.photo.chroma, len(sight.samples)
    if chroma is None or not n:
        return ByColor(0.0, np.zeros(n, bool))
    at, samples = sight.project(world_from_part), sight.samples
    room = np.stack([samples.below, samples.above], axis=1)
    far = np.minimum(_BESIDE, np.maximum(room[:, :, None] - _CLEAR_PX, 0.5))  # (n, 2, 3)
    aside = far * np.array([-1.0, 1.0])[:, None]
    q = at.q[:, None, None] + aside[..., None] * at.normal[:, None, None]
    colors = values_at(chroma, q).mean(axis=2)
    inside = _covered(part, sight, world_from_part, q[:, :, 1])
    told = ((room >= _ROOM_PX) & np.isfinite(colors).all(axis=2)).all(axis=1) & inside.any(axis=1)
    line, _ = distinct_lines(at.q, samples.arc)
    right, wrong = _judged(colors, inside, told, line)
    hidden = _blended(_hidden(at.q, colors, right), right, samples.run)
    left = ~hidden
    return ByColor(max(float(right.sum()) - float((wrong & left).sum()), 0.0) / max(int(left.sum()), 1), hidden)


def in_color(part: Part, sights: Sequence[Sight], world_from_part: Rigid) -> tuple[list[Sight], float]:
    """Return sights without the samples that colour shows to be hidden, and the share of the rest that it supports.

    Sights of colour photos come back with a subset of their samples, those of grey photos unchanged.
    """
    seen, share, told = [], 0.0, 0
    for sight in sights:
        few = sight if sight.photo.chroma is None else sight.thinned(max(_ASKED // len(sights), 60), together=_TOGETHER)
        found = by_color(part, few, world_from_part)
        seen.append(few.select(~found.hidden) if found.hidden.any() else few)
        share += found.share * len(seen[-1].samples)
        told += len(seen[-1].samples)
    return seen, share / max(told, 1)


def _covered(part: Part, sight: Sight, world_from_part: Rigid, q: Array) -> Mask:
    """Return at which places q (..., 2) px of the photo the part would be visible."""
    camera_from_part = sight.photo.camera_from_world @ world_from_part
    caster, eye = part.caster, camera_from_part.origin
    ray = sight.photo.camera.unproject(q.reshape(-1, 2)) @ camera_from_part.rotation
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    away = float(np.linalg.norm(eye - caster.center))
    start = eye + max(away - 2 * caster.radius, 0.0) * ray
    return (caster.first_hit(start, ray, np.full(len(ray), away + 4 * caster.radius)) >= 0).reshape(q.shape[:-1])


def _judged(colors: Array, inside: Mask, told: Mask, line: Longs) -> tuple[Mask, Mask]:
    """Return which samples (n,) have the right colour on both sides (n, 2), and which have a wrong one on either."""
    value, own, part = np.nan_to_num(colors.reshape(-1, 2)), np.repeat(line, 2), inside.ravel()
    known = np.flatnonzero(np.repeat(told & _some(len(told)), 2))
    apart = ((value[:, None] - value[known]) ** 2).sum(axis=2)
    near, other = np.exp(-0.5 * apart / _WIDTH**2), own[:, None] != own[known]
    of_part, around = (_mean(near, other & side[known]) for side in (part, ~part))
    likely = ((of_part + _UNSEEN) / (of_part + around + 2 * _UNSEEN)).reshape(-1, 2)
    usual = float(np.median(of_part[known][part[known]])) if part[known].any() else 0.0
    unlike = (of_part < _UNLIKE * usual).reshape(-1, 2)  # the surroundings may have any colour, but the part not
    good = np.where(inside, likely > _SURE, (likely < 1 - _SURE) | unlike)
    bad = np.where(inside, likely < 1 - _SURE, likely > _SURE)
    return told & good.all(axis=1), told & bad.any(axis=1)


def _some(n: int) -> Mask:
    """Return which of n samples, about _KNOWN of them evenly, are used to estimate the two densities."""
    return np.asarray(np.arange(n) % max(1, n // _KNOWN) == 0)


def _mean(values: Array, which: Mask) -> Array:
    """Return the means (n,) over the selected columns of values (n, m); 0 where none is selected."""
    return np.asarray((values * which).sum(axis=1) / np.maximum(which.sum(axis=1), 1))


def _hidden(q: Array, colors: Array, right: Mask) -> Mask:
    """Return which samples (n,) at q (n, 2) px are behind something whose colour differs from all known ones."""
    if not right.any():
        return np.zeros(len(q), bool)
    known, middle = colors[right][_some(int(right.sum()))].reshape(-1, 2), colors.mean(axis=1)
    new = np.linalg.norm(middle[:, None] - known, axis=2).min(axis=1) > _OTHER * _WIDTH
    same = np.linalg.norm(colors[:, 0] - colors[:, 1], axis=1) < _OTHER * _WIDTH
    hidden = new & same & behind_border(q, right)
    return hidden if hidden.mean() <= _MOST_HIDDEN else np.zeros(len(q), bool)


def _blended(hidden: Mask, right: Mask, run: Ids) -> Mask:
    """Return the hidden samples (n,) and those next to them on their run that are not of the right colour."""
    out = hidden.copy()
    for k in range(1, _BLENDED + 1):
        same = run[k:] == run[:-k]
        out[k:] |= hidden[:-k] & same
        out[:-k] |= hidden[k:] & same
    return hidden | (out & ~right)
