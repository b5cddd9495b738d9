"""Points in space from pixels of calibrated cameras, with all their uncertainty (thesis, section 2.3).

Fixed cameras, a camera that moves by a known motion, points on known planes: `cadcam.camera.viewpoint` describes the
poses of the cameras and their uncertainty, `cadcam.calibrate.measure.intersect` holds the formulas.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from cadcam.arrays import Array, Floats, Longs, Mask, frozen
from cadcam.calibrate.measure.intersect import (
    MeetingPoints,
    Reason,
    SharedView,
    Surface,
    solve,
    startless,
    widest,
)
from cadcam.calibrate.measure.suspects import refuse_if_explained
from cadcam.camera.error_source import ErrorSource, distinct_sources, index_of
from cadcam.camera.measurement import Measurement, PixelNoise
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.plane import Plane
from cadcam.kinds import expect, expect_each, expect_known

Method = Literal["reprojection", "rays"]
METHODS: tuple[Method, ...] = get_args(Method)
_WORDS = {"reprojection": "least weighted reprojection error", "rays": "nearest point to all rays"}


def measure_points(
    viewpoints: Sequence[Viewpoint],
    q: Floats,
    *,
    names: Sequence[str] = (),
    plane: Plane | None = None,
    plane_sigma_mm: float = 0.0,
    method: Method = "reprojection",
) -> Measurement:
    """Return the points seen at pixels q (V, N, 2) from V viewpoints, NaN where a point was not seen; mm.

    From at least two viewpoints, or one for points on a known plane (plane_sigma_mm: standard deviation of its height).
    "reprojection": the points whose images are nearest to the measured pixels, each pixel weighted by its noise and by
    the uncertainty of calibration and motion; "rays": the points nearest to all rays, for two rays the middle of their
    shortest connection (EQ 2.165). A point that cannot be measured is refused individually, with its reason: too few
    views, behind a camera, rays so nearly parallel that its distance is unknown.

    Raises `BadValue`; `DegenerateGeometry` if no point can be measured; `InconsistentViews` if the rays miss each other
    and a swapped, mirrored, inverted or wrongly scaled input explains it.
    """
    viewpoints = expect_each(viewpoints, "viewpoints", Viewpoint)
    expect(plane, "plane", Plane, optional=True)
    if plane is not None and not plane.single:
        raise BadValue("plane", repr(plane), "one plane for all points")
    job = _job(
        viewpoints,
        q,
        expect_each(list(names) if isinstance(names, str) else names, "names", str),
        plane,
        plane_sigma_mm,
        method,
    )
    measured = job.run()
    refuse_if_explained(measured, job.viewpoints, job.q, plane, job.again)
    if not len(measured):
        name, reason = next(iter(measured.refused.items()))
        raise DegenerateGeometry(f"none of {len(job.names)} points can be measured; point {name!r}: {reason}")
    return measured


def _job(
    viewpoints: Sequence[Viewpoint],
    q: Floats,
    names: tuple[str, ...],
    plane: Plane | None,
    plane_sigma_mm: float,
    method: Method,
) -> _Job:
    expect_known(method, "measuring method", METHODS)
    if method == "rays" and plane is not None:
        raise BadValue("method", "'rays' for points on a plane", "'reprojection'")
    pixels = frozen(q, "pixels (viewpoints, points, 2)", (None, None, 2), finite=False)
    names = names or tuple(str(i + 1) for i in range(pixels.shape[1]))
    if (len(viewpoints), len(names)) != pixels.shape[:2]:
        raise BadValue("pixels", f"of shape {pixels.shape}", f"({len(viewpoints)} viewpoints, {len(names)} points, 2)")
    _refuse_half_seen(viewpoints, pixels, names)
    for what, given in (("viewpoint names", [v.name for v in viewpoints]), ("point names", names)):
        if len(set(given)) != len(given) or not given:
            raise BadValue(what, ", ".join(given) or "none", "at least one, each name once")
    return _Job(tuple(viewpoints), pixels, names, None if plane is None else Surface(plane, plane_sigma_mm), method)


def _refuse_half_seen(viewpoints: Sequence[Viewpoint], pixels: Array, names: Sequence[str]) -> None:
    half = np.isfinite(pixels).any(axis=-1) & ~np.isfinite(pixels).all(axis=-1) | np.isinf(pixels).any(axis=-1)
    if half.any():
        v, i = (int(k) for k in np.argwhere(half)[0])
        where = f"pixel (column, row) of point {names[i]!r} from {viewpoints[v].name!r}"
        raise BadValue(where, pixels[v, i].tolist(), "two finite numbers, or NaN for both where it was not seen")


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    viewpoints: tuple[Viewpoint, ...]
    q: Array
    names: tuple[str, ...]
    surface: Surface | None
    method: Method

    def again(self, viewpoints: Sequence[Viewpoint], q: Array, plane: Plane | None) -> Measurement:
        """Return the job for the same pixels with an input replaced."""
        surface = None if plane is None or self.surface is None else Surface(plane, self.surface.sigma_mm)
        return _Job(tuple(viewpoints), q, self.names, surface, self.method).run()

    def run(self) -> Measurement:
        refused: dict[int, str] = {}
        solved = []
        for group in self._groups(refused):
            note = partial(_note, refused, group)
            usable = group.only(~startless(group, note))
            if len(usable.rows):
                found = solve(usable, by_rays=self.method == "rays", refuse=partial(_note, refused, usable))
                solved.append((usable, found))
        return self._assembled([_part(group, found) for group, found in solved], refused)

    def _groups(self, refused: dict[int, str]) -> Iterator[SharedView]:
        """Yield the points by their viewpoints; those seen by too few, or where a lens images nothing, are refused."""
        seen = np.asarray(np.isfinite(self.q).all(axis=-1))
        for view, q, here in zip(self.viewpoints, self.q, seen, strict=True):
            for i in np.flatnonzero(here & ~np.isfinite(view.camera.unproject(q)).all(axis=-1)):
                size = "picture of {} x {} px".format(*view.camera.size)
                x, y = q[i]
                refused[int(i)] = f"the lens of {view.name!r} images nothing at x = {x:.6g}, y = {y:.6g} px ({size})"
        good = np.array([i not in refused for i in range(len(self.names))])
        for pattern in np.unique(seen.T, axis=0):
            rows, who = np.flatnonzero((pattern == seen.T).all(axis=1) & good), np.flatnonzero(pattern)
            if len(who) < (2 if self.surface is None else 1):
                only = (
                    f"seen by {self.viewpoints[who[0]].name!r} only: one ray needs a plane" if len(who) else "not seen"
                )
                refused.update((int(i), only) for i in rows)
            elif len(rows):
                yield SharedView(tuple(self.viewpoints[v] for v in who), rows, self.q[who][:, rows], self.surface)

    def _assembled(self, parts: list[_Part], refused: dict[int, str]) -> Measurement:
        sources = distinct_sources([source for part in parts for source, _ in part.effects])
        rows = _joined([part.rows for part in parts], int)
        keep = np.array([i for i in np.argsort(rows) if int(rows[i]) not in refused], dtype=int)
        seen_by = [part.seen_by for part in parts for _ in part.rows]

        def all_of(name: str, *shape: int) -> Array:
            values = [getattr(part, name) for part in parts]
            return np.asarray(_joined(values, float).reshape(-1, *shape)[keep])

        return Measurement(
            names=tuple(self.names[i] for i in rows[keep]),
            points=all_of("points", 3),
            noise=_noise_of(parts, keep),
            effects=tuple((s, _joined([p.effect(s) for p in parts], float)[keep]) for s in sources),
            seen_by=tuple(seen_by[i] for i in keep),
            chi2=all_of("chi2"),
            dof=all_of("dof").astype(np.int32),
            gap=all_of("gap"),
            gap_sigma=all_of("gap_sigma"),
            angle=all_of("angle"),
            refused={self.names[i]: reason for i, reason in sorted(refused.items())},
            method=_WORDS[self.method],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One group's share of a `Measurement`."""

    rows: Array
    seen_by: tuple[str, ...]
    points: Array
    noise: list[PixelNoise]
    effects: list[tuple[ErrorSource, Array]]
    chi2: Array
    dof: Array
    gap: Array
    gap_sigma: Array
    angle: Array

    def effect(self, source: ErrorSource) -> Array:
        """Return the derivative of these points by a source's parameters, (n, 3, k); zero without effect."""
        own = [s for s, _ in self.effects]
        if any(s.owner is source.owner for s in own):
            return self.effects[index_of(own, source)][1]
        return np.zeros((len(self.rows), 3, len(source.covariance)))


def _part(group: SharedView, found: MeetingPoints) -> _Part:
    G, n = found.gain, len(group.rows)
    effects = [(s, -G @ D) for s, D in zip(group.sources, found.seen.by_source, strict=True)]
    gap, gap_sigma, angle = widest(group, found)
    return _Part(
        rows=np.asarray(group.rows),
        seen_by=tuple(view.name for view in group.viewpoints),
        points=found.p,
        noise=_pixel_noise(group, G),
        effects=effects,
        chi2=found.chi2,
        dof=np.full(n, 2 * len(group.viewpoints) - (3 if group.surface is None else 2)),
        gap=gap,
        gap_sigma=gap_sigma,
        angle=angle,
    )


def _pixel_noise(group: SharedView, G: Array) -> list[PixelNoise]:
    """Return the points' covariances due to pixel noise, one part for each calibration that states it."""
    out: dict[int, PixelNoise] = {}
    for v, view in enumerate(group.viewpoints):
        own = G[:, :, 2 * v : 2 * v + 2]
        more = view.sigma_px**2 * own @ np.swapaxes(own, -1, -2)
        part = out.setdefault(id(view.noise_from), PixelNoise(np.zeros_like(more), view.noise_from, view.noise_dof))
        out[id(view.noise_from)] = replace(part, covariance=part.covariance + more)
    return list(out.values())


def _noise_of(parts: list[_Part], keep: Longs) -> tuple[PixelNoise, ...]:
    """Return the pixel noise of all points, one part for each calibration that states it."""
    owners = {id(noise.owner): noise for part in parts for noise in part.noise}
    nothing = [np.zeros((len(part.rows), 3, 3)) for part in parts]
    own = [{id(noise.owner): noise.covariance for noise in part.noise} for part in parts]
    return tuple(
        replace(
            noise, covariance=_joined([o.get(key, zero) for o, zero in zip(own, nothing, strict=True)], float)[keep]
        )
        for key, noise in owners.items()
    )


def _joined(parts: list[Array], kind: type) -> Array:
    return np.concatenate(parts).astype(kind) if parts else np.zeros(0, dtype=kind)


def _note(refused: dict[int, str], group: SharedView, which: Mask, reason: Reason) -> None:
    """Record why points of a group are refused; the first reason is kept."""
    for i in np.flatnonzero(which):
        refused.setdefault(int(group.rows[i]), reason(int(i)))
