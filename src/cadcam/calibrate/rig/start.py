"""The mounts of a rig's cameras from each camera's own calibration: the start, and a test of the input.

Two cameras on one rig must show the same relative pose in every frame that both see. It is the robust mean over these
frames; frames that show another one, far beyond what their covariance allows, were not taken together, and are named
with the reading of the input that would explain them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.errors import DegenerateGeometry, InconsistentViews, listed
from cadcam.fit.joint_model import JointModel, JointState
from cadcam.fit.rig_model import squared_misfits
from cadcam.geometry.rigid import Rigid

_GROSS = 20.0  # times the typical normalised deviation (at least 1): errors of a lens or a board are some sigmas
_EXPLAINS = 4.0  # times smaller deviation required of another reading; a picture of the other camera still deviates
_SEEN = 0.01  # of the picture's longer side: tolerance of points predicted by the other camera's pose
_ROUNDING = 1e-6  # rad, and over the distance: deviation of exact data
_TRIED = 25  # frames tried as the reference that the others agree with
_SHIFTS = (1, -1, 2, -2, 3, -3)
_NAMED = 6  # frames in a list before "..."


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """A camera calibrated by itself: model, state and camera_from_world of its views, and the frames (k,) they are in.

    covariance (k, 6, 6): of a step exp(d) camera_from_world, by each view's own noise. longer: side of the picture, px.
    """

    name: str
    model: JointModel
    state: JointState
    frames: Longs
    poses: Rigid
    covariance: Array
    longer: int

    def misfits(self, index: Longs, poses: Rigid) -> Array:
        """Return the mean squared distance (n,), px^2, of the points of some views if they had these poses."""
        state = self.state
        few = replace(state, R=state.R[index], t=state.t[index])
        return squared_misfits(self.model.with_views(index), few, poses.rotation, poses.translation)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """The relative pose b_from_a of two cameras in the frames that both see, with covariances (left)."""

    a: Alone
    b: Alone
    frames: Longs
    in_a: Longs
    in_b: Longs

    @classmethod
    def of(cls, a: Alone, b: Alone) -> _Pair:
        frames, in_a, in_b = np.intersect1d(a.frames, b.frames, return_indices=True)
        return cls(a, b, frames, in_a, in_b)

    def shifted(self, by: int) -> _Pair:
        """Return the pair with the frames of b shifted `by` later."""
        frames, in_a, in_b = np.intersect1d(self.a.frames, self.b.frames - by, return_indices=True)
        return _Pair(self.a, self.b, frames, in_a, in_b)

    def relative(self) -> tuple[Rigid, Array]:
        """Return b_from_a (k) and the covariance (k, 6, 6) of a step exp(d) b_from_a."""
        b_from_a = self.b.poses[self.in_b] @ self.a.poses[self.in_a].inv
        Ad = b_from_a.adjoint()
        S = self.b.covariance[self.in_b] + Ad @ self.a.covariance[self.in_a] @ np.swapaxes(Ad, -1, -2)
        reach = 1.0 + np.linalg.norm(b_from_a.translation, axis=-1)
        floor = np.concatenate([np.repeat(reach[:, None], 3, axis=1), np.ones((len(reach), 3))], axis=1)
        return b_from_a, S + (_ROUNDING * floor[:, :, None]) ** 2 * np.eye(6)


def mounts(cameras: Sequence[Alone], labels: Sequence[str]) -> Rigid:
    """Return camera_from_rig of all cameras, the rig's frame that of the first; labels: of the frames, for messages.

    Raises `InconsistentViews` naming frames that were not taken together, `DegenerateGeometry` naming a camera that
    shares no frame with the others.
    """
    shared: dict[tuple[int, int], tuple[Rigid, int]] = {}
    for i, j in combinations(range(len(cameras)), 2):
        pair = _Pair.of(cameras[i], cameras[j])
        if len(pair.frames):
            mean = _agreed(pair, labels)
            shared[i, j], shared[j, i] = (mean, len(pair.frames)), (mean.inv, len(pair.frames))
    found = {0: Rigid()}
    while len(found) < len(cameras):
        links = [(n, i, j) for (i, j), (_, n) in shared.items() if i in found and j not in found]
        if not links:
            _refuse_unlinked(cameras, found)
        _, i, j = max(links)
        found[j] = shared[i, j][0] @ found[i]
    return Rigid.stack([found[c] for c in range(len(cameras))])


def rig_poses(cameras: Sequence[Alone], camera_from_rig: Rigid, count: int) -> Rigid:
    """Return rig_from_world of `count` frames: of the poses that its cameras propose, the one that fits all of them."""
    best, R, t = np.full(count, np.inf), np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    R[np.concatenate([c.frames for c in cameras])] = np.nan
    for c, one in enumerate(cameras):
        proposed = camera_from_rig[c].inv @ one.poses
        cost, seen = np.zeros(count), one.frames
        for d, other in enumerate(cameras):
            both, mine, theirs = np.intersect1d(seen, other.frames, return_indices=True)
            if len(both):
                poses = camera_from_rig[d] @ proposed[mine]
                cost[both] += other.misfits(theirs, poses)
        better = (cost[seen] < best[seen]) | np.isnan(R[seen, 0, 0])
        R[seen[better]], t[seen[better]] = proposed.rotation[better], proposed.translation[better]
        best[seen[better]] = cost[seen[better]]
    return Rigid(R, t)


def _agreed(pair: _Pair, labels: Sequence[str]) -> Rigid:
    """Return the robust mean of b_from_a. Raises `InconsistentViews`."""
    relative, S = pair.relative()
    middle, deviation, typical = _middle(relative, S)
    base = relative[middle]
    if typical > _GROSS:
        _refuse_all(pair, typical, labels)
    gross = (deviation > _GROSS * max(1.0, typical)) & ~_seen_alike(pair, base)
    if gross.any():
        _refuse_some(pair, base, S[middle], deviation, gross, labels)
    twists = (relative @ base.inv).log()
    return Rigid.exp(np.median(twists[deviation <= _GROSS * max(1.0, typical)], axis=0)) @ base


def _middle(relative: Rigid, S: Array) -> tuple[int, Array, float]:
    """Return the frame that the others agree with best, their normalised deviations from it, and the lower median."""
    k = len(S)
    if k < 2:
        return 0, np.zeros(k), 0.0
    tried = np.unique(np.linspace(0, k - 1, min(k, _TRIED)).round().astype(int))
    deviations = np.stack([_deviation(relative, S, relative[m], S[m]) for m in tried])
    typical = np.sort(deviations, axis=1)[:, (k - 2) // 2 + 1]  # the first is each one's own 0
    best = int(np.argmin(typical))
    return int(tried[best]), deviations[best], float(typical[best])


def _deviation(relative: Rigid, S: Array, base: Rigid, S_base: Array) -> Array:
    """Return the root mean square (k,) of normalised deviations of relative poses from one, over six coordinates."""
    xi = (relative @ base.inv).log()
    return np.asarray(np.sqrt(np.einsum("ki,ki->k", xi, np.linalg.solve(S + S_base, xi[..., None])[..., 0]) / 6))


def _seen_alike(pair: _Pair, base: Rigid) -> Mask:
    """Return in which frames one camera's pose predicts the other's points: the others are a flat target's flip."""
    in_b = pair.b.misfits(pair.in_b, base @ pair.a.poses[pair.in_a])
    in_a = pair.a.misfits(pair.in_a, base.inv @ pair.b.poses[pair.in_b])
    return np.asarray((np.sqrt(in_b) < _SEEN * pair.b.longer) | (np.sqrt(in_a) < _SEEN * pair.a.longer))


def _refuse_all(pair: _Pair, typical: float, labels: Sequence[str]) -> None:
    """Raise: less than half of the frames agree; names the reading of their order that makes them agree."""
    readings = []
    for by in _SHIFTS:
        other = pair.shifted(by)
        if len(other.frames) > 2:
            word = "later" if by > 0 else "earlier"
            picture = "picture" if abs(by) == 1 else "pictures"
            words = f"if each frame's picture of camera {pair.b.name!r} is the one {abs(by)} {picture} {word}"
            readings.append((_middle(*other.relative())[2], words))
    turned = replace(pair, in_b=pair.in_b[::-1])
    readings.append((_middle(*turned.relative())[2], f"if the frames of camera {pair.b.name!r} are in reverse order"))
    left, words = min(readings)
    hint = f"; they agree {words}" if len(pair.frames) > 2 and left < min(_GROSS, typical / _EXPLAINS) else ""
    frames = listed([labels[f] for f in pair.frames], _NAMED, by="; ")
    raise InconsistentViews(
        f"cameras {pair.a.name!r} and {pair.b.name!r} stand to each other otherwise in every frame ({frames}): the "
        f"relative poses differ by {typical:.3g} times their sigmas{hint}; put pictures of the same moment into the "
        "same frame, and check that the board is one whose turns look different"
    )


def _refuse_some(pair: _Pair, base: Rigid, S_base: Array, deviation: Array, gross: Mask, labels: Sequence[str]) -> None:
    relative, _ = pair.relative()
    bad = np.flatnonzero(gross)
    off = relative @ base.inv
    turn = np.degrees(np.linalg.norm(off.log()[:, 3:], axis=1))
    places = np.linalg.norm(relative.inv.translation - base.inv.translation, axis=1)
    said = [f"{labels[pair.frames[i]]}: {turn[i]:.3g} deg, {places[i]:.3g} mm, {deviation[i]:.3g} sigmas" for i in bad]
    a, b = pair.a.name, pair.b.name
    hint = _explained(pair, base, S_base, deviation, bad, labels)
    why = hint or "; were these pictures taken at the same moment, and did nothing slip?"
    raise InconsistentViews(
        f"in {len(bad)} of {len(gross)} frames camera {b!r} stands to camera {a!r} otherwise than in the rest, off by "
        f"({listed(said, _NAMED, by='; ')}){why}; put them right, or leave these frames out"
    )


def _explained(pair: _Pair, base: Rigid, S_base: Array, deviation: Array, bad: Longs, labels: Sequence[str]) -> str:
    """Return the alternative reading of the bad frames' pictures that brings them near the others."""
    said = []
    for i in bad:
        swapped = _Pair(pair.a, pair.b, pair.frames[[i]], pair.in_a[[i]], pair.in_b[[i]])
        relative, S = swapped.relative()
        if _deviation(relative.inv, S, base, S_base)[0] < deviation[i] / _EXPLAINS:
            said.append(f"the pictures of the two cameras in frame {labels[pair.frames[i]]} are exchanged")
    for i, j in combinations(bad.tolist(), 2):
        crossed = _Pair(pair.a, pair.b, pair.frames[[i, j]], pair.in_a[[i, j]], pair.in_b[[j, i]])
        left = _deviation(*crossed.relative(), base, S_base)
        if (left < np.minimum(deviation[[i, j]] / _EXPLAINS, _GROSS)).all():
            names = f"{labels[pair.frames[i]]} and {labels[pair.frames[j]]}"
            said.append(f"the pictures of camera {pair.b.name!r} (or {pair.a.name!r}) in frames {names} are exchanged")
    return f"; they fit if {' and '.join(said)}" if said else ""


def _refuse_unlinked(cameras: Sequence[Alone], found: dict[int, Rigid]) -> None:
    lost = [repr(c.name) for i, c in enumerate(cameras) if i not in found]
    linked = [repr(cameras[i].name) for i in sorted(found)]
    raise DegenerateGeometry(
        f"no frame is seen by camera {' or '.join(lost)} together with {' or '.join(linked)}: how they stand to each "
        "other cannot be known; add frames in which both see the points (other cameras may link them)"
    )
