"""Make a small data set of a sample part, then read it as anybody would: with json, numpy and Pillow alone.

Run it as `python examples/make_dataset.py [FOLDER]`. It prints how far each view's key points, projected by pose and
camera matrix of BOP's files, lie from the pixels that COCO's file labels, and how much of the part is seen.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import cadcam
from cadcam.cad.parts import machined_bracket
from cadcam.dataset.plan import NOISE, PLAIN, Occluders


def main(folder: Path) -> None:
    """Make eight views, from above and partly hidden, before plain and noisy backgrounds; check them."""
    plan = cadcam.DatasetPlan(
        views=8,
        camera=cadcam.Camera.from_focal((320, 240), 330.0),
        seed=1,
        around=cadcam.ViewRange.above(within_deg=70),
        backgrounds=(PLAIN, NOISE),
        occluders=Occluders(count=(0, 2)),
    )
    made = cadcam.make_dataset(folder, cadcam.Scene.of(machined_bracket()), plan, name="bracket")
    print(f"{made.new} views made; look at {made.contact}")
    check(folder)


def check(folder: Path) -> None:
    """Reproject every view's key points; count the part's visible pixels."""
    scene = folder / "train/000000"
    camera, gt = (json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt"))
    points = np.array(json.loads((folder / "dataset.json").read_text())["key_points"]["p_mm"])
    for annotation in json.loads((folder / "train_coco.json").read_text())["annotations"]:
        view = str(annotation["image_id"])
        K, R = (np.reshape(m, (3, 3)) for m in (camera[view]["cam_K"], gt[view][0]["cam_R_m2c"]))
        q = (points @ R.T + gt[view][0]["cam_t_m2c"]) @ K.T
        told = np.reshape(annotation["keypoints"], (-1, 3))
        off = np.abs(q[:, :2] / q[:, 2:] - told[:, :2])[told[:, 2] > 0].max()
        mask = np.asarray(Image.open(scene / f"mask_visib/{int(view):06d}_000000.png"))
        print(f"view {view}: key points reproject to {off:.4f} px, {np.count_nonzero(mask)} px of the part are seen")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "bracket_set"))
