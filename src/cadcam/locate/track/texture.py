"""Surface texture that the model lacks (print, grain, dirt): learned from frames, followed in later ones.

Where the part was found, patches of its faces are taken from the photos: a keyframe. Later frames are aligned with the
keyframe of the most similar view (`locate.track.patches`). That determines the motion since the keyframe far more
precisely than edges do, but not the pose then. So it is used as evidence beside each frame's edges, which prevent drift
(L. Vacchetti, V. Lepetit, P. Fua, "Stable real-time 3D tracking using online and offline information", PAMI 26, 2004).

The edges of each frame that follows a keyframe correct its pose, which counts as that many frames' edges, up to
`_FRAMES`: random errors of edges average out, and those that change with the view are forgotten. Errors that all frames
share do not average out, so the stated covariance does not shrink with the number of frames (as in
`locate.track.motion`). The state follows from the frames' photos and poses alone, so an interrupted run can replay them
and continue as if there had been no break.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import NEVER_FREE, PoseEvidence
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.track.patches import LEAST, Canvas, Patches, aligned
from cadcam.locate.uncertainty import symmetric_root
from cadcam.render.view import Renderer

_TURN, _SCALE = math.radians(12.0), 0.12  # change of view, rotation and scale, from which another keyframe is learned
_KEPT = 12  # most keyframes
_PATIENCE = 2  # frames in a row without any patch found again, after which all keyframes are dropped
_MEMORY, _DENIED = 0.8, 25.0  # decay per frame of the mean correction by edges; chi^2 that refutes the keyframe
_FRAMES = 4.0  # most frames that a keyframe counts as


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """The pose at which a keyframe's patches are found in a frame, as evidence, and how many of them were.

    number: of the keyframe. by_one_frame (6, 6): covariance of its pose from the edges of one frame; alone (6, 6): of
    the alignment.
    """

    evidence: PoseEvidence
    number: int
    by_one_frame: Array
    alone: Array
    found: int

    def fused(self, fitted: Array) -> Array:
        """Return the covariance (6, 6) of a pose fitted to this and to edges; `fitted`: if these were independent.

        They are not: the errors of a frame's edges are also the keyframe's. So errors are e = R^(1/2) u with one u, of
        which (I - K) comes from the keyframe and K, the weight of the frame's own edges, from these.
        """
        scale = np.repeat([1.0, self.evidence.radius], 3)
        C, R, S, P = (
            scale[:, None] * A * scale for A in (fitted, self.by_one_frame, self.alone, self.evidence.covariance)
        )
        by_edges = symmetric_root(_inverse(C) - _inverse(P))
        left = np.eye(6) - C @ by_edges @ by_edges
        E = left @ symmetric_root(R) + C @ by_edges
        return np.asarray((E @ E.T + left @ S @ left.T) / scale[:, None] / scale)


@dataclass(frozen=True, slots=True, eq=False)
class _Keyframe:
    """Patches of each photo of a frame, and the poses camera_from_part at which it was taken.

    off: the correction of the pose by later frames; by_one_frame (6, 6): covariance of the pose from one frame's edges;
    frames: how many frames the pose counts as; by_calibration (6, 6): covariance of the pose due to the cameras, whose
    errors are the same in every frame.
    """

    patches: tuple[Patches, ...]
    views: tuple[Rigid, ...]
    off: Rigid
    by_one_frame: Array
    frames: float
    by_calibration: Array

    @property
    def covariance(self) -> Array:
        """Return the covariance (6, 6) that the keyframe is weighted by."""
        return self.by_one_frame / self.frames


class Texture:
    """The keyframes of a tracked part."""

    def __init__(self, part: Part) -> None:
        self._scene = part.scene
        low, high = part.scene.mesh.bounds
        self._corners = part.scene.mesh.box_corners
        self._middle, self._radius = (low + high) / 2, float(np.linalg.norm(high - low) / 2)
        self._renderer: Renderer | None = None
        self.forget()

    def forget(self) -> None:
        """Drop all keyframes, as after a loss."""
        self._keyframes: list[_Keyframe] = []
        self._misses = 0
        self._pull, self._pulls = np.zeros(6), 0.0

    def follow(self, photos: Sequence[Photo], start: Rigid, freedom: Freedom) -> Followed | None:
        """Return the pose by the texture, from a start some px off; None where it is not found again."""
        if not self._keyframes:
            return None
        views = _views(photos, start)
        number = int(np.argmin([self._difference(k.views, views) for k in self._keyframes]))
        keyframe = self._keyframes[number]
        found = aligned(keyframe.patches, self._canvases(photos, views), photos, start, freedom)
        if found is None:
            return None
        pose, covariance = found.world_from_part @ keyframe.off, keyframe.covariance + found.covariance
        evidence = PoseEvidence(pose, covariance, self._radius, from_calibration=keyframe.by_calibration)
        return Followed(evidence, number, keyframe.by_one_frame, found.covariance, found.found)

    def keep(self, photos: Sequence[Photo], pose: PoseEstimate, followed: Followed | None) -> None:
        """Take in the pose found in a frame, and the keyframe that was followed, if any."""
        if followed is None:
            self._misses += 1
            if not self._keyframes or self._misses > _PATIENCE:
                self.forget()
                self._learn(photos, pose, 1.0)
            return
        self._misses = 0
        if self._slides(followed, pose):
            self.forget()
            self._learn(photos, pose, 1.0)
            return
        mended = self._mended(self._keyframes[followed.number], followed, pose)
        self._keyframes[followed.number] = mended
        if self._difference(mended.views, _views(photos, pose.world_from_part)) > 1.0:
            self._learn(photos, pose, mended.frames)

    def _slides(self, followed: Followed, pose: PoseEstimate) -> bool:
        """Return whether edges keep pulling the pose to the same side, as when a texture slides over the part."""
        there, scale = followed.evidence, np.repeat([1.0, self._radius], 3)
        off = scale * (there.world_from_part.inv @ pose.world_from_part).log()
        sigmas = symmetric_root(_inverse(scale[:, None] * there.covariance * scale)) @ off
        self._pull, self._pulls = _MEMORY * self._pull + sigmas, _MEMORY**2 * self._pulls + 1
        return bool(self._pull @ self._pull > _DENIED * self._pulls)

    def _mended(self, keyframe: _Keyframe, followed: Followed, pose: PoseEstimate) -> _Keyframe:
        """Return the keyframe corrected by its share of the shift between the followed and the final pose."""
        scale = np.repeat([1.0, self._radius], 3)
        own, whole = (scale[:, None] * A * scale for A in (keyframe.covariance, followed.evidence.covariance))
        moved = (followed.evidence.world_from_part.inv @ pose.world_from_part).log()
        off = keyframe.off @ Rigid.exp(own @ _inverse(whole) @ (scale * moved) / scale)
        frames = min(keyframe.frames + 1, _FRAMES)
        by_one_frame = keyframe.by_one_frame + (pose.from_noise - keyframe.by_one_frame) / frames
        by_cameras = keyframe.by_calibration + (pose.from_calibration - keyframe.by_calibration) / frames
        return replace(keyframe, off=off, by_one_frame=by_one_frame, frames=frames, by_calibration=by_cameras)

    def _learn(self, photos: Sequence[Photo], pose: PoseEstimate, frames: float) -> None:
        views = _views(photos, pose.world_from_part)
        patches = tuple(
            self._patches(canvas, view) for canvas, view in zip(self._canvases(photos, views), views, strict=True)
        )
        if sum(len(one) for one in patches) >= LEAST:
            told = (Rigid(), pose.from_noise, frames, pose.from_calibration)
            self._keyframes.append(_Keyframe(patches, tuple(views), *told))
            del self._keyframes[:-_KEPT]

    def _patches(self, canvas: Canvas | None, camera_from_part: Rigid) -> Patches:
        from cadcam.render import open_renderer

        if canvas is None:
            return Patches.none()
        if self._renderer is None:
            self._renderer = open_renderer(self._scene, threads=1)
        return Patches.learned(self._renderer, canvas, camera_from_part)

    def _canvases(self, photos: Sequence[Photo], views: Sequence[Rigid]) -> list[Canvas | None]:
        return [Canvas.of(photo, self._corners, view) for photo, view in zip(photos, views, strict=True)]

    def _difference(self, one: Sequence[Rigid], other: Sequence[Rigid]) -> float:
        """Return how different two views of the part are, 1: worth a keyframe. Roll in the picture is ignored."""
        a, b = (np.array([view.origin - self._middle for view in views]) for views in (one, other))
        far = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
        turned = np.arccos(np.clip((a * b).sum(axis=1) / (far[0] * far[1]), -1, 1))
        return float(np.maximum(turned / _TURN, np.abs(np.log(far[0] / far[1])) / _SCALE).max())


def _views(photos: Sequence[Photo], world_from_part: Rigid) -> list[Rigid]:
    return [photo.camera_from_world @ world_from_part for photo in photos]


def _inverse(A: Array) -> Array:
    """Return the inverse of a covariance within the free directions."""
    return np.asarray(np.linalg.pinv(A, rcond=NEVER_FREE, hermitian=True))
