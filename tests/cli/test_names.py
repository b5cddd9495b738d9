"""`import cadcam` offers its names lazily, and type checkers see the same ones."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path

import pytest

import cadcam

SOURCE = Path(cadcam.__file__).read_text()


@pytest.mark.parametrize("name", sorted(cadcam._HOME))
def test_every_lazy_name_exists(name: str) -> None:
    assert getattr(cadcam, name) is not None
    assert name in dir(cadcam)


def test_type_checkers_see_the_same_names_from_the_same_modules() -> None:
    block = next(n for n in ast.parse(SOURCE).body if isinstance(n, ast.If))
    seen = {}
    for node in block.body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                seen[alias.asname or alias.name] = (node.module, alias.name)
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
            seen[ast.unparse(node.targets[0])] = seen.pop(node.value.id)
    lazy = {}
    for name, home in cadcam._HOME.items():
        module, _, original = home.partition(":")
        lazy[name] = (module, original or name)
    assert seen == lazy


@pytest.mark.parametrize("name", sorted(cadcam._HOME))
def test_what_a_name_takes_by_default_has_a_name_too(name: str) -> None:
    """Who wants other options than the default ones must be able to make them."""
    offered = getattr(cadcam, name)
    asked = inspect.signature(offered).parameters if inspect.isfunction(offered) or is_dataclass(offered) else {}
    for parameter in asked.values():
        kind = type(parameter.default)
        if kind.__module__.startswith("cadcam.") and is_dataclass(kind):
            assert kind.__name__ in cadcam._HOME


def test_no_name_hides_a_subpackage() -> None:
    folders = {p.name for p in Path(cadcam.__file__).parent.iterdir() if p.is_dir()}
    assert not folders & set(cadcam._HOME)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'kalibrate'"):
        _ = cadcam.kalibrate


def test_a_misspelt_name_is_met_with_the_nearest() -> None:
    script = "import cadcam; cadcam.find_boards"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "AttributeError: module 'cadcam' has no attribute 'find_boards'. Did you mean: 'find_board'?" in ran.stderr


def test_errors_are_told_apart_without_an_import_of_their_own() -> None:
    script = "import cadcam; print(issubclass(cadcam.errors.NoBoard, cadcam.CadcamError))"
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ran.stdout == "True\n", ran.stderr
