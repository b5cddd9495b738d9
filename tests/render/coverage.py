"""Which triangle each pixel centre sees, by brute force in extended precision: the judge of the rasteriser.

Shares nothing with it but the meaning of a camera: every triangle is tried at every pixel's ray, by signs of volumes.
"""

from __future__ import annotations

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid


def brute_force(
    vertices: np.ndarray, faces: np.ndarray, camera: Camera, pose: Rigid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return face (H, W) seen (-1 = none), its 1/z, and that of the next face behind (0 = none)."""
    ray = camera.unproject(camera.pixel_grid()).astype(np.longdouble)
    d = ray / ray[..., 2:]
    p = vertices.astype(np.longdouble) @ pose.rotation.T.astype(np.longdouble) + pose.translation
    shape = d.shape[:2]
    face, best, second = np.full(shape, -1), np.zeros(shape, np.longdouble), np.zeros(shape, np.longdouble)
    for k, (a, b, c) in enumerate(p[faces]):
        volumes = [d @ np.cross(b, c), d @ np.cross(c, a), d @ np.cross(a, b)]
        normal = np.cross(b - a, c - a)
        whole = normal @ a
        if whole == 0:
            continue
        inside = np.logical_and.reduce([v * np.sign(whole) > 0 for v in volumes])
        w = np.where(inside, d @ normal / whole, 0)
        wins = w > best
        second = np.where(wins, best, np.maximum(second, w))
        face, best = np.where(wins, k, face), np.where(wins, w, best)
    return face, best, second
