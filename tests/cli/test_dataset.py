"""`cadcam dataset`: the folder that its help promises, going on, one clear error for what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cadcam.image.picture import read_picture

from .job import Ran

Cadcam = Callable[..., Ran]
SMALL = ("--size", "80x60", "--workers", "1")


def test_it_makes_what_its_help_says_and_goes_on(cadcam: Cadcam, job: Path) -> None:
    words = ("dataset", job / "block.obj", "-o", job / "set", "--seed", "1", "--occluders", "0,2", *SMALL)
    ran = cadcam(*words, "--views", "3")
    assert ran.code == 0, ran.err
    assert "made now                           3" in ran.out
    assert f"look at {job}/set/contact.png" in ran.err
    for name in ("scene_camera.json", "scene_gt.json", "scene_gt_info.json", "rgb/000002.png", "edges/000002.npz"):
        assert (job / "set/train/000000" / name).exists(), name
    for name in ("models/obj_000001.ply", "models/models_info.json", "train_coco.json", "camera.json"):
        assert (job / "set" / name).exists(), name
    assert read_picture(job / "set/contact.png").shape == (60, 3 * 80 + 2 * 4, 3)
    again = cadcam(*words, "--views", "4", "--json")
    assert (again.json["views"], again.json["new"]) == (4, 1)
    assert cadcam(*words, "--views", "4").err.count("4 views are in") == 1


def test_a_plan_file_and_another_split(cadcam: Cadcam, job: Path) -> None:
    (job / "plan.yaml").write_text("views: 2\nbackground: [noise]\nsamples: 1\n")
    ran = cadcam("dataset", job / "block.obj", "-o", job / "set", "--plan", job / "plan.yaml", "--split", "val", *SMALL)
    assert ran.code == 0, ran.err
    assert (job / "set/val/000000/rgb/000001.png").exists()
    assert (job / "set/val_coco.json").exists()


def test_the_jobs_camera_with_its_lens_and_grey_pictures(cadcam: Cadcam, job: Path) -> None:
    words = ("dataset", job / "block.obj", "-o", job / "set", "--camera", job / "camera.json", "--gray", "--views", "1")
    ran = cadcam(*words, "--workers", "1", "--json")
    assert ran.code == 0, ran.err
    assert read_picture(job / "set/train/000000/gray/000000.png").shape == (240, 320)
    assert "through a lens" in ran.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--views", "0"), "views is 0"),
        (("--background", "nois"), "did you mean 'noise'"),
        (("--plan", "none.yaml"), "none.yaml: no such file"),
        (("--sensor", "phon"), "did you mean 'phone'"),
        (("--workers", "0"), "workers is 0"),
        (("--split", "a/b"), "split is 'a/b'"),
        (("-o", "block.obj"), "block.obj"),
        (("--key-points", "lost.csv"), "lost.csv: no such file"),
    ],
)
def test_what_is_wrong_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(job)
    ran = cadcam("dataset", "block.obj", "-o", "set", "--views", "2", *SMALL, *options)
    assert ran.code == 2
    assert ran.out == ""
    errors = [line for line in ran.err.splitlines() if line.startswith("cadcam dataset: ")]
    assert len(errors) == 1
    assert message in errors[0]
