"""Where features must be visible and where they are measured: points, rim and centre of circles, edge stations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.geometry.plane import axes_across
from cadcam.plan.scene.feature import Kind, LayoutFeature

_RIM = 8  # places on a circle's rim that have to be visible
_STATIONS = 9  # on a straight edge
_MOST_STATIONS = 48  # on the edges of a selection


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The S places of F features in one list.

    Of each place: p (S, 3) mm; feature (S,): whose it is; sighted (S,): whether it has to be visible; on edges, tangent
    (S, 3), length (mm) of edge that it stands for and from_middle (mm), its place along the edge; elsewhere NaN, 0, 0.
    Of each feature: centre (F, 3); normal (F, 3; NaN: none) and axes (F, 3, 2) across it; diameter (F,; NaN: none);
    ends (F, 2, 3) of a straight edge, of others the centre twice.
    """

    p: Array
    feature: Longs
    sighted: Mask
    tangent: Array
    length: Array
    from_middle: Array
    centre: Array
    normal: Array
    axes: Array
    diameter: Array
    ends: Array
    is_straight: Mask
    is_edge: Mask
    is_circle: Mask

    @classmethod
    def facing(cls, p: Array, normal: Array) -> Places:
        """Return those of point features p (F, 3), seen from where their normals (F, 3) point."""
        n = len(p)
        every, never = np.ones(n, bool), np.zeros(n, bool)
        zero, unknown = np.zeros(n), np.full(n, np.nan)
        return cls(
            p=p,
            feature=np.arange(n),
            sighted=every,
            tangent=np.full((n, 3), np.nan),
            length=zero,
            from_middle=zero,
            centre=p,
            normal=normal,
            axes=np.stack(axes_across(normal), axis=2),
            diameter=unknown,
            ends=np.stack([p, p], axis=1),
            is_straight=never,
            is_edge=never,
            is_circle=never,
        )

    @classmethod
    def of(cls, features: Sequence[LayoutFeature]) -> Places:
        """Return those of some features."""
        of_each = [_places(f) for f in features]
        owner = np.repeat(np.arange(len(features)), [len(places.p) for places in of_each])
        p = np.concatenate([places.p for places in of_each])
        tangent = np.concatenate([places.tangents for places in of_each])
        centre = np.array([f.p for f in features])
        return cls(
            p=p,
            feature=owner,
            sighted=np.concatenate([places.sighted for places in of_each]),
            tangent=tangent,
            length=np.concatenate([places.lengths for places in of_each]),
            from_middle=np.einsum("ij,ij->i", p - centre[owner], np.nan_to_num(tangent)),
            centre=centre,
            normal=np.array([np.full(3, np.nan) if f.normal is None else f.normal for f in features]),
            axes=np.array([_axes(f) for f in features]),
            diameter=np.array([np.nan if f.diameter_mm is None else f.diameter_mm for f in features]),
            ends=np.array([f.ends for f in features]),
            is_straight=np.array([f.straight for f in features]),
            is_edge=np.array([f.kind is Kind.EDGE for f in features]),
            is_circle=np.array([f.kind is Kind.CIRCLE for f in features]),
        )


@dataclass(slots=True, eq=False)
class _FeaturePlaces:
    """p (n, 3); which must be visible; on edges the unit tangent, and the length, mm, that each stands for."""

    p: Array
    sighted: Mask
    tangent: Array | None = None
    length: Array | None = None

    @property
    def tangents(self) -> Array:
        """Return the unit tangents (n, 3); NaN where there are none."""
        return np.full((len(self.p), 3), np.nan) if self.tangent is None else self.tangent

    @property
    def lengths(self) -> Array:
        """Return the lengths (n,) mm; 0 where there are none."""
        return np.zeros(len(self.p)) if self.length is None else self.length


def _axes(feature: LayoutFeature) -> Array:
    """Return two axes (3, 2) across a feature's normal; zero where it has none."""
    return np.zeros((3, 2)) if feature.normal is None else np.stack(axes_across(feature.normal), axis=1)


def _places(feature: LayoutFeature) -> _FeaturePlaces:
    """Return where a feature is looked for and measured."""
    if feature.segments is not None:
        return _on_edges(feature)
    if feature.kind is Kind.CIRCLE:
        assert feature.normal is not None
        assert feature.diameter_mm is not None
        u, v = axes_across(feature.normal)
        t = 2 * np.pi * np.arange(_RIM) / _RIM
        rim = feature.p + feature.diameter_mm / 2 * (np.cos(t)[:, None] * u + np.sin(t)[:, None] * v)
        return _FeaturePlaces(np.concatenate([rim, feature.p[None]]), np.arange(_RIM + 1) < _RIM)
    return _FeaturePlaces(feature.p[None], np.ones(1, bool))


def _on_edges(feature: LayoutFeature) -> _FeaturePlaces:
    """Return stations along the segments, as many on each as its share of the length."""
    assert feature.segments is not None
    a, d = feature.segments[:, 0], feature.segments[:, 1] - feature.segments[:, 0]
    length = np.linalg.norm(d, axis=1)
    most = _STATIONS if len(a) == 1 else _MOST_STATIONS
    total = np.cumsum(length)
    at = (np.arange(most) + 0.5) / most * total[-1]
    segment = np.searchsorted(total, at, side="right").clip(max=len(a) - 1)
    fraction = (at - (total - length)[segment]) / length[segment]
    p = a[segment] + fraction[:, None] * d[segment]
    return _FeaturePlaces(p, np.ones(most, bool), d[segment] / length[segment, None], np.full(most, total[-1] / most))
