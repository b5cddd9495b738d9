"""The package builds wherever Python is: with whatever compiler works, and without any it says what is missing."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import textwrap
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
BACKEND = ROOT / "build_backend" / "cadcam_build.py"


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The backend on a machine with an empty PATH, no zig, nothing told about an index, and no network."""
    pytest.importorskip("hatchling", reason="needs the extra dev")
    spec = importlib.util.spec_from_file_location("cadcam_build", BACKEND)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    told = [f"PIP_{name}" for name in ("INDEX_URL", "EXTRA_INDEX_URL", "FIND_LINKS", "NO_INDEX")]
    for name in (*told, "UV_INDEX_URL", "UV_DEFAULT_INDEX", "HTTPS_PROXY", "https_proxy", "CC", "CADCAM_NATIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setitem(sys.modules, "ziglang", None)
    network(module, monkeypatch, there=False)
    return module


def network(backend: ModuleType, monkeypatch: pytest.MonkeyPatch, *, there: bool) -> None:
    class Connection:
        def close(self) -> None: ...

    def connect(address: tuple[str, int], timeout: float) -> Connection:
        if not there:
            raise OSError("unreachable")
        return Connection()

    monkeypatch.setattr(backend.socket, "create_connection", connect)


def test_zig_is_asked_for_only_where_there_is_no_compiler_and_an_index_may_answer(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    wanted = [backend.ZIG]
    assert backend.get_requires_for_build_wheel() == []
    network(backend, monkeypatch, there=True)
    assert backend.get_requires_for_build_wheel() == wanted
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    assert backend.get_requires_for_build_wheel() == []
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    assert backend.get_requires_for_build_wheel() == [], "asked in vain: the folder has none"
    (tmp_path / "ziglang-0.13.0-py3-none-any.whl").touch()
    assert backend.get_requires_for_build_wheel() == wanted
    monkeypatch.setenv("CADCAM_NATIVE", "off")
    assert backend.get_requires_for_build_wheel() == []
    monkeypatch.delenv("CADCAM_NATIVE")
    monkeypatch.setattr(backend, "system_compiler", lambda: ["cc"])
    assert backend.get_requires_for_build_wheel() == []


def test_metadata_is_had_without_compiling(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(backend, "system_compiler", lambda: pytest.fail("looked for a compiler"))
    for prepare in (backend.prepare_metadata_for_build_wheel, backend.prepare_metadata_for_build_editable):
        text = (tmp_path / prepare(str(tmp_path)) / "METADATA").read_text()
        assert "\nName: cadcam\n" in text
        assert "\nRequires-Dist: numpy" in text


@pytest.mark.parametrize("does", ["exit 1", "exit 0", "kill -SEGV $$"])
def test_a_compiler_that_does_not_work_does_not_count(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, does: str
) -> None:
    fake = tmp_path / "bin" / "cc"
    fake.write_text(f"#!/bin/sh\n{does}\n")
    fake.chmod(0o755)
    assert backend.shutil.which("cc") == str(fake)
    assert backend.system_compiler() is None
    package = tmp_path / "ziglang"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("raise SystemExit('unable to find zig self exe path')")
    monkeypatch.delitem(sys.modules, "ziglang")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert importlib.util.find_spec("ziglang") is not None
    assert backend.zig_compiler() is None


def test_without_compiler_and_network_there_is_a_package_that_renders_with_rays_and_says_why(
    backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(ROOT)
    assert backend.get_requires_for_build_wheel() == []
    wheel = tmp_path / backend.build_wheel(str(tmp_path))
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if "_raster" in name]
        archive.extractall(tmp_path / "site")
    script = """
        import cadcam
        from cadcam.cad.parts import machined_bracket
        from cadcam.render.standard_view import standard_view
        assert "site" in cadcam.__file__, cadcam.__file__
        scene = cadcam.Scene.of(machined_bracket())
        renderer = cadcam.open_renderer(scene)
        print(renderer.name, int(renderer.render(*standard_view(scene.mesh, size=(80, 60))).mask.sum()))
        try:
            cadcam.open_renderer(scene, "raster")
        except cadcam.CadcamError as error:
            print(error)
    """
    command = [sys.executable, "-P", "-c", textwrap.dedent(script)]
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout.splitlines()
    assert said[0].split()[0] == "ray"
    assert int(said[0].split()[1]) > 1000
    assert "no C compiler was found" in said[1]
    assert "use the renderer 'ray'" in said[1]


def test_its_absence_can_be_made_an_error(backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("CADCAM_NATIVE", "require")
    with pytest.raises(SystemExit, match="cannot be built: no C compiler works"):
        backend.build_wheel(str(tmp_path))


def test_the_oldest_releases_to_try_are_those_that_are_admitted() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = project["dependencies"] + [need for name in extras if name != "dev" for need in extras[name]]
    admitted = dict(need.partition(";")[0].split(">=") for need in needed)
    lines = (ROOT / "tests/project/oldest.txt").read_text().splitlines()
    tried = dict(line.split("==") for line in lines if not line.startswith("#"))
    assert sorted(tried) == sorted(admitted)
    for name, bound in admitted.items():
        assert f"{tried[name]}.".startswith(f"{bound}."), f"{name}: {tried[name]} is tried, {bound} admitted"
