"""cadcam: the virtual camera. From a calibration to a picture of the CAD model, and from a photo back to CAD.

Names are imported on first use, so that `import cadcam` costs next to nothing. docs/python.md lists them by what is to
be done; errors that a caller may want to tell apart are in `cadcam.errors`, all of them `CadcamError`s.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same table for type checkers and editors; tests hold the two together
    from cadcam import errors as errors
    from cadcam.cad.edges import EdgeKind as EdgeKind
    from cadcam.cad.edges import feature_edges as feature_edges
    from cadcam.cad.mesh import Mesh as Mesh
    from cadcam.cad.objects import mesh_of as mesh_of
    from cadcam.cad.pmi.read import read_pmi as read_pmi
    from cadcam.cad.read import read_model as read_model
    from cadcam.cad.read import read_model_with_report as read_model_with_report
    from cadcam.cad.write import write_model as write_model
    from cadcam.calibrate.boards.pictures import board_views as board_views
    from cadcam.calibrate.boards.pictures import calibrate_boards as calibrate_boards
    from cadcam.calibrate.boards.pictures import find_board as find_board
    from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye as calibrate_hand_eye
    from cadcam.calibrate.handeye.adjustment import calibrate_hand_eye_from_poses as calibrate_hand_eye_from_poses
    from cadcam.calibrate.handeye.document import read_hand_eye as read_hand_eye
    from cadcam.calibrate.handeye.document import write_hand_eye as write_hand_eye
    from cadcam.calibrate.handeye.estimate import HandEyeEstimate as HandEyeEstimate
    from cadcam.calibrate.joint.adjustment import calibrate_jointly as calibrate_jointly
    from cadcam.calibrate.joint.adjustment import fit_jointly as fit_jointly
    from cadcam.calibrate.joint.nested import nested_advice as nested_advice
    from cadcam.calibrate.measure.points import measure_points as measure_points
    from cadcam.calibrate.points.camera import calibrate_camera as calibrate_camera
    from cadcam.calibrate.points.camera import locate_camera as locate_camera
    from cadcam.calibrate.points.flat import calibrate_line as calibrate_line
    from cadcam.calibrate.points.flat import calibrate_plane as calibrate_plane
    from cadcam.calibrate.rig.adjustment import RigCamera as RigCamera
    from cadcam.calibrate.rig.adjustment import calibrate_rig as calibrate_rig
    from cadcam.calibrate.rig.boards import calibrate_rig_boards as calibrate_rig_boards
    from cadcam.calibrate.variability.alternating import alternating_externals as alternating_externals
    from cadcam.calibrate.variability.methods import first_order_variability as first_order_variability
    from cadcam.calibrate.variability.methods import markov_chain_variability as markov_chain_variability
    from cadcam.calibrate.variability.methods import monte_carlo_variability as monte_carlo_variability
    from cadcam.calibrate.variability.projection_map import projection_map as projection_map
    from cadcam.camera.aperture import Aperture as Aperture
    from cadcam.camera.camera import Camera as Camera
    from cadcam.camera.estimate import CameraEstimate as CameraEstimate
    from cadcam.camera.extended_pinhole import ExtendedPinhole as ExtendedPinhole
    from cadcam.camera.extended_pinhole import uv_from_pixel_matrix as uv_from_pixel_matrix
    from cadcam.camera.joint_estimate import JointEstimate as JointEstimate
    from cadcam.camera.lens import BrownConrady as BrownConrady
    from cadcam.camera.lens import Division as Division
    from cadcam.camera.lens import DoubleSphere as DoubleSphere
    from cadcam.camera.lens import ExtendedUnified as ExtendedUnified
    from cadcam.camera.lens import FieldOfView as FieldOfView
    from cadcam.camera.lens import Fisheye as Fisheye
    from cadcam.camera.lens import Ideal as Ideal
    from cadcam.camera.lens import InverseBrownConrady as InverseBrownConrady
    from cadcam.camera.lens import OddRadial as OddRadial
    from cadcam.camera.lens import TiltedBrownConrady as TiltedBrownConrady
    from cadcam.camera.line_camera import LineCamera as LineCamera
    from cadcam.camera.line_camera import LineObservations as LineObservations
    from cadcam.camera.measurement import Measurement as Measurement
    from cadcam.camera.observations import Observations as Observations
    from cadcam.camera.optics import Optics as Optics
    from cadcam.camera.optics import solve_optics as solve_optics
    from cadcam.camera.plane_camera import PlaneCamera as PlaneCamera
    from cadcam.camera.pose_estimate import PoseEstimate as PoseEstimate
    from cadcam.camera.rig_estimate import RigEstimate as RigEstimate
    from cadcam.camera.sensor_format import SensorFormat as SensorFormat
    from cadcam.camera.sensor_format import sensor_format as sensor_format
    from cadcam.camera.viewpoint import KnownMotion as KnownMotion
    from cadcam.camera.viewpoint import Viewpoint as Viewpoint
    from cadcam.dataset.make import make_dataset as make_dataset
    from cadcam.dataset.plan import DatasetPlan as DatasetPlan
    from cadcam.errors import CadcamError as CadcamError
    from cadcam.files.camera import CameraFile as CameraFile
    from cadcam.files.camera import read_camera as read_camera
    from cadcam.files.camera import write_camera as write_camera
    from cadcam.files.foreign.model import NamedCamera as NamedCamera
    from cadcam.files.foreign.registry import read_cameras as read_cameras
    from cadcam.files.foreign.registry import write_cameras as write_cameras
    from cadcam.files.foreign.viewers import viewer_parameters as viewer_parameters
    from cadcam.files.matrix import read_matrix as read_matrix
    from cadcam.files.matrix import read_motion as read_motion
    from cadcam.files.matrix import read_pose as read_pose
    from cadcam.files.pixels import read_pixels as read_pixels
    from cadcam.files.pixels import write_measurement as write_measurement
    from cadcam.files.points import read_points as read_points
    from cadcam.files.points import write_points as write_points
    from cadcam.files.pose_estimate import read_part_pose as read_part_pose
    from cadcam.files.pose_estimate import read_pose_estimate as read_pose_estimate
    from cadcam.files.pose_estimate import write_part_pose as write_part_pose
    from cadcam.files.poses import read_poses as read_poses
    from cadcam.files.poses import write_poses as write_poses
    from cadcam.files.rig import read_rig as read_rig
    from cadcam.files.rig import write_rig as write_rig
    from cadcam.files.robot_conventions import robot_numbers as robot_numbers
    from cadcam.files.robot_conventions import robot_poses as robot_poses
    from cadcam.files.robot_poses import read_robot_poses as read_robot_poses
    from cadcam.files.sensor import named_sensor as named_sensor
    from cadcam.files.sensor import read_sensor as read_sensor
    from cadcam.files.sensor import write_sensor as write_sensor
    from cadcam.fit.compare import compare_cameras as compare_cameras
    from cadcam.fit.robust import Loss as Loss
    from cadcam.geometry.plane import Plane as Plane
    from cadcam.geometry.ray import Ray as Ray
    from cadcam.geometry.rigid import Rigid as Rigid
    from cadcam.image.camera_picture import read_camera_picture as read_camera_picture
    from cadcam.image.correlate import CorrelateOptions as CorrelateOptions
    from cadcam.image.correlate import Peaks as Peaks
    from cadcam.image.correlate import correlate as correlate
    from cadcam.image.exr import write_exr as write_exr
    from cadcam.image.picture import read_picture as read_picture
    from cadcam.image.picture import to_gray as to_gray
    from cadcam.image.picture import write_picture as write_picture
    from cadcam.image.sensor.sensor import Sensor as Sensor
    from cadcam.image.template import Template as Template
    from cadcam.locate.evidence import LineEvidence as LineEvidence
    from cadcam.locate.evidence import PointEvidence as PointEvidence
    from cadcam.locate.evidence import PoseEvidence as PoseEvidence
    from cadcam.locate.freedom import Freedom as Freedom
    from cadcam.locate.in_photos import locate_part as locate_part
    from cadcam.locate.instances import locate_instances as locate_instances
    from cadcam.locate.location import Disagreement as Disagreement
    from cadcam.locate.location import Location as Location
    from cadcam.locate.match.closeness import Closeness as Closeness
    from cadcam.locate.match.closeness import ClosenessOptions as ClosenessOptions
    from cadcam.locate.match.closeness import edge_closeness as edge_closeness
    from cadcam.locate.match.salient import SalientOptions as SalientOptions
    from cadcam.locate.match.templates import TemplateMatches as TemplateMatches
    from cadcam.locate.match.templates import TemplateOptions as TemplateOptions
    from cadcam.locate.match.templates import match_templates as match_templates
    from cadcam.locate.part import Part as Part
    from cadcam.locate.photo import Photo as Photo
    from cadcam.locate.refine.options import EdgeOptions as EdgeOptions
    from cadcam.locate.refine.refinement import refine_pose as refine_pose
    from cadcam.locate.search.approach import Reach as Reach
    from cadcam.locate.track.frames import Frame as Frame
    from cadcam.locate.track.frames import Frames as Frames
    from cadcam.locate.track.log import TrackLog as TrackLog
    from cadcam.locate.track.log import read_track_log as read_track_log
    from cadcam.locate.track.log import track_part_to_log as track_part_to_log
    from cadcam.locate.track.tracker import track_part as track_part
    from cadcam.locate.views.resting import OnPlane as OnPlane
    from cadcam.locate.views.view_range import ViewRange as ViewRange
    from cadcam.plan.layout import Layout as Layout
    from cadcam.plan.layout import next_cameras as next_cameras
    from cadcam.plan.layout import plan_layout as plan_layout
    from cadcam.plan.scene.file import read_layout_scene as read_layout_scene
    from cadcam.plan.scene.layout_scene import LayoutScene as LayoutScene
    from cadcam.plan.uncertainty.predict import Prediction as Prediction
    from cadcam.plan.uncertainty.predict import predict_points as predict_points
    from cadcam.plan.what_if import what_if as what_if
    from cadcam.record.export import read_records as read_records
    from cadcam.record.export import write_records as write_records
    from cadcam.record.record import Deviation as Deviation
    from cadcam.record.record import Finding as Finding
    from cadcam.record.record import Record as Record
    from cadcam.record.record import Source as Source
    from cadcam.record.store import open_store as open_store
    from cadcam.record.trend import trend as trend
    from cadcam.record.trend import trends as trends
    from cadcam.render import open_renderer as open_renderer
    from cadcam.render.cutout import Cutout as Cutout
    from cadcam.render.light import Lamp as Lamp
    from cadcam.render.light import Light as Light
    from cadcam.render.light import named_light as named_light
    from cadcam.render.lines.visible import visible_wireframe as visible_wireframe
    from cadcam.render.lines.wireframe import LineOptions as LineOptions
    from cadcam.render.lines.wireframe import Wireframe as Wireframe
    from cadcam.render.looks import named_look as named_look
    from cadcam.render.looks import repaint as repaint
    from cadcam.render.overlay import LineStyle as LineStyle
    from cadcam.render.overlay import add_pictures as add_pictures
    from cadcam.render.overlay import blend_pictures as blend_pictures
    from cadcam.render.overlay import edge_distances as edge_distances
    from cadcam.render.overlay import overlay as overlay
    from cadcam.render.overlay import overlay_on_edges as overlay_on_edges
    from cadcam.render.overlay import side_by_side as side_by_side
    from cadcam.render.overlay import write_overlay_svg as write_overlay_svg
    from cadcam.render.photograph import Photographer as Photographer
    from cadcam.render.standard_view import standard_view as standard_view
    from cadcam.render.view import Channel as Channel
    from cadcam.render.view import Look as Look
    from cadcam.render.view import Scene as Scene
    from cadcam.report.pick.page import write_pick_page as write_pick_page
    from cadcam.report.state.page import write_state_page as write_state_page
    from cadcam.report.verify.json import VerificationOrigin as VerificationOrigin
    from cadcam.report.verify.json import record_of as record_of
    from cadcam.report.verify.page import write_verification_page as write_verification_page
    from cadcam.station.document import read_plate as read_plate
    from cadcam.station.document import read_station as read_station
    from cadcam.station.document import read_stations as read_stations
    from cadcam.station.document import write_plate as write_plate
    from cadcam.station.document import write_station as write_station
    from cadcam.station.gantry import GantryCalibration as GantryCalibration
    from cadcam.station.gantry import Sighting as Sighting
    from cadcam.station.gantry import calibrate_gantry as calibrate_gantry
    from cadcam.station.measure import measure_marks as measure_marks
    from cadcam.station.plane import calibrate_position as calibrate_position
    from cadcam.station.plate import Plate as Plate
    from cadcam.station.plate import place_plate as place_plate
    from cadcam.target.boards.pattern import parse_pattern as parse_pattern
    from cadcam.target.marks.find import FoundMark as FoundMark
    from cadcam.target.marks.find import MarkOptions as MarkOptions
    from cadcam.target.marks.find import find_marks as find_marks
    from cadcam.target.marks.mark import Mark as Mark
    from cadcam.target.marks.mark import parse_mark as parse_mark
    from cadcam.target.order.ordering import Ordering as Ordering
    from cadcam.target.order.ordering import order_marks as order_marks
    from cadcam.verify.inspection import InspectionOptions as InspectionOptions
    from cadcam.verify.judge import Verification as Verification
    from cadcam.verify.judge import verify_part as verify_part
    from cadcam.verify.tolerances.drawing import drawing_template as drawing_template
    from cadcam.verify.tolerances.file import read_tolerances as read_tolerances
    from cadcam.verify.tolerances.tolerance import Tolerances as Tolerances
    from cadcam.verify.tolerances.tolerance import whole_parts as whole_parts

__version__ = "0.1.0"

_HOME = {
    "Aperture": "cadcam.camera.aperture",
    "BrownConrady": "cadcam.camera.lens",
    "CadcamError": "cadcam.errors",
    "Camera": "cadcam.camera.camera",
    "CameraEstimate": "cadcam.camera.estimate",
    "CameraFile": "cadcam.files.camera",
    "Channel": "cadcam.render.view",
    "Closeness": "cadcam.locate.match.closeness",
    "ClosenessOptions": "cadcam.locate.match.closeness",
    "CorrelateOptions": "cadcam.image.correlate",
    "Cutout": "cadcam.render.cutout",
    "DatasetPlan": "cadcam.dataset.plan",
    "Deviation": "cadcam.record.record",
    "Disagreement": "cadcam.locate.location",
    "Division": "cadcam.camera.lens",
    "DoubleSphere": "cadcam.camera.lens",
    "EdgeKind": "cadcam.cad.edges",
    "EdgeOptions": "cadcam.locate.refine.options",
    "ExtendedPinhole": "cadcam.camera.extended_pinhole",
    "ExtendedUnified": "cadcam.camera.lens",
    "FieldOfView": "cadcam.camera.lens",
    "Finding": "cadcam.record.record",
    "Fisheye": "cadcam.camera.lens",
    "FoundMark": "cadcam.target.marks.find",
    "Frame": "cadcam.locate.track.frames",
    "Frames": "cadcam.locate.track.frames",
    "Freedom": "cadcam.locate.freedom",
    "GantryCalibration": "cadcam.station.gantry",
    "HandEyeEstimate": "cadcam.calibrate.handeye.estimate",
    "Ideal": "cadcam.camera.lens",
    "InspectionOptions": "cadcam.verify.inspection",
    "InverseBrownConrady": "cadcam.camera.lens",
    "JointEstimate": "cadcam.camera.joint_estimate",
    "KnownMotion": "cadcam.camera.viewpoint",
    "Lamp": "cadcam.render.light",
    "Layout": "cadcam.plan.layout",
    "LayoutScene": "cadcam.plan.scene.layout_scene",
    "Light": "cadcam.render.light",
    "LineCamera": "cadcam.camera.line_camera",
    "LineEvidence": "cadcam.locate.evidence",
    "LineObservations": "cadcam.camera.line_camera",
    "LineOptions": "cadcam.render.lines.wireframe",
    "LineStyle": "cadcam.render.overlay",
    "Location": "cadcam.locate.location",
    "Look": "cadcam.render.view",
    "Loss": "cadcam.fit.robust",
    "Mark": "cadcam.target.marks.mark",
    "MarkOptions": "cadcam.target.marks.find",
    "Measurement": "cadcam.camera.measurement",
    "Mesh": "cadcam.cad.mesh",
    "NamedCamera": "cadcam.files.foreign.model",
    "Observations": "cadcam.camera.observations",
    "OddRadial": "cadcam.camera.lens",
    "OnPlane": "cadcam.locate.views.resting",
    "Optics": "cadcam.camera.optics",
    "Ordering": "cadcam.target.order.ordering",
    "Part": "cadcam.locate.part",
    "Peaks": "cadcam.image.correlate",
    "Photo": "cadcam.locate.photo",
    "Photographer": "cadcam.render.photograph",
    "Plane": "cadcam.geometry.plane",
    "PlaneCamera": "cadcam.camera.plane_camera",
    "Plate": "cadcam.station.plate",
    "PointEvidence": "cadcam.locate.evidence",
    "PoseEstimate": "cadcam.camera.pose_estimate",
    "PoseEvidence": "cadcam.locate.evidence",
    "Prediction": "cadcam.plan.uncertainty.predict",
    "Ray": "cadcam.geometry.ray",
    "Reach": "cadcam.locate.search.approach",
    "Record": "cadcam.record.record",
    "RigCamera": "cadcam.calibrate.rig.adjustment",
    "RigEstimate": "cadcam.camera.rig_estimate",
    "Rigid": "cadcam.geometry.rigid",
    "SalientOptions": "cadcam.locate.match.salient",
    "Scene": "cadcam.render.view",
    "Sensor": "cadcam.image.sensor.sensor",
    "SensorFormat": "cadcam.camera.sensor_format",
    "Sighting": "cadcam.station.gantry",
    "Source": "cadcam.record.record",
    "Template": "cadcam.image.template",
    "TemplateMatches": "cadcam.locate.match.templates",
    "TemplateOptions": "cadcam.locate.match.templates",
    "TiltedBrownConrady": "cadcam.camera.lens",
    "Tolerances": "cadcam.verify.tolerances.tolerance",
    "TrackLog": "cadcam.locate.track.log",
    "Verification": "cadcam.verify.judge",
    "VerificationOrigin": "cadcam.report.verify.json",
    "ViewRange": "cadcam.locate.views.view_range",
    "Viewpoint": "cadcam.camera.viewpoint",
    "Wireframe": "cadcam.render.lines.wireframe",
    "add_pictures": "cadcam.render.overlay",
    "alternating_externals": "cadcam.calibrate.variability.alternating",
    "blend_pictures": "cadcam.render.overlay",
    "board_views": "cadcam.calibrate.boards.pictures",
    "calibrate_boards": "cadcam.calibrate.boards.pictures",
    "calibrate_camera": "cadcam.calibrate.points.camera",
    "calibrate_gantry": "cadcam.station.gantry",
    "calibrate_hand_eye": "cadcam.calibrate.handeye.adjustment",
    "calibrate_hand_eye_from_poses": "cadcam.calibrate.handeye.adjustment",
    "calibrate_jointly": "cadcam.calibrate.joint.adjustment",
    "calibrate_line": "cadcam.calibrate.points.flat",
    "calibrate_plane": "cadcam.calibrate.points.flat",
    "calibrate_position": "cadcam.station.plane",
    "calibrate_rig": "cadcam.calibrate.rig.adjustment",
    "calibrate_rig_boards": "cadcam.calibrate.rig.boards",
    "compare_cameras": "cadcam.fit.compare",
    "correlate": "cadcam.image.correlate",
    "drawing_template": "cadcam.verify.tolerances.drawing",
    "edge_closeness": "cadcam.locate.match.closeness",
    "edge_distances": "cadcam.render.overlay",
    "errors": "cadcam",
    "feature_edges": "cadcam.cad.edges",
    "find_board": "cadcam.calibrate.boards.pictures",
    "find_marks": "cadcam.target.marks.find",
    "first_order_variability": "cadcam.calibrate.variability.methods",
    "fit_jointly": "cadcam.calibrate.joint.adjustment",
    "locate_camera": "cadcam.calibrate.points.camera",
    "locate_instances": "cadcam.locate.instances",
    "locate_part": "cadcam.locate.in_photos",
    "make_dataset": "cadcam.dataset.make",
    "markov_chain_variability": "cadcam.calibrate.variability.methods",
    "match_templates": "cadcam.locate.match.templates",
    "measure_marks": "cadcam.station.measure",
    "measure_points": "cadcam.calibrate.measure.points",
    "mesh_of": "cadcam.cad.objects",
    "monte_carlo_variability": "cadcam.calibrate.variability.methods",
    "named_light": "cadcam.render.light",
    "named_look": "cadcam.render.looks",
    "named_sensor": "cadcam.files.sensor",
    "nested_advice": "cadcam.calibrate.joint.nested",
    "next_cameras": "cadcam.plan.layout",
    "open_renderer": "cadcam.render",
    "open_store": "cadcam.record.store",
    "order_marks": "cadcam.target.order.ordering",
    "overlay": "cadcam.render.overlay",
    "overlay_on_edges": "cadcam.render.overlay",
    "parse_mark": "cadcam.target.marks.mark",
    "parse_pattern": "cadcam.target.boards.pattern",
    "place_plate": "cadcam.station.plate",
    "plan_layout": "cadcam.plan.layout",
    "predict_points": "cadcam.plan.uncertainty.predict",
    "projection_map": "cadcam.calibrate.variability.projection_map",
    "read_camera": "cadcam.files.camera",
    "read_camera_picture": "cadcam.image.camera_picture",
    "read_cameras": "cadcam.files.foreign.registry",
    "read_hand_eye": "cadcam.calibrate.handeye.document",
    "read_layout_scene": "cadcam.plan.scene.file",
    "read_matrix": "cadcam.files.matrix",
    "read_model": "cadcam.cad.read",
    "read_model_with_report": "cadcam.cad.read",
    "read_motion": "cadcam.files.matrix",
    "read_part_pose": "cadcam.files.pose_estimate",
    "read_picture": "cadcam.image.picture",
    "read_pixels": "cadcam.files.pixels",
    "read_plate": "cadcam.station.document",
    "read_pmi": "cadcam.cad.pmi.read",
    "read_points": "cadcam.files.points",
    "read_pose": "cadcam.files.matrix",
    "read_pose_estimate": "cadcam.files.pose_estimate",
    "read_poses": "cadcam.files.poses",
    "read_records": "cadcam.record.export",
    "read_rig": "cadcam.files.rig",
    "read_robot_poses": "cadcam.files.robot_poses",
    "read_sensor": "cadcam.files.sensor",
    "read_station": "cadcam.station.document",
    "read_stations": "cadcam.station.document",
    "read_tolerances": "cadcam.verify.tolerances.file",
    "read_track_log": "cadcam.locate.track.log",
    "record_of": "cadcam.report.verify.json",
    "refine_pose": "cadcam.locate.refine.refinement",
    "repaint": "cadcam.render.looks",
    "robot_numbers": "cadcam.files.robot_conventions",
    "robot_poses": "cadcam.files.robot_conventions",
    "sensor_format": "cadcam.camera.sensor_format",
    "side_by_side": "cadcam.render.overlay",
    "solve_optics": "cadcam.camera.optics",
    "standard_view": "cadcam.render.standard_view",
    "to_gray": "cadcam.image.picture",
    "track_part": "cadcam.locate.track.tracker",
    "track_part_to_log": "cadcam.locate.track.log",
    "trend": "cadcam.record.trend",
    "trends": "cadcam.record.trend",
    "uv_from_pixel_matrix": "cadcam.camera.extended_pinhole",
    "verify_part": "cadcam.verify.judge",
    "viewer_parameters": "cadcam.files.foreign.viewers",
    "visible_wireframe": "cadcam.render.lines.visible",
    "what_if": "cadcam.plan.what_if",
    "whole_parts": "cadcam.verify.tolerances.tolerance",
    "write_camera": "cadcam.files.camera",
    "write_cameras": "cadcam.files.foreign.registry",
    "write_exr": "cadcam.image.exr",
    "write_hand_eye": "cadcam.calibrate.handeye.document",
    "write_measurement": "cadcam.files.pixels",
    "write_model": "cadcam.cad.write",
    "write_overlay_svg": "cadcam.render.overlay",
    "write_pick_page": "cadcam.report.pick.page",
    "write_part_pose": "cadcam.files.pose_estimate",
    "write_picture": "cadcam.image.picture",
    "write_plate": "cadcam.station.document",
    "write_points": "cadcam.files.points",
    "write_poses": "cadcam.files.poses",
    "write_records": "cadcam.record.export",
    "write_rig": "cadcam.files.rig",
    "write_sensor": "cadcam.files.sensor",
    "write_station": "cadcam.station.document",
    "write_state_page": "cadcam.report.state.page",
    "write_verification_page": "cadcam.report.verify.page",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'cadcam' has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    home = _HOME[name]
    return import_module(f"cadcam.{name}") if home == __name__ else getattr(import_module(home), name)


def load_ipython_extension(shell: Any) -> None:
    """Let results show themselves in a notebook, as tables and pictures: what `%load_ext cadcam` calls."""
    import_module("cadcam.report.notebook").show_results(shell)


def __dir__() -> list[str]:
    return sorted(__all__)
