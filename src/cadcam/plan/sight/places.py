"""Where features are looked for and measured: a point itself, a circle's rim and centre, stations along edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.geometry.plane import axes_across
from cadcam.plan.scene.feature import Kind, LayoutFeature

_RIM = 8  # places on a circle's rim that have to be seen
_STATIONS = 9  # on a straight edge
_MOST_STATIONS = 48  # on the edges of a selection


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The places of F features in one list: p (S, 3) mm, whose (S,), sighted and measured (S,), tangents and lengths.

    tangent (S, 3) is NaN, length and from_middle (S,) mm are 0 but on edges. centre, normal (F, 3; NaN for none), axes
    (F, 3, 2) across it, diameter (F,; NaN), ends (F, 2, 3) of straight edges (of all else the centre twice).
    """

    p: Array
    feature: Longs
    sighted: Mask
    measured: Mask
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
        axes = np.stack(axes_across(normal), axis=2)
        return cls(
            p, np.arange(n), every, every, np.full((n, 3), np.nan), zero, zero, p, normal, axes, unknown,
            np.stack([p, p], axis=1), never, never, never,
        )  # fmt: skip

    @classmethod
    def of(cls, features: Sequence[LayoutFeature]) -> Places:
        """Return those of some features."""
        each = [_places(f) for f in features]
        counts = [len(e.p) for e in each]
        tangent = [
            np.full((n, 3), np.nan) if e.tangent is None else e.tangent for e, n in zip(each, counts, strict=True)
        ]
        length = [np.zeros(n) if e.length is None else e.length for e, n in zip(each, counts, strict=True)]
        p = np.concatenate([e.p for e in each])
        owner = np.repeat(np.arange(len(features)), counts)
        centre = np.array([f.p for f in features])
        along = np.nan_to_num(np.concatenate(tangent))
        none = np.zeros((3, 2))
        axes = [none if f.normal is None else np.stack(axes_across(f.normal), axis=1) for f in features]
        return cls(
            p,
            owner,
            np.concatenate([e.sighted for e in each]),
            np.concatenate([e.measured for e in each]),
            np.concatenate(tangent),
            np.concatenate(length),
            np.einsum("ij,ij->i", p - centre[owner], along),
            centre,
            np.array([np.full(3, np.nan) if f.normal is None else f.normal for f in features]),
            np.array(axes),
            np.array([np.nan if f.diameter_mm is None else f.diameter_mm for f in features]),
            np.array([f.ends for f in features]),
            np.array([f.straight for f in features]),
            np.array([f.kind is Kind.EDGE for f in features]),
            np.array([f.kind is Kind.CIRCLE for f in features]),
        )


@dataclass(slots=True, eq=False)
class _FeaturePlaces:
    """p (n, 3); which have to be seen, which are measured; of edges unit tangent, length and place along them, mm."""

    p: Array
    sighted: Mask
    measured: Mask
    tangent: Array | None = None
    length: Array | None = None


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
        return _FeaturePlaces(
            np.concatenate([rim, feature.p[None]]), np.arange(_RIM + 1) < _RIM, np.arange(_RIM + 1) == _RIM
        )
    one = np.ones(1, bool)
    return _FeaturePlaces(feature.p[None], one, one)


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
    every = np.ones(most, bool)
    return _FeaturePlaces(p, every, every, d[segment] / length[segment, None], np.full(most, total[-1] / most))
