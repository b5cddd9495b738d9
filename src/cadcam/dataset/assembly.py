"""The records of all views, combined as BOP and COCO require: one file per scene, and one for all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cadcam.dataset.layout import OBJECT, VIEWS_A_SCENE, DatasetFiles
from cadcam.errors import UnreadableFile
from cadcam.whole import write_whole

_BOP = {"camera": "scene_camera.json", "gt": "scene_gt.json", "info": "scene_gt_info.json"}


def read_record(folder: Path, layout: DatasetFiles, index: int) -> dict[str, Any]:
    """Return the record of a view. Raises `UnreadableFile`."""
    path = folder / layout.path("view", index)
    try:
        record: dict[str, Any] = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UnreadableFile(path, f"cannot be read ({error})", "remove it and run the same command again") from None
    return record


def assemble(folder: Path, layout: DatasetFiles, views: int, *, name: str, key_points: tuple[str, ...]) -> list[float]:
    """Write BOP's files of every scene and COCO's of all views; return the visible share of the part in each view."""
    visible: list[float] = []
    images: list[str] = []
    annotations: list[str] = []
    for first in range(0, views, VIEWS_A_SCENE):
        records = [read_record(folder, layout, i) for i in range(first, min(first + VIEWS_A_SCENE, views))]
        scene = folder / layout.scene(first // VIEWS_A_SCENE)
        for key, file in _BOP.items():
            write_whole(scene / file, _bop(records, key))
        for record in records:
            visible.append(record["bop"]["info"]["visib_fract"])
            images.append(_text(_image(record, layout)))
            if record["coco"] is not None:
                annotations.append(_text(_annotation(record)))
    category = {"id": OBJECT, "name": name, "supercategory": "part", "keypoints": list(key_points), "skeleton": []}
    info = {"description": f"{name}, rendered and labelled by cadcam", "version": "1.0"}
    sections = {"info": _text(info), "licenses": "[]", "categories": _list([_text(category)])}
    sections |= {"images": _list(images), "annotations": _list(annotations)}
    body = ",\n".join(f'"{key}": {value}' for key, value in sections.items())
    write_whole(folder / layout.coco, f"{{{body}}}\n".encode())
    return visible


def _bop(records: list[dict[str, Any]], key: str) -> bytes:
    """Return a file of a scene: one entry per picture; labels are in a list of objects, of which there is one."""
    entries = ((r["view"] % VIEWS_A_SCENE, r["bop"][key]) for r in records)
    lines = [f'"{image}": {_text(entry if key == "camera" else [entry])}' for image, entry in entries]
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def _image(record: dict[str, Any], layout: DatasetFiles) -> dict[str, Any]:
    width, height = record["camera"]["size_px"]
    path = layout.path(layout.picture, record["view"])
    return {"id": record["view"], "file_name": path, "width": width, "height": height}


def _annotation(record: dict[str, Any]) -> dict[str, Any]:
    return {"id": record["view"] + 1, "image_id": record["view"], "category_id": OBJECT, **record["coco"]}


def _text(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def _list(items: list[str]) -> str:
    return "[" + ",\n".join(items) + "]"
