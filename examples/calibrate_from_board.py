"""A camera from pictures of a chessboard: drawn here, found again, calibrated; and which picture to take next."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import cadcam
from cadcam.calibrate.boards.next_view import next_views
from cadcam.target.marks.ideal import board_picture


def main(folder: Path) -> None:
    board = cadcam.parse_pattern("chessboard:7x5:30mm")
    true = cadcam.Camera.from_focal((320, 240), 300.0, lens=cadcam.BrownConrady(k1=-0.2))
    centre = cadcam.Rigid(np.eye(3), -board.points.mean(axis=0))
    away = cadcam.Rigid(np.eye(3), np.array([0.0, 0.0, 320.0]))
    rng = np.random.default_rng(1)
    for k, turn in enumerate(([0.5, 0.1, 0.0], [-0.4, 0.2, 0.1], [0.1, -0.5, 0.0], [-0.1, 0.5, -0.1])):
        pose = away @ cadcam.Rigid.exp([0, 0, 0, *turn]) @ centre
        picture = board_picture(board, true, pose, blur_px=0.7, noise=0.01, rng=rng)
        cadcam.write_picture(folder / f"{k}.png", picture)

    found = [cadcam.find_board(path, board) for path in sorted(folder.glob("*.png"))]
    calibration = cadcam.calibrate_boards(found, lens=cadcam.BrownConrady(), free_lens=["k1"])
    estimate = calibration.estimate
    for name in estimate.free:
        print(f"{name:7} {estimate.value(name):9.4f} +- {estimate.sigma(name):.4f}")
    print(f"true focal 300, k1 -0.2; residual {estimate.residual:.4f} px")
    print(f"next: {next_views(calibration, count=1)[0].words()}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
