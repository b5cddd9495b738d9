"""`cadcam doctor`: what is there is found, what is missing is named with its remedy, and nothing stops it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from ctypes.util import find_library
from pathlib import Path
from types import ModuleType

import pytest

from cadcam.native import core
from cadcam.render import auto_choice
from cadcam.report import doctor

from .job import Ran

Cadcam = Callable[..., Ran]


def findings(ran: Ran) -> dict[str, dict[str, object]]:
    assert (ran.code, ran.err) == (0, "")
    return {finding["topic"]: finding for finding in ran.json["findings"]}


@pytest.fixture
def no_core(monkeypatch: pytest.MonkeyPatch) -> None:
    core.library.cache_clear()
    monkeypatch.setattr(core, "LIBRARY", Path(__file__).with_name("none.so"))


def test_the_table_says_what_auto_chose_and_why(cadcam: Cadcam) -> None:
    ran = cadcam("doctor")
    name, why = auto_choice()
    assert ran.code == 0
    assert f"{name}: {why}" in ran.out
    assert list(findings(cadcam("doctor", "--json"))) == list(doctor.CHECKS)


@pytest.mark.usefixtures("no_core")
def test_without_the_core_auto_is_ray_and_the_remedy_is_named(cadcam: Cadcam) -> None:
    found = findings(cadcam("doctor", "--json"))
    core.library.cache_clear()
    assert not found["raster core"]["there"]
    assert "C compiler" in str(found["raster core"]["remedy"])
    assert str(found['renderer "auto"']["found"]).startswith("ray: ")
    assert "for more:" in cadcam("doctor").out


def test_a_missing_extra_is_named_with_what_installs_it(cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)
    found = findings(cadcam("doctor", "--json"))
    assert [t for t in ("extra step", "extra codecs") if found[t]["there"]] == []
    assert found["extra step"]["remedy"] == 'pip install "cadcam[step]"'


@pytest.mark.usefixtures("no_core")
def test_without_embree_and_core_nothing_casts_rays(cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)
    found = findings(cadcam("doctor", "--json"))["ray caster"]
    core.library.cache_clear()
    assert (found["there"], found["remedy"]) == (False, "pip install embreex")


def test_without_embree_the_core_casts_rays(cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda _: None)
    monkeypatch.setattr(doctor.platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(sys, "platform", "linux")
    found = findings(cadcam("doctor", "--json"))["ray caster"]
    assert (found["there"], found["remedy"]) == (True, "")  # there are no wheels
    assert found["found"] == "the raster core (the ray renderer, hidden lines); embreex is not installed"


def test_an_egl_that_does_not_answer_is_named_with_what_to_install(
    cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("moderngl", reason="needs the extra gl")
    monkeypatch.setenv("CADCAM_LIBEGL", "libNoSuchEGL.so")
    found = findings(cadcam("doctor", "--json"))["OpenGL"]
    assert not found["there"]
    # a machine without any OpenGL lacks another library first
    missing = "libNoSuchEGL.so" if find_library("OpenGL") else "libOpenGL.so.0"
    assert found["found"] == f"{missing} not loaded"
    assert "apt install libegl1" in str(found["remedy"])


def test_half_an_installation_is_none(cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(ModuleType):
        pass

    def fails(name: str) -> ModuleType:
        raise OSError("libTKernel.so.7: cannot open\nshared object file")

    monkeypatch.setitem(sys.modules, "cascadio", Broken("cascadio"))
    monkeypatch.setattr(doctor, "find_spec", lambda _: object())
    monkeypatch.setattr(doctor, "import_module", fails)
    found = findings(cadcam("doctor", "--json"))["extra step"]
    assert not found["there"]
    assert "cannot open shared object file" in str(found["found"])


def test_a_check_that_fails_itself_is_a_finding(cadcam: Cadcam, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(topic: str) -> doctor.Finding:
        raise ZeroDivisionError(topic)

    monkeypatch.setitem(doctor.CHECKS, "CPU", fails)
    found = findings(cadcam("doctor", "--json"))
    assert found["CPU"]["found"] == "fails with ZeroDivisionError: CPU"
    assert found["Python"]["there"]
