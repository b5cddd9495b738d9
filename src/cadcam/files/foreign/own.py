"""Our own camera file among the foreign formats, so that it converts to them and from them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cadcam.camera.lens import LENSES
from cadcam.files.camera import FORMAT as OWN
from cadcam.files.camera import camera_as_json, camera_file_of
from cadcam.files.foreign.model import Files, Foreign, Format, Holds, NamedCamera, WriteOptions
from cadcam.files.foreign.source import ForeignFile
from cadcam.files.jsontext import as_json


def recognises(source: ForeignFile) -> bool:
    """Return whether this is a camera file of ours, or one written by hand in its format."""
    head = source.head()
    return bool(re.search(rf'"format"\s*:\s*"{OWN}"', head)) or (
        head.lstrip().startswith("{") and '"size_px"' in head and ('"K_px"' in head or '"fx_px"' in head)
    )


def read(source: ForeignFile) -> Foreign:
    """Return the camera, with its estimate if it has one."""
    found = camera_file_of(source.text())
    return Foreign("cadcam", (NamedCamera("camera", found.camera, found.camera_from_world, found.estimate),))


def write(cameras: Sequence[NamedCamera], target: WriteOptions) -> Files:
    """Write one camera with its pose, or its estimate with all its data."""
    named = cameras[0]
    if named.estimate is not None:
        return {"": as_json(camera_as_json(named.estimate))}
    return {"": as_json(camera_as_json(named.camera, camera_from_world=named.camera_from_world))}


FORMAT = Format(
    name="cadcam",
    title="cadcam camera file",
    suffixes=(".json",),
    holds=Holds(
        {name: tuple(lens().parameters) for name, lens in LENSES.items()}, skew="yes", pose="yes", estimate=True
    ),
    recognises=recognises,
    read=read,
    write=write,
    unit="mm",
)
