"""Render many frames and print the memory in use, as a script in a process of its own.

frames.py RENDERER FRAMES WARM: nothing is printed before WARM frames.
"""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.view import Look, Scene

CAMERAS = [Camera.from_focal((96, 72), 100.0), Camera.from_focal((96, 72), 75.0, lens=BrownConrady(-0.28, 0.06))]
LIFE = 20  # frames of a renderer


def resident() -> int:
    """Return how much memory of this process is in use now, bytes."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def render_some(scene: Scene, name: str) -> None:
    """Render `LIFE` frames with a new renderer: either camera, one or more samples, single frames and batches."""
    renderer = open_renderer(scene, name)
    x, y, z = scene.mesh.bounds[1] * [2.0, 1.5, 3.0]
    poses = [Rigid.look_at([x + k, y, z], scene.mesh.bounds.mean(axis=0)) for k in range(5)]
    for k in range(LIFE // len(poses)):
        camera, look = CAMERAS[k // 3 % 2], Look(supersampling=1 + k // 2 % 2)
        if k % 2:
            views = [renderer.render(camera, pose, look=look) for pose in poses]
        else:
            views = list(renderer.render_batch(camera, poses, look=look))
        assert all(view.mask.any() for view in views)


def main(name: str, frames: int, warm: int) -> None:
    """Print frames done and bytes in use, every so often."""
    scene = Scene.of(machined_bracket())
    for done in range(LIFE, warm + frames + 1, LIFE):
        render_some(scene, name)
        if done >= warm:
            print(done - warm, resident(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
