"""A table of cameras as they occur: every camera test runs over it."""

from __future__ import annotations

from cadcam.camera.camera import Camera
from cadcam.camera.lens import (
    BrownConrady,
    Division,
    DoubleSphere,
    ExtendedUnified,
    FieldOfView,
    Fisheye,
    InverseBrownConrady,
    OddRadial,
    TiltedBrownConrady,
)

CAMERAS: dict[str, Camera] = {
    "ideal, square, centred": Camera.from_focal((640, 480), 600.0),
    "thesis position 1 (1996, 6.5 mm lens)": Camera.from_focal(
        (768, 576), 811.8, fy=805.88, cx=354.66, cy=319.74, skew=0.142
    ),
    "strongly skewed, off centre": Camera.from_focal((800, 600), 900.0, fy=700.0, cx=250.3, cy=410.9, skew=55.0),
    "OpenCV stereo sample, left": Camera.from_focal(
        (640, 480), 535.9, cx=342.3, cy=235.6, lens=BrownConrady(-0.266, -0.038, 0.0018, -0.0003, 0.238)
    ),
    "phone, rational": Camera.from_focal(
        (4000, 3000),
        3100.0,
        cx=2010.2,
        cy=1489.7,
        lens=BrownConrady(0.12, -0.31, 4e-4, -3e-4, 0.09, 0.02, -0.15, 0.03),
    ),
    "rational with thin prism": Camera.from_focal(
        (1600, 1200),
        1300.0,
        fy=1310.0,
        skew=2.0,
        lens=BrownConrady(-0.21, 0.06, 1e-3, -2e-3, 0.01, 0.05, 0.01, 0.0, 1e-3, -5e-4, 8e-4, 2e-4),
    ),
    "rational up to its pole": Camera.from_focal((640, 480), 320.0, lens=BrownConrady(0.05, k4=-0.5, k5=0.02)),
    "rational up to its pole, decentred": Camera.from_focal(
        (640, 480), 320.0, lens=BrownConrady(0.05, p1=2e-3, p2=-1e-3, k4=-0.5, s1=0.01)
    ),
    "barrel until it folds": Camera.from_focal((640, 480), 300.0, lens=BrownConrady(-0.35, 0.05)),
    "pincushion": Camera.from_focal((1280, 960), 1500.0, lens=BrownConrady(0.25, 0.1)),
    "thesis EQ 2.5": Camera.from_focal((768, 576), 806.0, lens=OddRadial(0.001, -0.12, 0.05, -0.02)),
    "division, barrel": Camera.from_focal((1280, 1024), 700.0, lens=Division(-0.3)),
    "division, pincushion": Camera.from_focal((1280, 1024), 1700.0, lens=Division(0.2)),
    "fisheye, 150 deg": Camera.from_focal((1280, 960), 400.0, lens=Fisheye(0.03, -0.008, 0.001, -0.0002), skew=1.0),
    "fisheye that folds": Camera.from_focal((1280, 960), 380.0, lens=Fisheye(-0.15)),
    "Scheimpflug, 6 and 9 deg": Camera.from_focal(
        (1280, 960),
        1900.0,
        lens=TiltedBrownConrady(-0.2, 0.05, 5e-4, -3e-4, 0.0, 0.0, 0.0, 0.0, 2e-4, 0.0, -1e-4, 0.0, 0.1, -0.16),
    ),
    "Scheimpflug, tilt alone": Camera.from_focal((800, 600), 900.0, lens=TiltedBrownConrady(tau_x=0.2)),
    "photogrammetric, barrel": Camera.from_focal(
        (2272, 1704), 2336.0, cx=1132.9, cy=819.0, lens=InverseBrownConrady(0.24, -0.1, 2e-4, 5e-4, 0.02)
    ),
    "photogrammetric, pincushion": Camera.from_focal((1280, 960), 1400.0, lens=InverseBrownConrady(-0.3)),
    "field of view": Camera.from_focal((640, 480), 360.0, lens=FieldOfView(0.93)),
    "extended unified": Camera.from_focal((1280, 960), 420.0, lens=ExtendedUnified(0.6, 1.1)),
    "double sphere": Camera.from_focal((512, 512), 150.0, lens=DoubleSphere(-0.2, 0.57)),
    "double sphere up to its pole": Camera.from_focal((512, 512), 150.0, lens=DoubleSphere(-0.5, 0.2)),
    "double sphere that ends early": Camera.from_focal((512, 512), 200.0, lens=DoubleSphere(-0.9, 0.7)),
}
