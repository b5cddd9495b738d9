from __future__ import annotations

import base64
import io
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from cadcam.errors import BadValue
from cadcam.image.svg import SvgLayer, hex_color, svg_text, write_svg

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"
LINE = [(0.0, 0.0), (10.25, 4.0)]


def parsed(*layers: SvgLayer, **options: object) -> ET.Element:
    return ET.fromstring(svg_text((40, 30), layers, **options).encode())


def test_pixel_centres_become_svg_s_corner_based_coordinates_by_adding_a_half():
    root = parsed(SvgLayer("visible", [LINE], (1, 0, 0)))
    assert root.find(f".//{SVG}path").get("d") == "M0.500 0.500L10.750 4.500"
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == ("40", "30", "0 0 40 30")


def test_a_layer_carries_its_style_and_its_tooltips_in_order():
    layer = SvgLayer("hidden", [LINE, LINE], (1, 0.5, 0), width=2, opacity=0.5, dash=(6, 4), titles=["a", "b"])
    group = parsed(layer).find(f"{SVG}g")
    assert group.get("class") == "hidden"
    assert group.get("stroke") == "#ff8000"
    assert group.get("stroke-dasharray") == "4.000 6.000"  # and two round ends of 1 px
    assert [title.text for title in group.iter(f"{SVG}title")] == ["a", "b"]


def test_nan_points_lift_the_pen_and_undrawable_lines_are_left_out():
    gap = (np.nan, np.nan)
    lines = [[(1, 1), (2, 2), gap, (3, 3), gap, (4, 4), (5, 5), (np.inf, 0)], [gap], [(1, 1)], np.zeros((0, 2))]
    paths = parsed(SvgLayer("x", lines, (0, 0, 0))).findall(f".//{SVG}path")
    assert [p.get("d") for p in paths] == ["M1.500 1.500L2.500 2.500M4.500 4.500L5.500 5.500"]


def test_any_text_makes_valid_xml():
    nasty = "a<b>&\"quoted\" 'x' \x00\x1b \ud800 ±"
    root = parsed(SvgLayer(nasty, [LINE], (0, 0, 0), titles=[nasty]), title=nasty)
    shown = "a<b>&\"quoted\" 'x' \ufffd\ufffd \ufffd ±"
    assert root.find(f"{SVG}title").text == shown
    assert root.find(f".//{SVG}path/{SVG}title").text == shown
    assert root.find(f"{SVG}g").get("class") == shown


def test_the_photo_lies_under_the_lines_and_fills_the_picture():
    photo = np.full((30, 40, 3), [0.8, 0.2, 0.4])
    root = parsed(SvgLayer("x", [LINE], (0, 0, 0)), photo=photo)
    assert [child.tag for child in root] == [f"{SVG}image", f"{SVG}g"]
    image = root[0]
    assert [image.get(name) for name in ("x", "y", "width", "height")] == ["0", "0", "40", "30"]
    data = base64.b64decode(image.get(HREF).removeprefix("data:image/jpeg;base64,"))
    np.testing.assert_allclose(np.asarray(Image.open(io.BytesIO(data))) / 255, photo, atol=0.02)


def test_a_photo_of_another_size_and_bad_styles_are_refused():
    with pytest.raises(BadValue, match="photo is of 40 x 31 px; expected 40 x 30 px"):
        parsed(photo=np.zeros((31, 40)))
    for what, options in [
        ("color", {"color": (2, 0, 0)}),
        ("width", {"width": 0}),
        ("opacity", {"opacity": -1}),
        ("dash", {"dash": (0, 1)}),
        ("titles", {"titles": ["a", "b"]}),
    ]:
        with pytest.raises(BadValue, match=what):
            SvgLayer("x", [LINE], **{"color": (0, 0, 0), **options})
    with pytest.raises(BadValue, match="size"):
        svg_text((0, 5), [])


def test_the_file_is_written_whole_into_a_new_folder(tmp_path):
    layer = SvgLayer("x", [LINE], (0, 0, 0), titles=["±"])
    write_svg(tmp_path / "new" / "a.svg", (40, 30), [layer])
    assert (tmp_path / "new" / "a.svg").read_text("utf-8") == svg_text((40, 30), [layer])
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.svg"]


def test_colours_are_written_in_hexadecimal():
    assert hex_color((0, 0.5, 1)) == "#0080ff"
