"""Readers that know nothing of cadcam read what BOP and COCO say is there, and its poses reproject.

BOP is read as its toolkit documents it (github.com/thodan/bop_toolkit, docs/bop_datasets_format.md) with json, Pillow
and trimesh; COCO's run lengths are unrolled here, and by pycocotools where it is installed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from cadcam.dataset.make import make_dataset
from cadcam.dataset.record import run_lengths

from .sets import HALF, plan, scene

VIEWS = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("formats") / "set"
    make_dataset(folder, scene(), plan(VIEWS, center_jitter_px=2.0), workers=2, name="block")
    return folder


def loaded(path: Path) -> Any:
    return json.loads(path.read_text())


def bop(folder: Path) -> list[tuple[int, dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """Return (picture, camera, pose, info) of a scene, keys turned to numbers as the toolkit does."""
    scene_folder = folder / "train/000000"
    camera, gt, info = (loaded(scene_folder / f"scene_{name}.json") for name in ("camera", "gt", "gt_info"))
    assert list(camera) == list(gt) == list(info) == [str(i) for i in range(VIEWS)]
    assert all(len(entry) == 1 for entry in (*gt.values(), *info.values()))
    return [(int(key), camera[key], gt[key][0], info[key][0]) for key in gt]


def arrays(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return dict(file)


def picture(folder: Path, kind: str, index: int, tail: str = "") -> np.ndarray[Any, Any]:
    with Image.open(folder / f"train/000000/{kind}/{index:06d}{tail}.png") as image:
        return np.asarray(image)


def matrices(camera: dict[str, Any], pose: dict[str, Any]) -> tuple[np.ndarray[Any, Any], ...]:
    K, R = (np.array(v).reshape(3, 3) for v in (camera["cam_K"], pose["cam_R_m2c"]))
    return K, R, np.array(pose["cam_t_m2c"])


def test_the_model_projected_by_the_poses_fills_the_boxes(made: Path) -> None:
    """The outermost pixel centres inside a silhouette lie within a pixel of the outermost vertices."""
    model = trimesh.load(made / "models/obj_000001.ply", process=False)
    checked = 0
    for _, camera, pose, info in bop(made):
        assert pose["obj_id"] == 1
        K, R, t = matrices(camera, pose)
        q = (model.vertices @ R.T + t) @ K.T
        q = q[:, :2] / q[:, 2:]
        if info["bbox_obj"][0] == -1 or (q < -90).any() or (q > 180).any():
            continue
        x, y, w, h = info["bbox_obj"]
        low, high = q.min(axis=0), q.max(axis=0)
        assert (low <= (x, y)).all()
        assert ((x + w, y + h) <= high).all()
        assert np.abs(np.array([x, y]) - low).max() < 2.0  # a corner of 70 degrees is a pixel wide 0.7 px below its tip
        assert np.abs(np.array([x + w, y + h]) - high).max() < 2.0
        checked += 1
    assert checked >= 3


def test_depth_taken_into_the_model_lies_on_it(made: Path) -> None:
    """Half a step of depth along the ray: the ray's slope makes it at most 1.3 times as long here."""
    for index, camera, pose, info in bop(made):
        K, R, t = matrices(camera, pose)
        depth = picture(made, "depth", index).astype(float) * camera["depth_scale"]
        seen = picture(made, "mask_visib", index, "_000000") > 0
        assert seen.sum() == info["px_count_visib"]
        y, x = np.nonzero(seen)
        rays = np.column_stack([x, y, np.ones(len(x))]) @ np.linalg.inv(K).T
        own = (rays * depth[seen][:, None] - t) @ R
        off = np.max(np.abs(own) - HALF, axis=1)
        assert np.abs(off).max(initial=0.0) <= 1.3 * 0.5 * camera["depth_scale"] + 1e-4


def test_pictures_are_of_the_types_that_bop_reads(made: Path) -> None:
    for index, *_ in bop(made):
        assert picture(made, "rgb", index).shape == (72, 96, 3)
        assert picture(made, "depth", index).dtype == np.uint16
        full, seen = (picture(made, kind, index, "_000000") for kind in ("mask", "mask_visib"))
        assert (full.dtype, full.shape) == (np.uint8, (72, 96))
        assert set(np.unique(full)) <= {0, 255}
        assert not ((seen > 0) & (full == 0)).any()


def test_the_info_counts_what_the_masks_show(made: Path) -> None:
    for index, _, _, info in bop(made):
        full, seen = (picture(made, kind, index, "_000000") > 0 for kind in ("mask", "mask_visib"))
        assert info["px_count_valid"] == full.sum()
        assert info["px_count_all"] >= full.sum()
        assert info["visib_fract"] == pytest.approx(seen.sum() / info["px_count_all"])
        if seen.any():
            y, x = np.nonzero(seen)
            assert info["bbox_visib"] == [x.min(), y.min(), np.ptp(x), np.ptp(y)]


def test_the_models_info_is_the_boxs_own(made: Path) -> None:
    info = loaded(made / "models/models_info.json")["1"]
    assert info["diameter"] == pytest.approx(2 * np.linalg.norm(HALF), rel=1e-12)
    assert [info[f"min_{a}"] for a in "xyz"] == (-HALF).tolist()
    assert [info[f"size_{a}"] for a in "xyz"] == (2 * HALF).tolist()


def test_normals_and_edges_are_told_as_documented(made: Path) -> None:
    """A normal coded in bytes is one of the box's six, to the rounding; an edge's pixels are the CAD edge's own."""
    model = arrays(made / "models/obj_000001_edges.npz")
    for index, camera, pose, _ in bop(made):
        K, R, t = matrices(camera, pose)
        seen = picture(made, "mask_visib", index, "_000000") > 0
        own = (picture(made, "normal", index)[seen].astype(float) / 127.5 - 1) @ R
        axes = np.round(own)
        assert (np.abs(axes).sum(axis=1) == 1).all()
        assert np.abs(own - axes).max(initial=0) < np.sqrt(3) / 127.5
        edges = arrays(made / f"train/000000/edges/{index:06d}.npz")
        for number, first, last in zip(edges["edge"], edges["start"][:-1], edges["start"][1:], strict=True):
            at = int(np.flatnonzero(model["edge"] == number)[0])
            a, b = (model["p"][model["start"][at] : model["start"][at + 1]] @ R.T + t)[[0, -1]] @ K.T
            a, b = a[:2] / a[2], b[:2] / b[2]
            d = edges["q"][first:last] - a
            off = d[:, 0] * (b - a)[1] - d[:, 1] * (b - a)[0]
            assert np.abs(off).max() / np.linalg.norm(b - a) < 1e-3


def test_coco_unrolled_is_the_visible_mask(made: Path) -> None:
    document = loaded(made / "train_coco.json")
    names = {image["id"]: image["file_name"] for image in document["images"]}
    assert all((made / name).exists() for name in names.values())
    for annotation in document["annotations"]:
        index = annotation["image_id"]
        seen = picture(made, "mask_visib", index, "_000000") > 0
        runs = annotation["segmentation"]["counts"]
        height, width = annotation["segmentation"]["size"]
        values = np.repeat(np.arange(len(runs)) % 2, runs).reshape(width, height).T
        np.testing.assert_array_equal(values, seen)
        y, x = np.nonzero(seen)
        assert annotation["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
        assert annotation["area"] == seen.sum()


def test_coco_s_key_points_reproject(made: Path) -> None:
    document = loaded(made / "train_coco.json")
    points = np.array(loaded(made / "dataset.json")["key_points"]["p_mm"])
    assert len(document["categories"][0]["keypoints"]) == len(points)
    views = {index: (camera, pose) for index, camera, pose, _ in bop(made)}
    for annotation in document["annotations"]:
        K, R, t = matrices(*views[annotation["image_id"]])
        q = (points @ R.T + t) @ K.T
        told = np.array(annotation["keypoints"]).reshape(-1, 3)
        labelled = told[:, 2] > 0
        assert np.abs((q[:, :2] / q[:, 2:] - told[:, :2])[labelled]).max() < 1e-4
        assert annotation["num_keypoints"] == labelled.sum()
        assert (told[~labelled] == 0).all()


def test_pycocotools_reads_it(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed")
    document = coco.COCO(str(made / "train_coco.json"))
    for annotation in document.loadAnns(document.getAnnIds()):
        seen = picture(made, "mask_visib", annotation["image_id"], "_000000") > 0
        np.testing.assert_array_equal(document.annToMask(annotation), seen)


@pytest.mark.parametrize("mask", [[[0, 1], [1, 1]], [[1, 0], [0, 0]], [[0, 0], [0, 0]], [[1, 1], [1, 1]]])
def test_run_lengths_begin_with_what_is_not_set(mask: list[list[int]]) -> None:
    runs = run_lengths(np.array(mask, bool))
    values = np.repeat(np.arange(len(runs)) % 2, runs).reshape(2, 2).T
    assert values.tolist() == mask
