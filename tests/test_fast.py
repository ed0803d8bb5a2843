"""``pytest -m fast`` covers every room: each folder of tests has a test with that marker, read from the syntax."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

pytestmark = pytest.mark.fast

TESTS = Path(__file__).parent
FOLDERS = sorted({path.parent for path in TESTS.rglob("test_*.py")})


TESTED_ELSEWHERE = {
    "interfaces/page": ("calibrate", "collect", "discover", "report", "view"),
    "interfaces/cli": ("run",),
    "cell/targets": ("compensate", "push"),
    "cell/driving": ("locate",),
    "handbook": ("docs",),
}
"""Folder of tests -> verbs that are tested there, with what they call or with what shows them."""


def is_fast(path: Path) -> bool:
    """Whether a module marks all of its tests, or at least one of them, as fast."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if ast.unparse(node) == "pytestmark = pytest.mark.fast":
            return True
        marks = node.decorator_list if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else []
        words = [ast.unparse(mark) for mark in marks]
        if "pytest.mark.fast" in words and "pytest.mark.slow" not in words:
            return True
    return False


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.relative_to(TESTS).as_posix())
def test_every_folder_has_a_fast_test(folder: Path) -> None:
    assert any(is_fast(path) for path in folder.glob("test_*.py"))


def test_every_room_has_tests_of_its_name() -> None:
    """A room is a folder in a group of the program, or in ``drivers``; its tests are a folder or a file of its name."""
    root, elsewhere = TESTS.parent, {f"commands/{verb}" for verbs in TESTED_ELSEWHERE.values() for verb in verbs}
    packages = (root / "cellapp").glob("*/*/__init__.py")
    rooms = {path.parent.relative_to(root / "cellapp").as_posix() for path in packages}
    rooms |= {f"drivers/{path.parent.name}" for path in (root / "drivers").glob("*/__init__.py")}
    files = {path.relative_to(TESTS) for path in TESTS.rglob("test_*.py")}
    tested = {parent.as_posix() for path in files for parent in path.parents}
    tested |= {(path.parent / path.stem.removeprefix("test_")).as_posix() for path in files}
    assert {TESTS / folder for folder in TESTED_ELSEWHERE} <= set(FOLDERS)
    assert rooms - tested == elsewhere | {"ground/profile"}, "the sections of the profile are tested with its loader"
