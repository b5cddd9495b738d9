"""Results that show themselves in a notebook, after `%load_ext cadcam`: tables as HTML, pictures as PNG.

IPython is told what to call for which class. So no class has to know of reports, and imports go on going down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from cadcam.arrays import Picture
from cadcam.calibrate.handeye.estimate import HandEyeEstimate
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.measurement import Measurement
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.camera.rig_estimate import RigEstimate
from cadcam.image.picture import covering, encoded
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.plan.layout import Layout
from cadcam.render.cutout import Cutout
from cadcam.render.lines.wireframe import Wireframe
from cadcam.render.overlay import overlay
from cadcam.render.view import View
from cadcam.report.camera import parameter_table
from cadcam.report.handeye import hand_eye_tables
from cadcam.report.joint import joint_tables
from cadcam.report.layout.words import layout_tables
from cadcam.report.locate import evidence_table, world_table
from cadcam.report.measure import points_table
from cadcam.report.page import cards, row
from cadcam.report.rig import rig_tables
from cadcam.report.table import Table
from cadcam.report.verify.words import verification_tables
from cadcam.verify.judge import Verification

_LONGEST = 960  # px: of a picture's longer side, wider than the columns of notebooks

TABLES: Mapping[type, Callable[[Any], Sequence[Table]]] = {
    CameraEstimate: lambda estimate: [parameter_table(estimate)],
    HandEyeEstimate: hand_eye_tables,
    JointEstimate: joint_tables,
    Layout: layout_tables,
    Location: lambda found: [evidence_table(found), world_table(found.pose)],
    Measurement: lambda measured: [points_table(measured)],
    PoseEstimate: lambda pose: [world_table(pose)],
    RigEstimate: rig_tables,
    Verification: verification_tables,
}
PICTURES: Mapping[type, Callable[[Any], Picture | None]] = {
    Cutout: lambda cutout: cutout.over((0.0, 0.0, 0.0)),
    Photo: lambda photo: photo.gray,
    View: lambda view: view.layers.get("image"),
    Wireframe: lambda lines: overlay(np.ones(lines.camera.size[::-1]), lines),
}


def show_results(shell: Any) -> None:
    """Tell an IPython shell how the results in `TABLES` and `PICTURES` are shown."""
    of = shell.display_formatter.formatters
    for kind, tables in TABLES.items():
        of["text/html"].for_type(kind, lambda result, tables=tables: "".join(map(as_html, tables(result))))
    for kind, picture in PICTURES.items():
        of["image/png"].for_type(kind, lambda result, picture=picture: as_png(picture(result)))


def as_html(table: Table) -> str:
    """Return the table as a piece of HTML."""
    rows = "".join(row(table.columns, [escape(cell) for cell in cells]) for cells in table.rows)
    notes = "".join(f"<p>{escape(note)}</p>" for note in table.notes)
    return f"<h4>{escape(table.title)}</h4>{cards(table.columns, rows) if rows else ''}{notes}"


def as_png(picture: Picture | None) -> bytes | None:
    """Return the picture as PNG, no larger than notebooks are wide; None for none."""
    if picture is None:
        return None
    height, width = picture.shape[:2]
    small = min(1.0, _LONGEST / max(height, width))
    size = (max(1, round(width * small)), max(1, round(height * small)))
    return encoded(picture if small == 1 else covering(picture, size, (0.5, 0.5)), "PNG")
