"""COLLADA: units, placements, kinds of surfaces and colours; and files that contradict themselves."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.mesh import Mesh
from cadcam.cad.read import read_model, read_model_with_report
from cadcam.errors import BadValue, CadcamError, UnreadableFile

CUBE = "0 0 0  1 0 0  1 1 0  0 1 0  0 0 1  1 0 1  1 1 1  0 1 1"
QUADS = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
TRIANGLES = [(a, b, c) for a, b, c, d in QUADS] + [(a, c, d) for a, b, c, d in QUADS]
UNIT = '<unit name="millimeter" meter="0.001"/>'
PLACED = '<instance_geometry url="#cube"/>'
RED = """<instance_geometry url="#cube"><bind_material><technique_common><instance_material symbol="paint" target="#m"/>
</technique_common></bind_material></instance_geometry>"""


def words(rows: list[tuple[int, ...]]) -> str:
    return " ".join(str(i) for row in rows for i in row)


def surfaces(kind: str = "triangles") -> str:
    """Return the cube's six sides; beside the points' numbers stand those of normals, which are not there."""
    corners = '<input semantic="NORMAL" source="#none" offset="0"/><input semantic="VERTEX" source="#v" offset="1"/>'
    if kind == "triangles":
        p = "<p>" + " ".join(f"7 {i}" for row in TRIANGLES for i in row) + "</p>"
        return f'<triangles material="paint" count="12">{corners}{p}</triangles>'
    alone = '<input semantic="VERTEX" source="#v" offset="0"/>'
    if kind == "polylist":
        vcount = "<vcount>" + "4 " * 6 + "</vcount>"
        return f'<polylist count="6">{alone}{vcount}<p>{words(QUADS)}</p></polylist>'
    lists = [(a, b, d, c) for a, b, c, d in QUADS] if kind == "tristrips" else QUADS
    return f"<{kind}>{alone}" + "".join(f"<p>{words([row])}</p>" for row in lists) + f"</{kind}>"


def document(*, unit: str = UNIT, points: str = CUBE, of: str = "", nodes: str = "", scene: bool = True) -> str:
    placed = nodes or f'<node name="block">{PLACED}</node>'
    shown = f'<library_visual_scenes><visual_scene id="s">{placed}</visual_scene></library_visual_scenes>'
    shown += '<scene><instance_visual_scene url="#s"/></scene>'
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{unit}</asset>
<library_effects><effect id="e"><profile_COMMON><technique><lambert><diffuse><color>0.8 0.1 0.2 1</color></diffuse>
</lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="cube" name="cube"><mesh><source id="p"><float_array count="24">{points}</float_array>
<technique_common><accessor source="#f" count="8" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{of or surfaces()}</mesh></geometry>
</library_geometries>
{shown if scene else ""}</COLLADA>"""


def read(folder: Path, text: str, *, unit: str | None = None) -> Mesh:
    (folder / "a.dae").write_text(text)
    return read_model(folder / "a.dae", unit=unit)


def volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("kind", ["triangles", "polylist", "polygons", "trifans", "tristrips"])
def test_every_kind_of_surface_gives_the_cube(tmp_path: Path, kind: str) -> None:
    mesh = read(tmp_path, document(of=surfaces(kind)))
    assert len(mesh.vertices) == 8
    assert mesh.n_faces == 12
    assert volume(mesh) == pytest.approx(1.0)
    assert mesh.part_names == ("block",)


def test_nodes_place_it_in_the_order_of_their_elements(tmp_path: Path) -> None:
    """Twice as wide, turned by 90 degrees about z, then moved; below it once more; and mirrored by a matrix."""
    turned = "<translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>"
    below = f'<node name="b"><translate>0 0 5</translate>{PLACED}</node>'
    mirrored = f'<node name="c"><matrix>-1 0 0 0  0 1 0 0  0 0 1 0  0 0 0 1</matrix>{PLACED}</node>'
    mesh = read(tmp_path, document(nodes=f'<node name="a">{turned}{PLACED}{below}</node>{mirrored}'))
    assert mesh.part_names == ("a", "b", "c")
    bounds = [mesh.subset([k]).bounds for k in range(3)]
    expected = [[[9, 0, 0], [10, 2, 1]], [[9, 0, 5], [10, 2, 6]], [[-1, 0, 0], [0, 1, 1]]]
    assert np.allclose(bounds, expected, rtol=0, atol=1e-12)
    assert [volume(mesh.subset([k])) for k in range(3)] == pytest.approx([2.0, 2.0, 1.0])


def test_a_node_of_the_library_stands_where_it_is_placed(tmp_path: Path) -> None:
    library = f'<library_nodes><node id="bolt" name="bolt">{PLACED}</node></library_nodes>'
    twice = "".join(
        f'<node name="{n}"><translate>{n} 0 0</translate><instance_node url="#bolt"/></node>' for n in (3, 6)
    )
    mesh = read(tmp_path, document(nodes=twice).replace("<library_visual", library + "<library_visual"))
    assert mesh.part_names == ("bolt", "bolt #2")
    assert np.allclose(mesh.bounds, [[3, 0, 0], [7, 1, 1]])


def test_a_library_without_a_scene_is_read_whole(tmp_path: Path) -> None:
    assert read(tmp_path, document(scene=False)).part_names == ("cube",)


def test_the_diffuse_colour_of_the_material_is_the_parts(tmp_path: Path) -> None:
    nodes = f'<node name="red">{RED}</node><node name="bare"><translate>3 0 0</translate>{PLACED}</node>'
    colors = read(tmp_path, document(nodes=nodes)).part_colors
    assert colors[0] == pytest.approx([0.8, 0.1, 0.2])
    assert np.isnan(colors[1]).all()


@pytest.mark.parametrize(
    ("unit", "name", "source", "size"),
    [
        (UNIT, "mm", "file", 1.0),
        ('<unit name="inch" meter="0.0254"/>', "in", "file", 25.4),
        ('<unit name="pace" meter="0.75"/>', "m", "file", 750.0),
        ('<unit name="meter"/>', "m", "format", 1000.0),
        ("", "m", "format", 1000.0),
    ],
)
def test_the_unit_counts_by_its_length(tmp_path: Path, unit: str, name: str, source: str, size: float) -> None:
    (tmp_path / "a.dae").write_text(document(unit=unit))
    mesh, report = read_model_with_report(tmp_path / "a.dae")
    assert (report.unit, report.unit_source) == (name, source)
    assert mesh.size_mm == pytest.approx(size)


def test_another_unit_is_refused_where_the_file_gives_the_length_and_taken_where_not(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"a\.dae is cm; expected mm, which the file names itself"):
        read(tmp_path, document(), unit="cm")
    assert read(tmp_path, document(unit=""), unit="mm").size_mm == pytest.approx(1.0)


def test_skins_are_left_out_and_named(tmp_path: Path) -> None:
    nodes = f'<node>{PLACED}<instance_controller url="#skin"/></node>'
    (tmp_path / "a.dae").write_text(document(nodes=nodes))
    assert read_model_with_report(tmp_path / "a.dae")[1].warnings[0] == "1 skinned geometry is left out"


BAD = [
    ("<COLLADA", "is not valid XML"),
    ('<?xml version="1.0" encoding="klingon"?><COLLADA/>', "is not valid XML"),
    ("<robot/>", "is XML, but <robot>, not COLLADA"),
    (document(unit='<unit meter="wide"/>'), r"inconsistent \(ValueError"),
    (document(unit='<unit meter="-1"/>'), "a unit of -1 m"),
    (document(points=CUBE + " 1.0x"), r"inconsistent \(ValueError"),
    (document(points="0 0 0 1 1 1"), "source 'p' claims 8 positions of 3 numbers, but has 6: truncated"),
    (document(points=CUBE.replace("1", "nan")), "coordinates must be finite"),
    (document(of=surfaces().replace("7 6", "7 9")), r"'cube', corner \d+ refers to vertex 9"),
    (document(of=surfaces("polylist").replace("4 4", "4 5", 1)), "polygons of 25 corners, but 24 are listed"),
    (document(of="<polygons><input semantic='VERTEX' source='#v'/><ph/></polygons>"), "polygons with holes"),
    (document(of="<lines><p>0 1</p></lines>"), "no geometry"),
    (document(nodes='<node><instance_geometry url="#tube"/></node>'), "refers to 'tube', which it does not hold"),
    (document(nodes='<node><instance_geometry url="b.dae#x"/></node>'), "refers to 'b.dae#x', outside the file"),
    (document(nodes='<node id="n"><instance_node url="#n"/></node>'), "node 'n' stands below itself"),
    (document(nodes=f"<node><lookat>0 0 0</lookat>{PLACED}</node>"), "is placed by <lookat>"),
    (document(nodes=f"<node><matrix>1 0 0</matrix>{PLACED}</node>"), r"inconsistent \(ValueError"),
    (document().replace('semantic="POSITION"', 'semantic="NORMAL"'), "vertices '#v' without positions"),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=[said for _, said in BAD])
def test_a_file_that_contradicts_itself_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UnreadableFile, match=said) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("last", [PLACED, ""])
def test_nodes_that_place_nodes_many_times_are_refused_before_they_fill_the_memory(tmp_path: Path, last: str) -> None:
    levels = "".join(f'<node id="n{k}">' + f'<instance_node url="#n{k + 1}"/>' * 10 + "</node>" for k in range(9))
    text = document(nodes=f'{levels}<node id="n9">{last}</node>')
    with pytest.raises(UnreadableFile, match="places more than 100000 nodes and geometries"):
        read(tmp_path, text)


def test_random_damage_never_escapes_as_another_error(tmp_path: Path, rng: np.random.Generator) -> None:
    data = document(nodes=f'<node name="a"><rotate>0 0 1 90</rotate>{RED}</node>').encode()
    for _ in range(150):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), 4):
            broken[at] = rng.integers(0, 256)
        (tmp_path / "a.dae").write_bytes(broken)
        with contextlib.suppress(CadcamError):
            read_model(tmp_path / "a.dae")
