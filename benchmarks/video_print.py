"""Which poses of a video does the print on the part follow: a judge that uses no edges of the part.

The picture of one frame is taken off the part's faces by a pose, and laid onto another frame: the motion between the
two that makes both pictures agree best comes from the print alone, face by face of its own brightness and contrast. A
tracker's poses of the two frames say another motion; the difference is its error, of both frames together. Errors that
are the same in both do not show. (The principle: B. Lucas, T. Kanade, "An iterative image registration technique",
IJCAI 1981, over all six motions of a rigid part.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid

_STEP, _BORDER = 4.0, 4.0  # mm between points on a face, and how far they stay from its edges
_BLUR = 1.0  # px
_ROUNDS = 12
_FACING = 0.25  # cosine of the view from which a face is looked at
_LINKED, _LINK_MM = (1, 2, 3, 5, 8, 12), 0.15  # frames apart that are joined, and how well
_LEAST = 40  # points of a face, and of all


def motion_by_print(
    camera: Camera, pictures: tuple[Picture, Picture], poses: tuple[Rigid, Rigid], box: Array
) -> Rigid | None:
    """Return the second pose (camera_from_part) as the print says by the first; None where too little is seen in both.

    box (2, 3) mm: the part's corners; its faces are those of the box. The second of `poses` is where it starts.
    """
    first, second = (gaussian_filter(p.astype(np.float64), _BLUR) for p in pictures)
    points, face = _points(box, camera, poses)
    if len(points) < _LEAST:
        return None
    before = _sampled(first, camera.project(poses[0] @ points))
    dx, dy = np.gradient(second, axis=1), np.gradient(second, axis=0)
    pose, own = poses[1], face[:, None] == np.unique(face)
    for _ in range(_ROUNDS):
        q, J = camera.project_with_jacobian(pose @ points)
        gradient = np.stack([_sampled(dx, q), _sampled(dy, q)], axis=1)
        by_point = np.einsum("ni,nij,jk->nk", gradient, J, pose.rotation)
        light = -np.concatenate([own, own * before[:, None]], axis=1)
        A = np.concatenate([by_point, np.cross(points, by_point), light], axis=1)
        r = -_sampled(second, q)
        w = _weights(r - light @ np.linalg.solve(light.T @ light, light.T @ r))
        x = np.linalg.solve((A * w[:, None] ** 2).T @ A, A.T @ (w**2 * r))
        pose = pose @ Rigid.exp(x[:6])
        if np.abs(x[:3]).max() < 3e-3:
            return pose
    return None


def told_and_shown(
    camera: Camera, pictures: Sequence[Picture], poses: Sequence[Rigid | None], box: Array, apart: int, every: int = 1
) -> tuple[Array, Array]:
    """Return by how much (mm at the box's middle, deg) pairs of frames `apart` from each other differ from the print.

    every: of how many frames one begins a pair.
    """
    from cadcam.geometry import rotation as so3

    mm, deg, middle = [], [], box.mean(axis=0)
    for k in range(0, len(poses) - apart, every):
        one, other = poses[k], poses[k + apart]
        if one is None or other is None:
            continue
        by_print = motion_by_print(camera, (pictures[k], pictures[k + apart]), (one, other), box)
        if by_print is not None:
            mm.append(float(np.linalg.norm(by_print @ middle - other @ middle)))
            deg.append(float(np.degrees(np.linalg.norm(so3.log((by_print.inv @ other).rotation)))))
    return np.array(mm), np.array(deg)


def straightened(camera: Camera, pictures: Sequence[Picture], poses: Sequence[Rigid], box: Array) -> list[Rigid]:
    """Return poses moved to where the print of all frames agrees, each as little as that takes.

    Errors of single frames go, those that all frames share remain.
    Frames a few apart are joined by the motion that the print says; corrections x of the poses, small twists about the
    part's middle, are to make x_b - x_a what it says more, and to be small: 0.15 mm to 1 mm, far ones hardly count.
    """
    middle, radius = Rigid(np.eye(3), box.mean(axis=0)), float(np.linalg.norm(box[1] - box[0]) / 2)
    scale, links = np.repeat([1.0, radius], 3), []
    for apart in _LINKED:
        for a, b in zip(range(len(poses) - apart), range(apart, len(poses)), strict=True):
            said = motion_by_print(camera, (pictures[a], pictures[b]), (poses[a], poses[b]), box)
            if said is not None:
                more = scale * (middle.inv @ poses[b].inv @ said @ middle).log()
                links.append((a, b, more, _LINK_MM**2 * (1 + 0.1 * apart)))
    n = len(poses)
    x: Array = np.zeros((n, 6))
    for _ in range(_ROUNDS):
        own: Array = 1 / (1 + (np.linalg.norm(x, axis=1) / 1.5) ** 2)
        A, right = np.diag(own), np.zeros((n, 6))
        for a, b, more, variance in links:
            w = 1 / (variance * (1 + (np.linalg.norm(x[b] - x[a] - more) / (5 * _LINK_MM)) ** 2))
            A[[a, b, a, b], [a, b, b, a]] += [w, w, -w, -w]
            right[b] += w * more
            right[a] -= w * more
        x = np.asarray(np.linalg.solve(A, right))
    return [pose @ middle @ Rigid.exp(one / scale) @ middle.inv for pose, one in zip(poses, x, strict=True)]


def _points(box: Array, camera: Camera, poses: Sequence[Rigid]) -> tuple[Array, Array]:
    """Return points (N, 3) mm of the box's faces that both poses show, and the face (N,) of each."""
    points, faces, middle = [], [], box.mean(axis=0)
    for axis in range(3):
        u, v = (i for i in range(3) if i != axis)
        grid = [np.arange(box[0, i] + _BORDER, box[1, i] - _BORDER, _STEP) for i in (u, v)]
        for end in range(2):
            p = np.zeros((len(grid[0]) * len(grid[1]), 3))
            p[:, u], p[:, v] = (a.ravel() for a in np.meshgrid(*grid))
            p[:, axis] = box[end, axis]
            outward = np.zeros(3)
            outward[axis] = np.sign(box[end, axis] - middle[axis])
            if all(_facing(pose, p.mean(axis=0), outward) > _FACING for pose in poses):
                p = p[np.all([camera.sees(camera.project(pose @ p)) for pose in poses], axis=0)]
                points.append(p)
                faces.append(np.full(len(p), 2 * axis + end))
    kept = [k for k, p in enumerate(points) if len(p) >= _LEAST]
    return (
        np.concatenate([np.zeros((0, 3)), *(points[k] for k in kept)]),
        np.concatenate([np.zeros(0, int), *(faces[k] for k in kept)]),
    )


def _facing(pose: Rigid, p: Array, outward: Array) -> float:
    at = pose @ p
    return float(-(pose.rotation @ outward) @ at / np.linalg.norm(at))


def _sampled(picture: Array, q: Array) -> Array:
    return np.asarray(map_coordinates(picture, [q[:, 1], q[:, 0]], order=1, mode="nearest"))


def _weights(r: Array) -> Array:
    """Return how far residuals (n,) count (Huber)."""
    scale = 1.4826 * np.median(np.abs(r - np.median(r))) + 1e-9
    return np.asarray(np.sqrt(np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(r), 1e-12))))
