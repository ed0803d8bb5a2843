"""The wheel: what is in it, and that it works alone, in an empty folder."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SERIES = ("ur10-real", "ur10-real-d", "ur10-6d", "ur5-real")
SOURCE_FOLDERS = {
    **{"cellapp": "cellapp", "drivers": "drivers", "profiles": "cellapp/starters"},
    **{f"tests/fixtures/{name}": f"cellapp/starters/readings/{name}" for name in SERIES},
}
"""Folders of the repository, and where the wheel has them."""
WAIT_S = 120.0


def tracked(*folders: str) -> list[str]:
    """Files that belong to the project: those below the folders that are no product of running or testing it."""
    found = (path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file())
    return [path.relative_to(ROOT).as_posix() for path in found if "__pycache__" not in path.parts]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the sdist, and the wheel that was built from it; neither needs a network."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def wheel(built: Path) -> Path:
    (found,) = built.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the installed wheel and nothing else; a pure wheel is installed by unpacking it."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


COMMANDS = """
import sys
from cellapp.interfaces.cli import main

for line in sys.argv[1:]:
    sys.argv = ["cellapp", *line.split()]
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            raise
"""
"""Runs several commands in one process, which loads the numerical libraries once."""


def alone(site: Path, cwd: Path, *commands: str) -> str:
    """Run commands of the installed program in ``cwd``; what they printed on standard output."""
    done = subprocess.run(
        [sys.executable, "-P", "-W", "error", "-c", COMMANDS, *commands],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": ""},  # two processes, compiled once
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert str(ROOT) not in done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_wheel_has_every_file_of_its_packages(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    expected = set()
    for folder, place in SOURCE_FOLDERS.items():
        expected |= {place + name.removeprefix(folder) for name in tracked(folder)}
    assert packed == expected
    assert {"cellapp/py.typed", "drivers/py.typed", "cellapp/starters/paths/twin.yaml"} <= packed


@pytest.mark.slow
def test_the_sdist_has_what_a_build_and_the_tests_need(built: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    assert set(tracked(*SOURCE_FOLDERS, "tests")) <= packed
    assert {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"} <= packed


@pytest.mark.slow
def test_metadata(wheel: Path) -> None:
    import cellapp

    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        text = archive.read(name).decode("utf-8")
        assert any(name.endswith("/licenses/LICENSE") for name in archive.namelist())
    assert f"\nVersion: {cellapp.__version__}\n" in text
    assert "\nLicense-Expression: MIT\n" in text


@pytest.mark.slow
def test_from_an_empty_folder_to_a_report(site: Path, tmp_path: Path) -> None:
    """Every verb finds its templates, styles, chapters and schemas in the wheel."""
    alone(site, tmp_path, "init --from twin-small")
    profile = tmp_path / "profiles" / "twin-small.yaml"
    text = profile.read_text("utf-8").replace("stops: 80", "stops: 20")
    profile.write_text(f"{text}network: {{kind: none}}\n", "utf-8")
    verbs = ["plan profiles/twin-small.yaml --run run", *(f"{verb} run" for verb in ("collect", "calibrate", "report"))]
    printed = alone(site, tmp_path, *verbs, "certificate run", "docs targets", "docs --schema cellapp-error")
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {"report.html", "certificate.html", "run.sqlite"}
    assert "cellapp compensate" in printed
    assert '"exit_code"' in printed
