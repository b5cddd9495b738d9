"""The build backend: hatchling, and before it a C compiler for the rasteriser's core.

The core is plain C without Python headers: one shared library serves every Python of a platform, so the wheel's tag is
py3-none-<platform>. Compilers are tried in this order: $CC, cc, gcc, clang, and where none works the `ziglang` wheel,
which is asked for only then. Where there is neither (no compiler, no network) the package is built without the core:
it works, and its raster renderer says why it does not.

CADCAM_NATIVE=off leaves the core out; CADCAM_NATIVE=require makes its absence an error (for those who publish wheels).
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import shutil
import socket
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import hatchling.build
from hatchling.build import *  # noqa: F403  the hooks of PEP 517 and 660 that are not replaced below
from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.builders.wheel import WheelBuilder

SOURCES = Path("src/cadcam/native")
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
ZIG = "ziglang>=0.12"
FLAGS = ["-std=c11", "-O3", "-fPIC", "-fvisibility=hidden"]
FLAGS += ["-ffp-contract=off"]  # without fused multiply-adds a shared edge is the exact negative of its neighbour's
FLAGS += ["-fno-math-errno", "-fno-trapping-math"]  # these change no number; loops vectorise
# The hot files, once for each instruction set; the choice is made at run time (best_level in scene.c).
HOT = ("cull.c", "raster.c", "strip.c", "bent.c", "tile.c", "tile_plain.c", "shade.c", "correlate.c", "register.c")
HOT += ("step.c", "field.c", "slide.c", "climb.c", "sweep.c", "slope.c", "left.c")
ONCE = (
    "scene.c",
    "lens.c",
    "patch.c",
    "match.c",
    "profile.c",
    "band.c",
    "field_calls.c",
    "seen.c",
    "mark.c",
    "grouped.c",
    "reweighted.c",
)
ONCE += ("pack.c", "pack_layers.c", "layers.c", "hide.c", "crossing.c", "rays.c")
VARIANTS = {"_baseline": [], "_v3": ["-mavx2", "-mfma", "-mbmi", "-mbmi2"]}
X86_64 = platform.machine().lower() in ("x86_64", "amd64")
PROBE = "#include <math.h>\n#include <stdint.h>\n#include <stdlib.h>\ndouble probe(double x) { return sqrt(x); }\n"


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return ["ziglang"] where no compiler works and a package index may answer."""
    if os.environ.get("CADCAM_NATIVE") == "off" or system_compiler():
        return []
    return [ZIG] if index_may_answer() else []


def get_requires_for_build_editable(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Return what an editable installation needs: hatchling's own wish (`editables`), and a compiler as above."""
    return [*hatchling.build.get_requires_for_build_editable(config_settings), *get_requires_for_build_wheel()]


def prepare_metadata_for_build_wheel(metadata_directory: str, config_settings: dict[str, Any] | None = None) -> str:
    """Write the metadata alone. Under pip hatchling leaves this out, and the core would be compiled twice."""
    builder = WheelBuilder(str(Path.cwd()))
    folder = Path(metadata_directory) / f"{builder.artifact_project_id}.dist-info"
    folder.mkdir(exist_ok=True)
    text = builder.config.core_metadata_constructor(builder.metadata)
    (folder / "METADATA").write_text(text, encoding="utf-8")
    return folder.name


prepare_metadata_for_build_editable = prepare_metadata_for_build_wheel


class NativeHook(BuildHookInterface):  # type: ignore[type-arg]  # its parameter is hatchling's own configuration
    """Compiles the core before hatchling collects the wheel's files."""

    PLUGIN_NAME = "custom"
    _scratch: tempfile.TemporaryDirectory[str] | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the library and tag the wheel; without a compiler, say so and leave both."""
        wish = os.environ.get("CADCAM_NATIVE", "")
        compiler = None if wish == "off" else system_compiler() or zig_compiler()
        folder = Path(self.root) / SOURCES
        library = folder / f"_raster{SUFFIX}"
        if version == "editable":
            library.unlink(missing_ok=True)
        if compiler is None:
            reason = "CADCAM_NATIVE=off" if wish == "off" else "no C compiler works here, nor does the ziglang wheel"
            if wish == "require":
                raise SystemExit(f"cadcam: the rasteriser's core cannot be built: {reason}")
            self.app.display_warning(f"cadcam: built without the rasteriser's core ({reason}); the ray renderer works")
            return
        if version != "editable":  # the tree stays as it is
            self._scratch = tempfile.TemporaryDirectory()
            library = Path(self._scratch.name) / library.name
            build_data["force_include"][str(library)] = f"cadcam/native/{library.name}"
        compile_core(compiler, folder, library)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform_tag(compiler)}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Clear away what was compiled."""
        if self._scratch is not None:
            self._scratch.cleanup()


def compile_core(compiler: list[str], folder: Path, library: Path) -> None:
    """Compile every file on all cores, the hot ones for each instruction set, and link them."""
    variants = VARIANTS if X86_64 else {"_baseline": []}
    jobs = [(name, "", []) for name in ONCE]
    jobs += [(name, suffix, [f"-DCC_VARIANT={suffix}", *flags]) for suffix, flags in variants.items() for name in HOT]
    with tempfile.TemporaryDirectory() as scratch:
        objects = [str(Path(scratch) / f"{source}{suffix}.o") for source, suffix, _ in jobs]
        commands = [
            [*compiler, *FLAGS, *flags, "-c", str(folder / source), "-o", made]
            for (source, _, flags), made in zip(jobs, objects, strict=True)
        ]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(run, commands))
        made = Path(scratch) / library.name
        run([*compiler, "-shared", "-o", str(made), *objects, *([] if sys.platform == "win32" else ["-lm"])])
        shutil.copyfile(made, library)


def run(command: list[str]) -> None:
    """Run a compiler; its own words are the error."""
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(f"cadcam: {shlex.join(command)} failed:\n{result.stderr or result.stdout}")


def system_compiler() -> list[str] | None:
    """Return the first compiler that makes a shared library here; one without C headers does not count."""
    for candidate in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        command = shlex.split(candidate)
        if command and shutil.which(command[0]) and works(command):
            return command
    return None


def works(command: list[str]) -> bool:
    """Return whether a compiler turns a few lines into a shared library."""
    with tempfile.TemporaryDirectory() as scratch:
        source = Path(scratch) / "probe.c"
        source.write_text(PROBE)
        out = Path(scratch) / f"probe{SUFFIX}"
        try:
            done = subprocess.run(
                [*command, "-shared", *FLAGS, str(source), "-o", str(out)], capture_output=True, check=False
            )
        except OSError:
            return False
        return done.returncode == 0 and out.exists()


def zig_compiler() -> list[str] | None:
    """Return zig's C compiler aimed at an old C library, None where the wheel is not installed or does not work."""
    if importlib.util.find_spec("ziglang") is None:
        return None
    command = [sys.executable, "-m", "ziglang", "cc"]
    if sys.platform == "linux":
        glibc = platform.libc_ver()[0] == "glibc"
        command += ["-target", f"{platform.machine()}-linux-" + ("gnu.2.17" if glibc else "musl")]
    return command if works(command) else None  # it needs /proc, which a bare chroot may lack


def platform_tag(compiler: list[str]) -> str:
    """Return the platform part of the wheel's tag."""
    if sys.platform == "linux" and "gnu.2.17" in compiler[-1]:
        return f"manylinux_2_17_{platform.machine()}"
    if sys.platform == "darwin":
        return f"macosx_{platform.mac_ver()[0].split('.')[0]}_0_{platform.machine()}"
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


def index_may_answer() -> bool:
    """Return whether ziglang can probably be had: asking in vain would make the whole installation fail."""
    links = [Path(link.removeprefix("file://")) for link in os.environ.get("PIP_FIND_LINKS", "").split()]
    if any(wheel for link in links if link.is_dir() for wheel in link.glob("ziglang-*.whl")):
        return True
    if os.environ.get("PIP_NO_INDEX"):
        return False
    told = ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "UV_INDEX_URL", "UV_DEFAULT_INDEX", "HTTPS_PROXY")
    if any(os.environ.get(name) or os.environ.get(name.lower()) for name in told):
        return True
    try:
        socket.create_connection(("pypi.org", 443), timeout=4).close()
    except OSError:
        return False
    return True
