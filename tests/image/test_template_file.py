"""Templates from files: what is transparent does not count, in the template or in its mask."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cadcam.errors import BadValue, MissingCore
from cadcam.image.correlate import correlate
from cadcam.image.template_file import read_template
from cadcam.native import core

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIDE, AT = 48, (70, 30)


@pytest.fixture
def photo(rng: np.random.Generator) -> np.ndarray:
    """Return a photo of blobs, in bytes."""
    coarse = Image.fromarray((rng.uniform(size=(20, 30)) * 255).astype(np.uint8))
    return np.asarray(coarse.resize((240, 160), Image.Resampling.BICUBIC))


def disc() -> np.ndarray:
    """Return which pixels of a template lie in its disc."""
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    return np.asarray(np.hypot(x, y) < SIDE / 2)


def cut(photo: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the template, with anything outside of its disc."""
    x, y = AT
    noise = rng.integers(0, 255, (SIDE, SIDE), dtype=np.uint8)
    return np.where(disc(), photo[y : y + SIDE, x : x + SIDE], noise)


@pytest.mark.parametrize("colours", [1, 3])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_the_transparent_part_of_a_template_is_no_part_of_it(
    suffix: str, colours: int, photo: np.ndarray, rng: np.random.Generator, tmp_path: Path
) -> None:
    layers = [cut(photo, rng)] * colours + [(disc() * 255).astype(np.uint8)]
    Image.fromarray(np.dstack(layers)).save(tmp_path / f"round{suffix}")
    template = read_template(tmp_path / f"round{suffix}")
    assert (template.mask == disc()).all()
    assert np.abs(template.gray - cut(photo, np.random.default_rng(0)) / 255)[disc()].max() < 1e-6
    peaks = correlate(photo / 255, template)
    assert peaks.score[0] > 0.999
    assert peaks.q[0] == pytest.approx([AT[0] + (SIDE - 1) / 2, AT[1] + (SIDE - 1) / 2], abs=0.02)


@pytest.mark.parametrize("shape", ["white on black", "white on nothing", "black on nothing", "white and black"])
def test_a_mask_is_a_shape_in_any_of_the_ways_that_programs_save_it(
    shape: str, photo: np.ndarray, rng: np.random.Generator, tmp_path: Path
) -> None:
    inside = (disc() * 255).astype(np.uint8)
    layers = {
        "white on black": [inside],
        "white on nothing": [np.full_like(inside, 255), inside],
        "black on nothing": [np.zeros_like(inside), inside],
        "white and black": [inside, np.full_like(inside, 255)],  # with transparency, but none that is used
    }[shape]
    Image.fromarray(np.dstack(layers).squeeze()).save(tmp_path / "mask.png")
    Image.fromarray(cut(photo, rng)).save(tmp_path / "square.png")
    assert (read_template(tmp_path / "square.png", mask=tmp_path / "mask.png").mask == disc()).all()


def test_a_mask_of_another_size_is_refused(photo: np.ndarray, rng: np.random.Generator, tmp_path: Path) -> None:
    Image.fromarray(cut(photo, rng)).save(tmp_path / "square.png")
    Image.fromarray(photo).save(tmp_path / "photo.png")
    with pytest.raises(BadValue, match=r"photo\.png is 240 x 160 px; expected the template's 48 x 48 px"):
        read_template(tmp_path / "square.png", mask=tmp_path / "photo.png")
