"""``pytest -m fast`` covers every package: each folder of tests has a test with that marker, read from the syntax."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.fast

TESTS = Path(__file__).parent
FOLDERS = sorted({path.parent for path in TESTS.rglob("test_*.py")})


WITHOUT_FOLDER = {"results"}
"""Types only: the fast tests of ``reporting``, ``run`` and ``cli`` write and read them."""


def is_fast(path: Path) -> bool:
    """Whether a module marks all of its tests, or at least one of them, as fast."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if ast.unparse(node) == "pytestmark = pytest.mark.fast":
            return True
        marks = node.decorator_list if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else []
        if "pytest.mark.fast" in [ast.unparse(mark) for mark in marks]:
            return True
    return False


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.relative_to(TESTS).as_posix())
def test_every_folder_has_a_fast_test(folder: Path) -> None:
    assert any(is_fast(path) for path in folder.glob("test_*.py"))


def test_every_package_has_a_folder_of_tests() -> None:
    packages = {path.parent.name for path in (TESTS.parent / "cellapp").glob("*/__init__.py")}
    packages |= {f"drivers/{path.parent.name}" for path in (TESTS.parent / "drivers").glob("*/__init__.py")}
    assert packages - {folder.relative_to(TESTS).as_posix() for folder in FOLDERS} == WITHOUT_FOLDER
