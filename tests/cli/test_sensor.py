"""`cadcam sensor`, and `cadcam render --sensor`: pictures as a camera would make them, the same each time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.image.picture import read_picture
from cadcam.image.sensor.presets import PRESETS

from .job import Ran

Cadcam = Callable[..., Ran]


def test_what_show_prints_is_a_profile_that_apply_reads(cadcam: Cadcam, job: Path) -> None:
    shown = cadcam("sensor", "show", "ccir-1996")
    assert shown.code == 0
    (job / "mine.json").write_text(shown.out)
    assert cadcam("sensor", "show", "ccir-1996", "-o", job / "written.json").code == 0
    assert (job / "written.json").read_text() == shown.out
    for profile, out in (("ccir-1996", "a.png"), (job / "mine.json", "b.png")):
        ran = cadcam("sensor", "apply", profile, job / "photo.png", "-o", job / out, "--seed", 4)
        assert ran.code == 0, ran.err
        assert "edge_enhancement" in ran.err
    assert (job / "a.png").read_bytes() == (job / "b.png").read_bytes()


def test_show_alone_lists_presets_and_every_effect_with_its_equation(cadcam: Cadcam) -> None:
    out = cadcam("sensor", "show").out
    for name in PRESETS:
        assert name in out
    for words in ("I' = I^gamma", "full_well_e 20000", "worst_ns", "cos^4"):
        assert words in out


def test_a_seed_decides_the_noise_and_linearise_undoes_a_gamma(cadcam: Cadcam, job: Path) -> None:
    for seed, name in ((1, "a"), (1, "b"), (2, "c")):
        ran = cadcam("sensor", "apply", "global-shutter", job / "photo.png", "--seed", seed, "-o", job / f"{name}.png")
        assert ran.code == 0, ran.err
    a, b, c = ((job / f"{n}.png").read_bytes() for n in "abc")
    assert a == b != c
    (job / "plain.json").write_text(json.dumps({"format": "cadcam sensor", "version": 1}))
    cadcam("sensor", "apply", job / "plain.json", job / "photo.png", "--linearize", 0.5, "-o", job / "d.png")
    assert np.abs(read_picture(job / "d.png") - read_picture(job / "photo.png") ** 2).max() < 0.51 / 255


def test_render_shows_what_the_sensor_makes_of_the_model(cadcam: Cadcam, job: Path) -> None:
    common = ("render", job / "block.obj", "--camera", job / "camera.json", "-o")
    assert cadcam(*common, job / "clean.png").code == 0
    for name in ("one.png", "two.png"):
        assert cadcam(*common, job / name, "--sensor", "global-shutter").code == 0
    assert cadcam(*common, job / "one.jpg", "--sensor", "phone", "--seed", 3).code == 0
    clean, one, two = (read_picture(job / n) for n in ("clean.png", "one.png", "two.png"))
    noise = one - two  # files of different names have noise of their own
    assert 0.003 < noise.std() < 0.03
    middle = np.abs(one - clean)[clean.shape[0] // 2 - 20 :, 20:-20]
    assert np.median(middle) < 0.03
    again = job / "again"
    again.mkdir()
    assert cadcam(*common, again / "one.png", "--sensor", "global-shutter").code == 0
    assert (again / "one.png").read_bytes() == (job / "one.png").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sensor", "apply", "phon", "photo.png", "-o", "a.png"), "did you mean 'phone'"),
        (
            ("sensor", "apply", "photo.png", "hall.json", "-o", "a.png"),
            "profile first, then the picture (now 'hall.json')",
        ),
        (
            ("sensor", "apply", "phone", "photo.png", "-o", "./photo.png"),
            "is an input of this command, which would be lost",
        ),
        (("sensor", "apply", "phone", "none.png", "-o", "a.png"), "no such file"),
        (("sensor", "apply", "phone", "photo.png", "-o", "a.txt"), "suffix"),
        (("sensor", "apply", "phone", "photo.png", "-o", "a.png", "--linearize", "0"), "gamma"),
        (("render", "block.obj", "-o", "a.npy", "--channel", "depth", "--sensor", "phone"), "--sensor"),
        (("render", "block.obj", "-o", "a.png", "--transparent", "--sensor", "phone"), "--sensor"),
    ],
)
def test_what_cannot_be_done_is_said(
    cadcam: Cadcam, job: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(job)
    ran = cadcam(*words)
    assert ran.code == 2
    assert message in ran.err
    assert not (job / "a.png").exists()


def test_the_size_told_is_that_of_the_picture_in_oblong_pixels(cadcam: Cadcam, job: Path) -> None:
    profile = {"format": "cadcam sensor", "version": 1, "name": "oblong", "pixel_aspect": {"ratio": 2.0}}
    (job / "oblong.json").write_text(json.dumps(profile))
    words = ("render", job / "block.obj", "--camera", job / "camera.json", "--sensor", job / "oblong.json")
    ran = cadcam(*words, "-o", job / "seen.png")
    assert read_picture(job / "seen.png").shape[:2] == (240, 160)
    assert "(160 x 240 px)" in ran.err
    assert cadcam(*words, "-o", job / "seen.png", "--json").json["size_px"] == [160, 240]
