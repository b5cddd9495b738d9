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
    ran = cadcam(*words, "--count", "3")
    assert ran.code == 0, ran.err
    assert "made now                           3" in ran.out
    assert f"look at {job}/set/contact.png" in ran.err
    for name in ("scene_camera.json", "scene_gt.json", "scene_gt_info.json", "rgb/000002.png", "edges/000002.npz"):
        assert (job / "set/train/000000" / name).exists(), name
    for name in ("models/obj_000001.ply", "models/models_info.json", "train_coco.json", "camera.json"):
        assert (job / "set" / name).exists(), name
    assert read_picture(job / "set/contact.png").shape == (60, 3 * 80 + 2 * 4, 3)
    again = cadcam(*words, "--count", "4", "--json")
    assert (again.json["views"], again.json["new"]) == (4, 1)
    assert cadcam(*words, "--count", "4").err.count("4 views are in") == 1


def test_a_plan_file_and_another_split(cadcam: Cadcam, job: Path) -> None:
    (job / "plan.yaml").write_text("count: 2\nbackgrounds: [noise]\nsamples: 1\n")
    ran = cadcam("dataset", job / "block.obj", "-o", job / "set", "--plan", job / "plan.yaml", "--split", "val", *SMALL)
    assert ran.code == 0, ran.err
    assert (job / "set/val/000000/rgb/000001.png").exists()
    assert (job / "set/val_coco.json").exists()


def test_the_jobs_camera_with_its_lens_and_grey_pictures(cadcam: Cadcam, job: Path) -> None:
    words = ("dataset", job / "block.obj", "-o", job / "set", "--camera", job / "camera.json", "--gray", "--count", "1")
    ran = cadcam(*words, "--workers", "1", "--json")
    assert ran.code == 0, ran.err
    assert read_picture(job / "set/train/000000/gray/000000.png").shape == (240, 320)
    assert "through a lens" in ran.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--count", "0"), "views is 0"),
        (("--backgrounds", "nois"), "did you mean 'noise'"),
        (("--plan", "none.yaml"), "none.yaml: no such file"),
        (("--sensor", "phon"), "did you mean 'phone'"),
        (("--workers", "0"), "workers is 0"),
        (("--split", "a/b"), "split is 'a/b'"),
        (("-o", "block.obj"), "block.obj: cannot be written: is an input of this command"),
        (("-o", "block.obj/set"), "block.obj/set: cannot be written: '{job}/block.obj' is a file; name a folder"),
        (("--fill", "0.9,0.4"), "(least, greatest), from 0.01 to 2"),
        (("--fill", "0.5", "--distance", "900"), "--fill is given beside --distance"),
        (("--distance", "1,2"), "which puts the camera 1 mm from the middle of a part whose box reaches 37.42 mm"),
        (("--seen-from", "above:20", "--distance", "10,50"), "expected more than 10.64 mm, or poses of your own"),
        (("--view-angle", "140"), "expected less than 0.36 with so wide an angle of view, or poses of your own"),
        (("--key-points", "lost.csv"), "lost.csv: no such file"),
    ],
)
def test_what_is_wrong_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(job)
    ran = cadcam("dataset", "block.obj", "-o", "set", "--count", "2", *SMALL, *options)
    assert ran.code == 2
    assert ran.out == ""
    errors = [line for line in ran.err.splitlines() if line.startswith("cadcam dataset: ")]
    assert len(errors) == 1
    assert message.format(job=job) in errors[0]


def test_the_camera_may_be_near_a_flat_side_and_anywhere_by_poses_of_one_s_own(cadcam: Cadcam, job: Path) -> None:
    """The block's box reaches 37.42 mm from its middle, 10.64 mm within 20 degrees of straight up."""
    words = ("dataset", job / "block.obj", "--count", "1", *SMALL)
    assert cadcam(*words, "-o", job / "above", "--seen-from", "above:20", "--distance", "11,50").code == 0
    columns = "name,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\n"
    (job / "poses.csv").write_text(f"# camera_from_part, mm\n{columns}a,1,0,0,0,1,0,0,0,1,-30,-20,-5\n")
    assert cadcam(*words, "-o", job / "within", "--poses", job / "poses.csv").code == 0


def test_poses_of_the_part_are_taken_as_the_help_calls_them(cadcam: Cadcam, job: Path) -> None:
    """camera_from_part and its inverse put the part where camera_from_world does: its axes are the world."""
    columns = "name,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\n"
    said = []
    for direction, shift in (
        ("camera_from_world", "9,-7,500"),
        ("camera_from_part", "9,-7,500"),
        ("part_from_camera", "-9,7,-500"),
    ):
        (job / "poses.csv").write_text(f"# {direction}, mm\n{columns}a,1,0,0,0,1,0,0,0,1,{shift}\n")
        ran = cadcam("dataset", job / "block.obj", "-o", job / direction, "--poses", job / "poses.csv", *SMALL)
        assert ran.code == 0, ran.err
        said.append((job / direction / "train/000000/scene_gt.json").read_text())
    assert said[0] == said[1] == said[2]


def test_a_set_of_which_no_picture_shows_the_part_says_so(cadcam: Cadcam, job: Path) -> None:
    columns = "name,r11,r12,r13,r21,r22,r23,r31,r32,r33,tx,ty,tz\n"
    (job / "poses.csv").write_text(f"# camera_from_part, mm\n{columns}a,1,0,0,0,1,0,0,0,1,0,0,-500\n")
    words = ("dataset", job / "block.obj", "-o", job / "behind", "--poses", job / "poses.csv", *SMALL)
    assert "no picture shows anything of the part: do the poses put the part before" in cadcam(*words).err


def test_what_differs_of_a_data_set_is_what_was_asked_for_and_not_what_follows_from_it(
    cadcam: Cadcam, job: Path
) -> None:
    """Another distance brings another depth_scale; the first is what a user knows of."""
    words = ("dataset", job / "block.obj", "-o", job / "set", "--count", "1", *SMALL)
    assert cadcam(*words, "--distance", "500").code == 0
    assert "is begun with another around.distance_mm (" in cadcam(*words, "--distance", "50000").err


def test_an_interruption_says_that_the_same_command_goes_on(
    cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cadcam.dataset.make.make_dataset", interrupted)
    ran = cadcam("dataset", job / "block.obj", "-o", job / "set", "--count", "1", *SMALL)
    assert ran.code == 130
    assert "cadcam dataset: interrupted; the same command goes on where it was" in ran.err


def test_a_picture_far_wider_than_high_has_its_tile(cadcam: Cadcam, job: Path) -> None:
    words = ("dataset", job / "block.obj", "-o", job / "set", "--count", "1", "--workers", "1")
    ran = cadcam(*words, "--size", "2000x4")
    assert ran.code == 0, ran.err
    assert read_picture(job / "set/contact.png").shape == (1, 500, 3)
