"""`cadcam render --poses`: a file a pose, each as it would be alone; what is there is kept; an empty view is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.files.poses import write_poses
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture_with_info

from .job import POSE, Ran

Cadcam = Callable[..., Ran]
AWAY = Rigid.look_at([180, -260, 200], [330, -540, 390])
POSES = {"one": POSE, "two": Rigid.look_at([200, -200, 150], [30, 20, 10]), "away": AWAY}


@pytest.fixture
def words(job: Path) -> tuple[str | Path, ...]:
    write_poses(job / "poses.csv", POSES)
    (job / "out").mkdir()
    return ("render", job / "block.obj", "--camera", job / "camera.json", "--poses", job / "poses.csv")


@pytest.mark.parametrize(
    ("channel", "suffix", "options"),
    [
        ("shaded", "png", ("--edges", "--transparent")),
        ("wireframe", "svg", ("--hidden",)),
        ("normals", "npy", ()),
        ("parts", "png", ()),
        ("faces", "png", ("--renderer", "ray")),
    ],
)
def test_each_picture_is_what_it_would_be_alone(
    cadcam: Cadcam, job: Path, words: tuple[str | Path, ...], channel: str, suffix: str, options: tuple[str, ...]
) -> None:
    chosen = ("--channel", channel, *options)
    ran = cadcam(*words, *chosen, "-o", job / "out" / f"{{name}}.{suffix}", "--json")
    assert ran.code == 0, ran.err
    assert [one["name"] for one in ran.json["written"]] == list(POSES)
    assert [one["empty"] for one in ran.json["written"]] == [False, False, True]
    alone = cadcam(*words[:4], *chosen, "-o", job / f"alone.{suffix}")
    assert alone.code == 0, alone.err
    assert (job / "out" / f"one.{suffix}").read_bytes() == (job / f"alone.{suffix}").read_bytes()
    assert sorted(p.name for p in (job / "out").iterdir()) == sorted(f"{name}.{suffix}" for name in POSES)


def test_depth_has_one_step_in_all_pictures(cadcam: Cadcam, job: Path, words: tuple[str | Path, ...]) -> None:
    write_poses(job / "poses.csv", POSES | {"far": Rigid.look_at([0, -2000, 0], [30, 20, 10])})
    ran = cadcam(*words, "--channel", "depth", "-o", job / "out" / "{index:02d}.png", "--json")
    assert {one["depth_mm_per_step"] for one in ran.json["written"]} == {0.05}
    for index, one in ((0, ran.json["written"][0]), (3, ran.json["written"][3])):
        picture, info = read_picture_with_info(job / "out" / f"{index:02d}.png")
        assert info.bits == 16
        low, high = np.round(65535 * picture[picture > 0].astype(float)).min(), np.round(65535 * picture.max())
        assert [low * 0.05, high * 0.05] == pytest.approx(one["depth_mm"], abs=0.026)


def test_what_is_there_is_kept_unless_asked(cadcam: Cadcam, job: Path, words: tuple[str | Path, ...]) -> None:
    out = job / "out"
    (out / "two.png").write_bytes(b"mine")
    ran = cadcam(*words, "-o", out / "{name}.png")
    assert ran.code == 0, ran.err
    assert "2 pictures written, 1 were there already" in ran.out
    assert "1 of them show nothing of the model: away" in ran.err
    assert (out / "two.png").read_bytes() == b"mine"
    again = cadcam(*words, "-o", out / "{name}.png", "--json")
    assert (again.json["written"], len(again.json["kept"])) == ([], 3)
    over = cadcam(*words, "-o", out / "{name}.png", "--overwrite", "--threads", "2", "--json")
    assert (len(over.json["written"]), over.json["kept"]) == (3, [])
    assert (out / "two.png").read_bytes() != b"mine"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "out/a.png"), "several poses would be out/a.png"),
        (("-o", "out/{nmae}.png"), "a pattern with {name} or {index:04d}"),
        (("-o", "out/{name.x}.png"), "a pattern with {name} or {index:04d}"),
        (("-o", "out/{name.png"), "a pattern with {name} or {index:04d}"),
        (("-o", "nowhere/{name}.png"), "mkdir -p nowhere"),
        (("-o", "out/{name}.gif"), "unknown suffix of output"),
        (("-o", "out/{name}.png", "--view", "top"), "--view is given beside --poses"),
        (("-o", "out/{name}.png", "--pose", "p.txt"), "given beside --pose"),
    ],
)
def test_a_pattern_that_cannot_be_is_one_message_and_exit_2(
    cadcam: Cadcam,
    job: Path,
    words: tuple[str | Path, ...],
    options: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(job)
    ran = cadcam(*words, *options)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err
    assert not list((job / "out").iterdir())


def test_a_pose_name_never_leads_out_of_the_folder(cadcam: Cadcam, job: Path, words: tuple[str | Path, ...]) -> None:
    for name in ("../one", "a/b", "..", "a\\b"):
        write_poses(job / "poses.csv", {name: POSE})
        ran = cadcam(*words, "-o", job / "out" / "{name}.png")
        assert ran.code == 2
        assert "can be part of a file's name" in ran.err
    assert cadcam(*words, "-o", job / "out" / "{index}.png").code == 0


def test_poses_need_a_camera(cadcam: Cadcam, job: Path, words: tuple[str | Path, ...]) -> None:
    ran = cadcam("render", job / "block.obj", "--poses", job / "poses.csv", "-o", job / "out" / "{name}.png")
    assert ran.code == 2
    assert "poses do not say the focal length" in ran.err
