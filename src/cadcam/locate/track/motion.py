"""The motion of a part from frame to frame: predicted and filtered poses, with covariances.

A Kalman filter on poses, with constant velocity but for a random acceleration:

    T' = T exp(v + w/2)     v' = v + w     w ~ N(0, s^2 I)         measured: Z = T exp(e), e ~ N(0, R)

in the part's axes about its centre, with rotations times its radius so that all six are in mm (errors on the right of
the pose, as everywhere; J. Sola et al., "A micro Lie theory for state estimation in robotics", 2018). R is the
covariance that a frame states. The user need not know the acceleration s: filters with several s run in parallel, each
is weighted by how well it predicted the last frames, and the result is their mixture (D. T. Magill, "Optimal adaptive
estimation of sampled stochastic processes", IEEE Trans. Automatic Control 10, 1965).

Much of the error of edges is the same in every frame: a chamfer, print along an edge, the lens. It does not average
out. So the stated covariance is that of errors e = R^(1/2) u with one u for all frames: the filtered pose is smoother
than those of single frames, but not stated to be more accurate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import NEVER_FREE
from cadcam.locate.uncertainty import symmetric_root

_UNEVEN = np.geomspace(3e-4, 0.3, 7)  # values of s tried, radii of the part per frame^2
_FIRST = 0.3  # sd of an unknown velocity, radii per frame
_REMEMBERED = 0.95  # decay of a filter's weight per frame: the memory of its earlier predictions


class MotionFilter:
    """The motion of a part whose centre is `centre` (3,) mm and whose size is `radius` mm.

    velocity: whether the velocity persists; else the pose does, but for w in each frame.
    """

    def __init__(self, centre: Array, radius: float, *, velocity: bool = True) -> None:
        self._middle = Rigid(np.eye(3), centre)
        self._scale = np.repeat([1.0, radius], 3)  # rotations as mm at the radius
        self._s2 = (_UNEVEN[:, None, None] * radius) ** 2
        self._by_w = np.concatenate([0.5 * np.eye(6), np.eye(6)]) if velocity else np.eye(12, 6)
        self._F = np.eye(12) + (np.eye(12, k=6) if velocity else 0.0)
        self._first = _FIRST * radius if velocity else 0.0
        self._log_p = np.zeros(len(_UNEVEN))
        self._index: int | None = None

    def forget(self) -> None:
        """Forget pose and velocity, as after a loss; the weights of the accelerations s are kept."""
        self._index = None

    def predicted(self, index: int) -> PoseEstimate | None:
        """Return the pose expected in a frame, None unless the frame before it was measured."""
        if self._index is None or self._index != index - 1:
            return None
        T, P, _, _ = self._ahead()
        return self._mixed(T, P[:, :6, :6], self._last)

    def measured(self, index: int, pose: PoseEstimate) -> PoseEstimate:
        """Take in the pose measured in a frame; return the filtered one.

        The calibration's part of the covariance is the frame's own, as it is the same in all frames.
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
        self._E[:, :6] = symmetric_root(R)
        self._P = self._W + self._E @ self._E.swapaxes(1, 2)

    def _ahead(self) -> tuple[Rigid, Array, Array, Array]:
        """Return the next frame's poses, covariances (K, 12, 12) in all and from w alone, and roots (K, 12, 6) of e."""
        step = Rigid.exp(self._v / self._scale)
        T, F = self._T @ step, np.broadcast_to(self._F, self._P.shape).copy()
        F[:, :6, :6] = self._scale[:, None] * step.inv.adjoint() / self._scale
        by_w = self._by_w @ self._free
        Q, Ft = self._s2 * (by_w @ by_w.T), F.swapaxes(1, 2)
        T = Rigid(so3.nearest(T.rotation), T.translation)  # rounding accumulates in a chain of products
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
        self._W, self._E = kept @ W @ kept.swapaxes(1, 2), kept @ E + gain @ symmetric_root(R)
        self._P = kept @ P @ kept.swapaxes(1, 2) + gain @ R @ gain.swapaxes(1, 2)

    def _mixed(self, T: Rigid, P: Array, like: PoseEstimate) -> PoseEstimate:
        """Return the mixture of the filters' poses, world_from_part, as one normal distribution."""
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
    """Return the inverses (K, n, n) of covariances and their log determinants, within the free directions."""
    values, axes = np.linalg.eigh(S)
    free = values > NEVER_FREE * values[:, -1:]
    values = np.where(free, values, 1.0)
    return (axes * (free / values)[:, None, :]) @ axes.swapaxes(1, 2), np.log(values).sum(axis=1)
