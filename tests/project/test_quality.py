"""Lint, format, types and import contracts hold; and the contracts can fail."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*command: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run a tool of this interpreter's environment."""
    folder = Path(sys.executable).parent
    tool = shutil.which(command[0], path=f"{folder}{os.pathsep}{os.environ['PATH']}")
    if tool is None:
        pytest.fail(f'{command[0]} is not installed: pip install -e ".[dev]"')
    return subprocess.run([tool, *command[1:]], cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "command",
    [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",), ("lint-imports",)],
    ids=["lint", "format", "types", "imports"],
)
def test_tool_is_content(command: tuple[str, ...]) -> None:
    fresh = command == ("mypy",) and not (ROOT / ".mypy_cache").exists()
    result = run(*command, *["--cache-dir=/dev/null"] * fresh)  # to write one is a seventh of a first run's time
    assert result.returncode == 0, result.stdout + result.stderr


FORBIDDEN = [  # a room, an import that it may not have, the contract that says so
    ("geometry/rigid.py", "from cadcam.camera.camera import Camera", "imports only go down"),
    ("cad/mesh.py", "from cadcam.image.picture import read_picture", "imports only go down"),
    ("render/view.py", "import cascadio", "CAD kernels stay in cad"),
    ("calibrate/points/camera.py", "import embreex", "Embree stays in render"),
    ("camera/opengl.py", "import moderngl", "OpenGL stays in render"),
    ("image/edges.py", "import cv2", "OpenCV stays in target"),
    ("render/view.py", "import ctypes", "the C core stays in native"),
    ("files/points.py", "from PIL import Image", "image codecs stay in image"),
    ("plan/coverage.py", "import matplotlib", "plotting stays in report"),
    ("plan/coverage.py", "import distributed", "Dask stays in dataset"),
    ("locate/part.py", "import sqlalchemy", "the database stays in record"),
    ("locate/lines/sight.py", "from cadcam.locate.quality import support", "so do those within locate"),
    ("calibrate/points/flat.py", "from cadcam.calibrate.joint import nested", "so do those within calibrate"),
    ("cli/wires.py", "from cadcam.cli.verbs import overlay", "so do those within cli"),
    ("cli/verbs/lens.py", "from cadcam.cli.verbs import compare", "verbs do not lean on each other"),
    ("plan/scene/layout_scene.py", "from cadcam.plan.sight import look", "so do those within plan"),
    ("target/boards/board.py", "from cadcam.target.marks import mark", "so do those within target"),
]


def test_forbidden_imports_break_their_contracts(tmp_path: Path) -> None:
    """All at once, in a copy of the source: each stands under its own contract."""
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for room, line, _ in FORBIDDEN:
        file = tmp_path / "src/cadcam" / room
        file.write_text(file.read_text() + f"\n{line}\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "src")}
    tool = shutil.which("lint-imports", path=str(Path(sys.executable).parent)) or "lint-imports"
    result = subprocess.run(
        [tool, "--no-cache"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode != 0
    _, *told = re.split(r"\n(\S.*)\n-+\n", result.stdout.partition("Broken contracts")[2])
    of_contract = dict(zip(told[::2], told[1::2], strict=True))
    for room, line, contract in FORBIDDEN:
        importer = "cadcam." + room.removesuffix(".py").replace("/", ".")
        assert re.search(rf"{importer} -> {re.escape(line.split()[1])}\b", of_contract[contract]), (room, contract)


def test_a_contract_is_held_by_every_room_but_the_one_that_it_names() -> None:
    """A room made later must not be forgotten in one of the lists."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    order, stay = contracts[0], [c for c in contracts if c["type"] == "forbidden"]
    rooms = {f"cadcam.{room.strip()}" for layer in order["layers"] for room in layer.split("|")} - {"cadcam.__main__"}
    for contract in stay:
        its_own = (
            "cadcam." + contract["name"].rpartition(" stays in " if "stays" in contract["name"] else " stay in ")[2]
        )
        assert rooms - set(contract["source_modules"]) == {its_own}, contract["name"]


def test_no_file_holds_two_jobs() -> None:
    long = {
        str(p.relative_to(ROOT)): n
        for p in [*ROOT.glob("src/**/*.py"), *ROOT.glob("tests/**/*.py"), *ROOT.glob("benchmarks/*.py")]
        if (n := len(p.read_text().splitlines())) > 450
    }
    assert not long


def test_c_keeps_to_the_same_width_as_python() -> None:
    width = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["line-length"]
    wide = [
        f"{p.relative_to(ROOT)}:{number}"
        for p in [*ROOT.glob("src/**/*.[ch]"), *ROOT.glob("tests/**/*.c")]
        for number, line in enumerate(p.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > width
    ]
    assert not wide


def test_public_attributes_say_their_type() -> None:
    """What other type checkers would have to guess: `pyright --verifytypes cadcam` counts each, and what it is part of.

    An attribute that is an argument as it came has the argument's type.
    """
    trees = ((p, ast.parse(p.read_text(encoding="utf-8"))) for p in ROOT.glob("src/**/*.py"))  # one at a time: all ...
    assert not [f"{p.relative_to(ROOT)}: {name}" for p, tree in trees for name in untyped(tree)]  # ... keep Python busy
    given = "class A:\n def __init__(self, x: int):\n  self.x = x\n  self.y, self._z = x, x\n  self.u: int = 1"
    assert untyped(ast.parse(given)) == ["A.y"]


def untyped(tree: ast.Module) -> list[str]:
    """Return the public attributes whose type neither an annotation nor an argument says."""
    found = []
    for kind in (k for k in tree.body if isinstance(k, ast.ClassDef) and not k.name.startswith("_")):
        stated = {n.target for n in ast.walk(kind) if isinstance(n, ast.AnnAssign)}
        names = {t.attr if isinstance(t, ast.Attribute) else ast.unparse(t) for t in stated}
        for made in (m for m in kind.body if isinstance(m, ast.FunctionDef) and m.name == "__init__"):
            given = {a.arg for a in (*made.args.args, *made.args.kwonlyargs)}
            for step in (s for s in ast.walk(made) if isinstance(s, ast.Assign)):
                if isinstance(step.targets[0], ast.Attribute) and name_of(step.value) in given:
                    continue
                targets = [t for target in step.targets for t in ast.walk(target) if isinstance(t, ast.Attribute)]
                found += [f"{kind.name}.{t.attr}" for t in targets if is_own(t) and t.attr not in names]
    return found


def is_own(target: ast.Attribute) -> bool:
    """Return whether it is a public attribute of self."""
    return name_of(target.value) == "self" and not target.attr.startswith("_")


def name_of(value: ast.expr) -> str | None:
    """Return the name that an expression is, if it is one; `ast.unparse` would write out the others first."""
    return value.id if isinstance(value, ast.Name) else None
