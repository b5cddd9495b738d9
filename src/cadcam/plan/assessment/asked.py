"""The limits of all features in one list, as quadratic forms of the features' covariance, over all poses.

A limit of a position is judged in the worst direction in which the feature can be displaced (not along a straight
edge; not along the normal of a known plane, where the height is given and not measured), or in the directions that it
names; a limit of an angle by the worst rotation of the edge. A displacement in a direction oblique to a straight edge
is judged by how far it moves the edge across itself. With U = k sigma, the test uncertainty ratio is limit/U.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.geometry.plane import axes_across
from cadcam.plan.scene.feature import LayoutFeature
from cadcam.verify.tolerances.tolerance import Limit, Quantity

_BLIND = 1e-6  # of unit displacements: moves an edge across itself by no more than rounding
_FREE = 1.0  # information along a straight edge, in units of a limit: arbitrary, as nothing is judged along it


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """L limits: feature of each (L,), the limits, and bases (L, 3, 3) whose columns span what is judged, else zero.

    turns (L,): whether the limit is one of the edge's slope. prior (L, 3, 3): what is known without a camera, 1/mm^2.
    along (L, 3): unit direction of a straight edge, in which no picture shows a displacement; zero for other features.
    relative (L,): the number, among those judged relative to a datum, of the feature; -1 of a place in the world.
    """

    feature: Longs
    limits: tuple[Limit, ...]
    basis: Array
    turns: Mask
    prior: Array
    along: Array
    relative: Longs

    @classmethod
    def of_positions(cls, n: int) -> Asked:
        """Return the position of each of n features, in its worst direction, with a nominal limit of 1 mm."""
        limits = (Limit(Quantity.POSITION, 1.0),) * n
        every, nothing = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3))
        world = np.full(n, -1, np.int64)
        return cls(np.arange(n), limits, every, np.zeros(n, bool), nothing, np.zeros((n, 3)), world)

    def __len__(self) -> int:
        return len(self.limits)

    @property
    def value(self) -> Array:
        """Return the limits (L,) in mm and rad."""
        return np.array([limit.value for limit in self.limits])

    @property
    def k(self) -> Array:
        """Return their coverage factors (L,)."""
        return np.array([limit.k for limit in self.limits])

    def scaled(self, information: Array) -> Array:
        """Return information (..., L, 3, 3) in units of each limit, prior knowledge added."""
        return np.asarray((information + self.known) * (self.value**2)[:, None, None])

    @property
    def known(self) -> Array:
        """Return the prior information (L, 3, 3), regularised along straight edges so that nothing is singular."""
        edges = self.along[:, :, None] * self.along[:, None, :]
        return np.asarray(self.prior + _FREE * edges / (self.value**2)[:, None, None])

    def worst(self, covariance: Array) -> tuple[Array, Array]:
        """Return the largest sigma (..., L) that is judged, mm or rad, and the w (..., L, 3) whose w . x has it.

        x: the displacement. NaN if there is none.
        """
        B = self.basis
        inner = np.swapaxes(B, -1, -2) @ covariance @ B
        known = np.asarray(np.isfinite(inner).all(axis=(-2, -1)))
        w, V = np.linalg.eigh(np.where(known[..., None, None], inner, 0.0))
        sigma = np.where(known, np.sqrt(np.maximum(w[..., -1], 0.0)), np.nan)
        return np.asarray(sigma), np.asarray((B @ V[..., -1:])[..., 0])


def asked_of(features: Sequence[LayoutFeature], plane_mm: Array, judged: Sequence[int] = ()) -> Asked:
    """Return the limits of some features; plane_mm (F,): sigma of the height of their known planes, NaN for none.

    judged: numbers of the features that are judged relative to a datum.
    """
    owner, limits, bases, turns, prior, along = [], [], [], [], [], []
    for i, feature in enumerate(features):
        for limit in feature.limits:
            owner.append(i)
            limits.append(limit)
            bases.append(_basis(feature, limit))
            turns.append(limit.quantity is Quantity.ANGLE)
            n = feature.normal
            height = np.isfinite(plane_mm[i]) and n is not None
            prior.append(np.outer(n, n) / plane_mm[i] ** 2 if height and n is not None else np.zeros((3, 3)))
            along.append(np.zeros(3) if feature.along is None else feature.along)
    relative = np.array([judged.index(i) if i in judged else -1 for i in owner], np.int64)
    of_each = np.array(turns, bool), np.array(prior), np.array(along), relative
    return Asked(np.array(owner), tuple(limits), np.array(bases), *of_each)


def _basis(feature: LayoutFeature, limit: Limit) -> Array:
    out = np.zeros((3, 3))
    if limit.basis is not None:
        across = limit.basis
        if feature.along is not None:
            across = across - np.outer(feature.along, feature.along @ across)
        # w with w . x = u for a displacement by u in these directions, as far as it shows
        out[:, : across.shape[1]] = np.linalg.pinv(across, rcond=_BLIND).T
        return out
    along = feature.along if feature.along is not None else feature.normal if feature.plane_mm is not None else None
    if along is None:
        return np.eye(3)
    out[:, 0], out[:, 1] = axes_across(along)
    return out
