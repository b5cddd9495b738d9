"""`cadcam inspect` refuses to judge photos that another one judges, and those that were another part's."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from cadcam.cli.arrivals import Source
from cadcam.cli.stores import judging_alone
from cadcam.errors import UnusableStore
from cadcam.files.camera import write_camera
from cadcam.image.picture import write_picture
from cadcam.record.store import open_store

from ..verify.scene import CAMERA, POSE, photographed, plate
from .cell import SIDE, TOLERANCES, Cadcam, inspected


@pytest.mark.parametrize(
    ("first", "second", "shared"),
    [
        (("in/*_L.png", "right"), ("right/*_R.png",), "right"),
        (("in", "right"), ("left", "right", "in"), "in"),
        (("in/*_L.png", "in/*_R.png"), ("left", "right"), None),
    ],
)
def test_photos_in_several_folders_are_judged_by_one_where_any_folder_is_shared(
    cell: Path, first: tuple[str, ...], second: tuple[str, ...], shared: str | None
) -> None:
    for folder in ("left", "right"):
        (cell / folder).mkdir()
    one, other = ([Source.of(text) for text in texts] for texts in (first, second))
    with open_store("parts.sqlite") as store, judging_alone(store, "plate", one):
        expected = nullcontext() if shared is None else pytest.raises(UnusableStore, match=f"/{shared} on .* at work")
        with expected, judging_alone(store, "plate", other):
            pass
        with judging_alone(store, "another kind", other):
            pass


def test_a_camera_that_stopped_is_noticed(cadcam: Cadcam, cell: Path) -> None:
    """In one run and in the next, also where all is judged anew; the part itself may be judged by other limits."""
    photo = cell / "in/A 9.png"
    (cell / "in/A 10.png").unlink()
    shutil.copy(photo, cell / "in/B.png")
    first = inspected(cadcam, "--json", "--reports", "pages")
    assert first.code == 2
    assert "is the same photo, byte for byte, as that of A 9" in Path("pages/index.html").read_text(encoding="utf-8")
    assert [(part["serial"], part["verdict"]) for part in first.json["parts"]] == [("A 9", "PASS")]
    said = "in/B.png: is the same photo, byte for byte, as that of A 9; has the camera stopped?"
    assert first.json["errors"] == {"B": said}
    photo.unlink()
    again = inspected(cadcam, "--again")
    assert (again.code, "1 could not be judged" in again.err) == (2, True)
    (cell / "in/B.png").rename(photo)
    Path("tolerances.yaml").write_text(TOLERANCES.replace("0.5", "3"))
    assert inspected(cadcam).code == 0
    assert inspected(cadcam, "--part", "of another kind", photos=("in/A*.png",)).code == 0


def test_of_several_cameras_one_that_stopped_is_enough(cadcam: Cadcam, cell: Path) -> None:
    write_camera("front.json", CAMERA, camera_from_world=POSE)
    write_camera("side.json", CAMERA, camera_from_world=SIDE)
    Path("pose.txt").write_text("# world_from_part, mm\n1 0 0 0\n0 1 0 0\n0 0 1 0\n")
    rng = np.random.default_rng(8)
    for number in (1, 2):
        write_picture(f"in/{number}_F.png", photographed(plate(), rng))
    write_picture("in/1_S.png", photographed(plate(), rng, SIDE))
    shutil.copy("in/1_S.png", "in/2_S.png")
    ran = inspected(cadcam, "--camera", "side.json", "--json", photos=("in/*_F.png", "in/*_S.png"), camera="front.json")
    assert [part["serial"] for part in ran.json["parts"]] == ["1"]
    assert "in/2_S.png: is the same photo" in ran.json["errors"]["2"]


def test_a_photo_that_was_kept_without_a_serial_is_no_other_part_s(cadcam: Cadcam, cell: Path) -> None:
    (cell / "in/A 10.png").unlink()
    files = ("--camera", "camera.json", "--start", "pose.txt", "--tolerances", "tolerances.yaml")
    cadcam("verify", "in/A 9.png", "plate.glb", *files, "-o", "judged.json")
    assert cadcam("state", "add", "judged.json").code == 0
    assert inspected(cadcam).code == 0
