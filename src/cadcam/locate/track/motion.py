"""How a part moves from frame to frame: where it will be, and where it is by all frames so far, with covariances.

A Kalman filter on poses. The part keeps its velocity but for an acceleration that nobody knows:

    T' = T exp(v + w/2)     v' = v + w     w ~ N(0, s^2 I)         measured: Z = T exp(e), e ~ N(0, R)

in the part's axes about its middle, turns times its radius so that all six are mm (errors on the right of the pose, as
everywhere; J. Sola et al., "A micro Lie theory for state estimation in robotics", 2018). R is what a frame tells of
itself. How unevenly the part moves, s, is not asked of the user: filters with several s run beside each other, each
counts by how well it foretold the last frames, and what comes out is their mixture (D. T. Magill, "Optimal adaptive
estimation of sampled stochastic processes", IEEE Trans. Automatic Control 10, 1965).

Much of what edges err by is the same in every frame: a chamfer, print along an edge, the lens. It does not average out.
So the stated covariance is that of errors e = R^(1/2) u with one u in all frames: the pose is steadier than that
of single frames, not surer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_UNEVEN = np.geomspace(3e-4, 0.3, 7)  # s that are tried, radii of the part per frame^2
_FIRST = 0.3  # sd of the velocity when nothing is known of it, radii per frame
_REMEMBERED = 0.95  # of how well a filter foretold, from frame to frame
_TINY = 1e-12  # share of the largest variance below which a direction was never free


class MotionFilter:
    """The motion of a part whose middle is `centre` (3,) mm and whose size is `radius` mm.

    velocity: whether it is expected to go on; else to stay, off by w in each frame.
    """

    def __init__(self, centre: Array, radius: float, *, velocity: bool = True) -> None:
        self._middle = Rigid(np.eye(3), centre)
        self._scale = np.repeat([1.0, radius], 3)  # turns as mm
        self._s2 = (_UNEVEN[:, None, None] * radius) ** 2
        self._by_w = np.concatenate([0.5 * np.eye(6), np.eye(6)]) if velocity else np.eye(12, 6)
        self._F = np.eye(12) + (np.eye(12, k=6) if velocity else 0.0)
        self._first = _FIRST * radius if velocity else 0.0
        self._log_p = np.zeros(len(_UNEVEN))
        self._index: int | None = None

    def forget(self) -> None:
        """Start anew, as after a loss; only how unevenly the part moves is kept."""
        self._index = None

    def predicted(self, index: int) -> PoseEstimate | None:
        """Return where a frame will show the part, None unless it was measured in the one before."""
        if self._index is None or self._index != index - 1:
            return None
        T, P, _, _ = self._ahead()
        return self._mixed(T, P[:, :6, :6], self._last)

    def measured(self, index: int, pose: PoseEstimate) -> PoseEstimate:
        """Take up where a frame showed the part; return where it is by all frames so far.

        The calibration's share in the covariance is the frame's own: it is the same in all of them.
        """
        Ad = self._scale[:, None] * self._middle.inv.adjoint()
        R, Z = Ad @ pose.from_noise @ Ad.T, pose.world_from_part @ self._middle
        if self._index is None or self._index != index - 1:
            self._begin(Z, R, Ad @ pose.freedom)
        else:
            self._update(Z, R)
        self._index, self._last = index, pose
        return self._mixed(self._T, (self._W + self._E @ self._E.swapaxes(1, 2))[:, :6, :6], pose)

    def _begin(self, Z: Rigid, R: Array, free: Array) -> None:
        n = len(self._log_p)
        basis = np.linalg.qr(free)[0]
        self._free = basis @ basis.T
        self._T = Rigid(np.broadcast_to(Z.rotation, (n, 3, 3)), np.broadcast_to(Z.translation, (n, 3)))
        self._v, self._W, self._E = np.zeros((n, 6)), np.zeros((n, 12, 12)), np.zeros((n, 12, 6))
        self._W[:, 6:, 6:] = self._first**2 * self._free
        self._E[:, :6] = _root(R)
        self._P = self._W + self._E @ self._E.swapaxes(1, 2)

    def _ahead(self) -> tuple[Rigid, Array, Array, Array]:
        """Return one frame later: poses, covariances (K, 12, 12) by all and by w alone, roots (K, 12, 6) of e."""
        step = Rigid.exp(self._v / self._scale)
        T, F = self._T @ step, np.broadcast_to(self._F, self._P.shape).copy()
        F[:, :6, :6] = self._scale[:, None] * step.inv.adjoint() / self._scale
        by_w = self._by_w @ self._free
        Q, Ft = self._s2 * (by_w @ by_w.T), F.swapaxes(1, 2)
        T = Rigid(so3.nearest(T.rotation), T.translation)  # in a chain of products rounding grows
        return T, F @ self._P @ Ft + Q, F @ self._W @ Ft + Q, F @ self._E

    def _update(self, Z: Rigid, R: Array) -> None:
        T, P, W, E = self._ahead()
        y = ((T.inv @ Z).log() * self._scale)[:, :, None]
        inverse, log_det = _inverse(P[:, :6, :6] + R)
        gain = P[:, :, :6] @ inverse
        self._log_p = _REMEMBERED * self._log_p - 0.5 * ((y.swapaxes(1, 2) @ inverse @ y)[:, 0, 0] + log_det)
        self._log_p -= self._log_p.max()
        moved = (gain @ y)[:, :, 0]
        self._T, self._v = T @ Rigid.exp(moved[:, :6] / self._scale), self._v + moved[:, 6:]
        kept = np.eye(12) - np.concatenate([gain, np.zeros_like(gain)], axis=2)
        self._W, self._E = kept @ W @ kept.swapaxes(1, 2), kept @ E + gain @ _root(R)
        self._P = kept @ P @ kept.swapaxes(1, 2) + gain @ R @ gain.swapaxes(1, 2)

    def _mixed(self, T: Rigid, P: Array, like: PoseEstimate) -> PoseEstimate:
        """Return the mixture of the filters' poses as one normal distribution: world_from_part."""
        p = np.exp(self._log_p) / np.exp(self._log_p).sum()
        k = int(np.argmax(p))
        best = Rigid(T.rotation[k], T.translation[k])
        apart = (best.inv @ T).log() * self._scale
        mean = p @ apart
        covariance = np.tensordot(p, P, 1) + (apart - mean).T @ (p[:, None] * (apart - mean))
        pose = best @ Rigid.exp(mean / self._scale) @ self._middle.inv
        Ad = self._middle.adjoint() / self._scale
        return replace(
            like, world_from_part=Rigid(so3.nearest(pose.rotation), pose.translation), from_noise=Ad @ covariance @ Ad.T
        )


def _inverse(S: Array) -> tuple[Array, Array]:
    """Return the inverses (K, n, n) of covariances, and their log determinants, within the directions that are free."""
    values, axes = np.linalg.eigh(S)
    free = values > _TINY * values[:, -1:]
    values = np.where(free, values, 1.0)
    return (axes * (free / values)[:, None, :]) @ axes.swapaxes(1, 2), np.log(values).sum(axis=1)


def _root(R: Array) -> Array:
    """Return the symmetric root of a covariance that may be singular."""
    values, axes = np.linalg.eigh(R)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)
