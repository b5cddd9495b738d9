"""Two scenes to start from: the ship block under four fixed cameras at 6 m; one camera that a robot carries."""

from __future__ import annotations

from pathlib import Path

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import ship_block
from cadcam.cad.write import write_model
from cadcam.errors import UnwritableFile
from cadcam.whole import write_whole

MODEL, FIXED, ROBOT = "shipblock.obj", "four_fixed.yaml", "six_stations.yaml"

_FEATURES = """\
features:                # limits as in the tolerance file of `cadcam verify`
  corner port aft: {point_mm: [0, 0, 12], position_mm: 1.5}
  corner port fore: {point_mm: [4000, 0, 12], position_mm: 1.5}
  tank top aft: {circle_mm: [350, 150, 12], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1.2}
  tank top middle: {circle_mm: [1350, 150, 12], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1.2}
  tank top fore: {circle_mm: [2650, 150, 12], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1.2}
  shell aft: {circle_mm: [600, 2200, 2000], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1.2}
  shell fore: {circle_mm: [3400, 2200, 2000], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1.2}
  height of the shell: {circle_mm: [2000, 1800, 2000], normal: [0, 0, 1], diameter_mm: 40, position_mm: 1,
                        direction: [0, 0, 1]}
  edge of the tank top: {edge_mm: [[200, 0, 12], [3800, 0, 12]], position_mm: 1.2, angle_deg: 0.05}
  edge of the shell: {edge_mm: [[200, 1493, 2000], [3800, 1493, 2000]], position_mm: 1.2, angle_deg: 0.05}
"""
_FIXED = """\
# Four fixed cameras, some 6 m from a ship's double-bottom block: mm and degrees; the world's z axis is up.
part: {model: shipblock.obj, unit: mm}
poses:                   # where the block may lie on its blocking
  nominal: {position_mm: [0, 0, 0]}
  shifted: {position_mm: [50, -30, 0], rotation_deg: [0, 0, 2]}
cameras:
  12 mm: {sensor: IMX304, focal_mm: 12, f_number: 8, image_circle_mm: 17.6}
  16 mm: {sensor: IMX304, focal_mm: 16, f_number: 8, image_circle_mm: 17.6}
mounts:
  gallery: {box_mm: [[-1500, -4200, 2600], [5500, -3400, 4600]], count: 36, aim_mm: [2000, 1200, 900]}
  columns: {positions_mm: [[-2600, -2200, 3900], [6600, -2200, 3900], [-2600, 3800, 4900], [6600, 3800, 4900]],
            aim_mm: [2000, 1200, 900]}
"""
_ROBOT = """\
# One camera that a robot carries to six stations around a ship's double-bottom block: it was calibrated at the first,
# so its calibration errs alike at all of them, and each motion by itself.
part: {model: shipblock.obj, unit: mm}
cameras:
  on the flange: {sensor: IMX264, focal_mm: 8, f_number: 8}
mounts:
  robot: {arc: {center_mm: [2000, 1200, 4800], radius_mm: 4000, from_deg: 190, to_deg: 350}, count: 17,
          aim_mm: [2000, 1000, 700], one_camera: true}
motion: {position_mm: 0.1, rotation_deg: 0.002}
"""
_ASSUMED = """\
noise: {sigma_px: 0.1, gray: 0.01, contrast: 0.3}
calibration: {points: 40, sigma_px: 0.1, points_mm: 0.1}   # each camera, from points over its picture and the depth
k: 2
tur: 3                   # limit/U that every limit should reach
"""


def sample_part() -> Mesh:
    """Return the ship block of the samples."""
    return ship_block(triangles=10_000)


def write_samples(folder: str | Path) -> tuple[Path, ...]:
    """Write the block and the two scenes into a folder; return the files."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableFile(folder, error.strerror or str(error), "name another folder") from error
    write_model(folder / MODEL, sample_part())
    texts = {FIXED: _FIXED + _FEATURES + _ASSUMED + "choose: 4\n", ROBOT: _ROBOT + _FEATURES + _ASSUMED + "choose: 6\n"}
    for name, text in texts.items():
        write_whole(folder / name, text.encode())
    return folder / MODEL, folder / FIXED, folder / ROBOT
