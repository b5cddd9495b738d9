"""cadcam: the virtual camera. From a calibration to a picture of the CAD model, and from a photo back to CAD.

Names are imported on first use, so that `import cadcam` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same table for type checkers and editors; tests/project holds the two together
    from cadcam.cad.edges import EdgeKind as EdgeKind
    from cadcam.cad.edges import feature_edges as feature_edges
    from cadcam.cad.load import load as load
    from cadcam.cad.load import load_with_report as load_with_report
    from cadcam.cad.mesh import Mesh as Mesh
    from cadcam.calibrate.handeye import calibrate_hand_eye as calibrate_hand_eye
    from cadcam.calibrate.handeye import calibrate_hand_eye_from_poses as calibrate_hand_eye_from_poses
    from cadcam.calibrate.handeye_estimate import HandEyeEstimate as HandEyeEstimate
    from cadcam.calibrate.points import calibrate as _calibrate
    from cadcam.calibrate.points import locate_camera as locate_camera
    from cadcam.camera.camera import Camera as Camera
    from cadcam.camera.estimate import CameraEstimate as CameraEstimate
    from cadcam.camera.extended_pinhole import ExtendedPinhole as ExtendedPinhole
    from cadcam.camera.extended_pinhole import uv_from_pixel_matrix as uv_from_pixel_matrix
    from cadcam.camera.lens import BrownConrady as BrownConrady
    from cadcam.camera.lens import Division as Division
    from cadcam.camera.lens import Fisheye as Fisheye
    from cadcam.camera.lens import Ideal as Ideal
    from cadcam.camera.lens import OddRadial as OddRadial
    from cadcam.camera.observations import Observations as Observations
    from cadcam.errors import CadcamError as CadcamError
    from cadcam.files.camera import CameraFile as CameraFile
    from cadcam.files.camera import read_camera as read_camera
    from cadcam.files.camera import write_camera as write_camera
    from cadcam.files.matrix import read_matrix as read_matrix
    from cadcam.files.matrix import read_pose as read_pose
    from cadcam.files.points import read_points as read_points
    from cadcam.files.points import write_points as write_points
    from cadcam.files.poses import read_poses as read_poses
    from cadcam.files.poses import write_poses as write_poses
    from cadcam.files.robot_poses import read_robot_poses as read_robot_poses
    from cadcam.geometry.rigid import Rigid as Rigid
    from cadcam.image.exr import write_exr as write_exr
    from cadcam.image.picture import read_picture as read_picture
    from cadcam.image.picture import write_picture as write_picture
    from cadcam.render import open_renderer as open_renderer
    from cadcam.render.cutout import Cutout as Cutout
    from cadcam.render.looks import named_look as named_look
    from cadcam.render.looks import repainted as repainted
    from cadcam.render.overlay import LineStyle as LineStyle
    from cadcam.render.overlay import added as added
    from cadcam.render.overlay import blended as blended
    from cadcam.render.overlay import edge_distances as edge_distances
    from cadcam.render.overlay import over_edges as over_edges
    from cadcam.render.overlay import overlay as overlay
    from cadcam.render.overlay import side_by_side as side_by_side
    from cadcam.render.overlay import write_overlay_svg as write_overlay_svg
    from cadcam.render.standard_view import standard_view as standard_view
    from cadcam.render.view import Channel as Channel
    from cadcam.render.view import Look as Look
    from cadcam.render.view import Scene as Scene
    from cadcam.render.visible import visible_wireframe as visible_wireframe
    from cadcam.render.wireframe import LineOptions as LineOptions
    from cadcam.render.wireframe import Wireframe as Wireframe

    calibrate_camera = _calibrate  # `cadcam.calibrate` is the package

__version__ = "0.1.0"

_HOME = {
    "BrownConrady": "cadcam.camera.lens",
    "CadcamError": "cadcam.errors",
    "Camera": "cadcam.camera.camera",
    "CameraEstimate": "cadcam.camera.estimate",
    "CameraFile": "cadcam.files.camera",
    "Channel": "cadcam.render.view",
    "Cutout": "cadcam.render.cutout",
    "Division": "cadcam.camera.lens",
    "EdgeKind": "cadcam.cad.edges",
    "ExtendedPinhole": "cadcam.camera.extended_pinhole",
    "Fisheye": "cadcam.camera.lens",
    "HandEyeEstimate": "cadcam.calibrate.handeye_estimate",
    "Ideal": "cadcam.camera.lens",
    "LineOptions": "cadcam.render.wireframe",
    "LineStyle": "cadcam.render.overlay",
    "Look": "cadcam.render.view",
    "Mesh": "cadcam.cad.mesh",
    "Observations": "cadcam.camera.observations",
    "OddRadial": "cadcam.camera.lens",
    "Rigid": "cadcam.geometry.rigid",
    "Scene": "cadcam.render.view",
    "Wireframe": "cadcam.render.wireframe",
    "added": "cadcam.render.overlay",
    "blended": "cadcam.render.overlay",
    "calibrate_camera": "cadcam.calibrate.points:calibrate",
    "calibrate_hand_eye": "cadcam.calibrate.handeye",
    "calibrate_hand_eye_from_poses": "cadcam.calibrate.handeye",
    "edge_distances": "cadcam.render.overlay",
    "feature_edges": "cadcam.cad.edges",
    "load": "cadcam.cad.load",
    "load_with_report": "cadcam.cad.load",
    "locate_camera": "cadcam.calibrate.points",
    "named_look": "cadcam.render.looks",
    "open_renderer": "cadcam.render",
    "over_edges": "cadcam.render.overlay",
    "overlay": "cadcam.render.overlay",
    "read_camera": "cadcam.files.camera",
    "read_matrix": "cadcam.files.matrix",
    "read_picture": "cadcam.image.picture",
    "read_points": "cadcam.files.points",
    "read_pose": "cadcam.files.matrix",
    "read_poses": "cadcam.files.poses",
    "read_robot_poses": "cadcam.files.robot_poses",
    "repainted": "cadcam.render.looks",
    "side_by_side": "cadcam.render.overlay",
    "standard_view": "cadcam.render.standard_view",
    "uv_from_pixel_matrix": "cadcam.camera.extended_pinhole",
    "visible_wireframe": "cadcam.render.visible",
    "write_camera": "cadcam.files.camera",
    "write_exr": "cadcam.image.exr",
    "write_overlay_svg": "cadcam.render.overlay",
    "write_picture": "cadcam.image.picture",
    "write_points": "cadcam.files.points",
    "write_poses": "cadcam.files.poses",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'cadcam' has no attribute {name!r}")
    module, _, original = _HOME[name].partition(":")
    return getattr(import_module(module), original or name)


def __dir__() -> list[str]:
    return sorted(__all__)
