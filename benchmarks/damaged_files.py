"""What CAD readers let through: the same model in six formats, damaged in every way that files get damaged.

Run it as `python benchmarks/damaged_files.py`. It prints a markdown table: for each damage and reader, how many of the
files were refused, and how many came back as a mesh without a word. Needs trimesh (the peer), in the extra `dev`.
"""

from __future__ import annotations

import contextlib
import io
import re
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket
from cadcam.cad.read import read_model
from cadcam.cad.write import write_model
from cadcam.errors import CadcamError

Damage = Callable[[bytes], bytes | None]
MODEL = machined_bracket(sides=24)


def whole_files(mesh: Mesh, folder: Path) -> dict[str, bytes]:
    """Return the model in six formats, ASCII and binary."""
    files = {}
    for suffix in (".stl", ".obj", ".ply", ".glb"):
        write_model(folder / f"model{suffix}", mesh)
        files[suffix] = (folder / f"model{suffix}").read_bytes()
    rows = [" ".join(f"{x:.6f}" for x in v) for v in mesh.vertices]
    faces = [f"3 {a} {b} {c}" for a, b, c in mesh.faces]
    files[".off"] = "\n".join(["OFF", f"{len(rows)} {len(faces)} 0", *rows, *faces, ""]).encode()
    triangles = mesh.vertices[mesh.faces]
    facets = ("\n".join(f"vertex {x:.6f} {y:.6f} {z:.6f}" for x, y, z in t) for t in triangles)
    body = "\n".join(f"facet normal 0 0 0\nouter loop\n{f}\nendloop\nendfacet" for f in facets)
    files["ascii.stl"] = f"solid part\n{body}\nendsolid part\n".encode()
    return files


def cut(share: float) -> Damage:
    """Return the damage that keeps the first `share` of a file."""
    return lambda data: data[: int(share * len(data))]


def nan_coordinate(data: bytes) -> bytes | None:
    """Put NaN in place of one coordinate."""
    if b"\0" not in data[:2000]:
        return re.sub(rb"(?m)^((?:v|vertex)? ?)(-?\d+\.\d+) ", rb"\1nan ", data, count=1)
    x, y, z = MODEL.vertices[MODEL.faces[10, 0]]
    for scale, form in ((1.0, "<fff"), (1.0, "<ddd"), (1e-3, "<fff")):  # glTF is in metres
        point = struct.pack(form, x * scale, y * scale, z * scale)
        if point in data:
            return data.replace(point, struct.pack(form, np.nan, y * scale, z * scale), 1)
    raise LookupError("the model's points are not in its file as floats")


def text_for_a_number(data: bytes) -> bytes | None:
    """Put a letter O in place of a zero, as an optical reader or a tired hand does."""
    found = re.search(rb"(?m)^(?:v|vertex)? ?-?\d*0\.", data)
    return None if found is None or b"\0" in data[:2000] else data[: found.end() - 2] + b"O" + data[found.end() - 1 :]


def face_beyond_the_vertices(data: bytes) -> bytes | None:
    """Let one face name a vertex that there is not."""
    if data.startswith(b"OFF"):
        return re.sub(rb"(?m)^3 \d+", b"3 99999999", data, count=1)
    return re.sub(rb"(?m)^f \d+", b"f 99999999", data, count=1) if b"\nf " in data else None


def another_format(data: bytes) -> bytes | None:
    """Replace the file by a zip archive of it, whose suffix nobody changed back."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("model", data)
    return out.getvalue()


DAMAGES: dict[str, Damage] = {
    "cut at 50 %": cut(0.5),
    "cut at 99 %": cut(0.99),
    "NaN in a coordinate": nan_coordinate,
    "letter O for a zero": text_for_a_number,
    "face names no vertex": face_beyond_the_vertices,
    "zip under that suffix": another_format,
}


def trimesh_loads(path: Path) -> bool:
    """Return whether trimesh gives a mesh with faces."""
    import trimesh

    return len(getattr(trimesh.load(path, force="mesh"), "faces", ())) > 0


def cadcam_loads(path: Path) -> bool:
    """Return whether cadcam gives a mesh."""
    try:
        return read_model(path).n_faces > 0
    except CadcamError:
        return False


READERS = {"cadcam": cadcam_loads, "trimesh": trimesh_loads}


def outcomes() -> Iterator[tuple[str, str, str]]:
    """Yield (damage, reader, outcome) for every format."""
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        for form, data in whole_files(MODEL, folder).items():
            for damage, spoil in DAMAGES.items():
                spoilt = spoil(data)
                if spoilt is None or spoilt == data:
                    continue
                path = folder / f"spoilt{Path(form).suffix or form}"
                path.write_bytes(spoilt)
                for reader, loads in READERS.items():
                    yield damage, reader, _outcome(loads, path)


def _outcome(loads: Callable[[Path], bool], path: Path) -> str:
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return "accepted" if loads(path) else "refused"
        except Exception:  # the peer's own exceptions, of any kind, count as a refusal
            return "refused"


def main() -> None:
    """Print the table."""
    rows = list(outcomes())
    print("| damage | files | " + " | ".join(f"{reader}: accepted silently" for reader in READERS) + " |")
    print("|---|---|" + "---|" * len(READERS))
    for damage in DAMAGES:
        mine = {reader: [o for d, r, o in rows if d == damage and r == reader] for reader in READERS}
        files = len(next(iter(mine.values())))
        print(f"| {damage} | {files} | " + " | ".join(str(o.count("accepted")) for o in mine.values()) + " |")


if __name__ == "__main__":
    main()
