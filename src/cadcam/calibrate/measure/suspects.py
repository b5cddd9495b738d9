"""Rays that miss each other because one input was misread: alternatives are tried, and named on clear evidence.

Swapped columns, rows counted upwards, two views exchanged, an inverted motion or one in metres: each leaves gaps that
its correction closes. Only a hundredfold improvement is named; the rest stays a misfit in the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.measurement import Measurement
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import InconsistentViews
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid

Again = Callable[[Sequence[Viewpoint], Array, Plane | None], Measurement]

_SUSPICIOUS = 5.0  # sigmas, root of the median misfit per degree of freedom: never reached by noise
_GOOD = 2.0
_TIMES_BETTER = 10.0  # in sigmas
_EVIDENCE = 3  # degrees of freedom in total: a single gap may close by chance
_ENOUGH = 40  # points tried


@dataclass(frozen=True, slots=True, eq=False)
class _Suspect:
    """An alternative reading of an input, and its description."""

    words: str
    viewpoints: Sequence[Viewpoint]
    q: Array
    plane: Plane | None


def refuse_if_explained(
    measured: Measurement, viewpoints: Sequence[Viewpoint], q: Array, plane: Plane | None, again: Again
) -> None:
    """Raise `InconsistentViews` if points do not fit, or lie behind a camera, unless one input is read differently."""
    seen = np.isfinite(q).all(axis=-1).sum(axis=0)
    measurable = seen >= (2 if plane is None else 1)
    evidence = int(np.sum((2 * seen - (3 if plane is None else 2))[measurable]))
    given = _misfit(measured) if 2 * len(measured) > measurable.sum() else np.inf
    if evidence < _EVIDENCE or given < _SUSPICIOUS:
        return
    some = np.flatnonzero(measurable)[:_ENOUGH]
    few = np.full_like(q, np.nan)
    few[:, some] = q[:, some]
    found = []
    for suspect in _suspects(viewpoints, few, plane):
        other = again(suspect.viewpoints, suspect.q, suspect.plane)
        misfit = _misfit(other)
        if len(other) >= 0.8 * len(some) and misfit < _GOOD and misfit * _TIMES_BETTER < given:
            found.append((misfit, suspect.words))
    if found:
        misfit, words = min(found)
        had = f"miss each other by {given:.3g} sigmas" if np.isfinite(given) else "meet behind a camera or nowhere"
        raise InconsistentViews(
            f"at half of the points or more the rays {had} ({evidence} degrees of freedom in all), but by {misfit:.2g} "
            f"sigmas only if {words}: correct that input"
        )


def _misfit(measured: Measurement) -> float:
    """Return the root of the median of chi-square per degree of freedom, inf without any point."""
    some = measured.dof > 0
    return float(np.sqrt(np.median(measured.chi2[some] / measured.dof[some]))) if some.any() else np.inf


def _suspects(viewpoints: Sequence[Viewpoint], q: Array, plane: Plane | None) -> Iterator[_Suspect]:
    everyone = range(len(viewpoints))
    for who, name in [(everyone, "all views"), *(([v], f"view {viewpoints[v].name!r}") for v in everyone)]:
        yield _Suspect(f"the two image columns of {name} are exchanged", viewpoints, _read(q, who, _swapped), plane)
        flipped = _read(q, who, partial(_upwards, viewpoints))
        yield _Suspect(f"the rows of {name} are counted upwards", viewpoints, flipped, plane)
    for i, j in combinations(everyone, 2):
        order = list(everyone)
        order[i], order[j] = j, i
        names = f"{viewpoints[i].name!r} and {viewpoints[j].name!r}"
        yield _Suspect(f"the pixels of views {names} are exchanged", viewpoints, q[order], plane)
    for v, view in enumerate(viewpoints):
        for words, pose in _other_places(view):
            others = list(viewpoints)
            others[v] = replace(view, camera_from_world=pose)
            yield _Suspect(words, others, q, plane)
    if plane is not None:
        for factor, words in ((1e3, "metres, not millimetres"), (1e-3, "micrometres, not millimetres")):
            scaled = Plane(plane.normal, factor * plane.offset)
            yield _Suspect(f"the plane's height is in {words}", viewpoints, q, scaled)


def _other_places(view: Viewpoint) -> Iterator[tuple[str, Rigid]]:
    """Yield other poses that a viewpoint may have been meant to have."""
    pose = view.camera_from_world
    for factor, words in ((1e3, "in metres, not millimetres"), (1e-3, "1000 times too long: mm said to be m")):
        if view.motion is None:
            yield f"the place of camera {view.name!r} is {words}", _scaled(pose, factor)
        else:
            home = pose @ view.motion
            yield f"the motion to {view.name!r} is {words}", home @ _scaled(view.motion, factor).inv
    if view.motion is not None:
        yield (
            f"the motion to {view.name!r} is given the other way round (old_from_new)",
            pose @ view.motion @ view.motion,
        )
        yield f"the camera of {view.name!r} has not moved", pose @ view.motion


def _scaled(pose: Rigid, factor: float) -> Rigid:
    return Rigid(pose.rotation, factor * pose.translation)


def _swapped(q: Array, _: int) -> Array:
    return q[..., ::-1]


def _upwards(viewpoints: Sequence[Viewpoint], q: Array, v: int) -> Array:
    return np.stack([q[..., 0], viewpoints[v].camera.height - 1 - q[..., 1]], axis=-1)


def _read(q: Array, who: Sequence[int], change: Callable[[Array, int], Array]) -> Array:
    out = q.copy()
    for v in who:
        out[v] = change(q[v], v)
    return out
