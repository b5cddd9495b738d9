"""Render a CAD model as a real camera saw it: shaded picture, depth in mm, and which part each pixel shows.

Run it as `python examples/render_bench.py [FOLDER]`. The camera is calibrated from the dissertation's Table 2.3; the
model is its test bench, in models.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import cadcam

HERE = Path(__file__).parent


def main(folder: Path) -> None:
    """Calibrate, render, write bench.png and depth.npy, name what the picture's middle shows."""
    folder.mkdir(parents=True, exist_ok=True)
    seen = cadcam.calibrate_camera(cadcam.read_points(HERE / "data" / "bench_points.csv"), size=(768, 576))
    mesh = cadcam.read_model(HERE.parent / "models" / "bench.glb")
    renderer = cadcam.open_renderer(cadcam.Scene.of(mesh))
    view = renderer.render(seen.camera, seen.camera_from_world, look=cadcam.Look(supersampling=2))
    cadcam.write_picture(folder / "bench.png", view.image)
    np.save(folder / "depth.npy", view.depth)

    targets = sorted({name.rpartition(" ")[0] for name in np.array(mesh.part_names)[np.unique(view.part[view.mask])]})
    x, y = 384, 288
    print(f"pixel ({x}, {y}) shows {mesh.part_names[view.part[y, x]]!r} at a depth of {view.depth[y, x]:.1f} mm")
    print(f"{sum(t.startswith('target') for t in targets)} of 16 targets are in view")
    print(f"wrote {folder / 'bench.png'} and {folder / 'depth.npy'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
