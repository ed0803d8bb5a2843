"""No file of a simulated cell passes for one of a real cell: its first line says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.exports.export_format import CommandFormat
from cellapp.cell.exports.formats import all_formats, form_line
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.export.run import export_as_run
from tests.twin import PROFILES, finished_twin

pytestmark = pytest.mark.fast


@pytest.fixture
def run(finished_copy: Path) -> Path:
    """A simulated run with commands at targets."""
    with RunFile.open(finished_copy, write=True) as run:
        compensate_run(run, load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[:2])
    return finished_copy


@pytest.mark.slow
def test_the_first_line_of_every_export_says_that_the_cell_is_simulated(run: Path, tmp_path: Path) -> None:
    with RunFile.open(run) as opened:
        for name, form in all_formats().items():
            for_one = None if name == "urdf-cell" else "left"
            out = tmp_path / f"{name}{form.suffix}"
            export_as_run(opened, name, out, for_one)
            lines = [line for line in out.read_text("utf-8").splitlines() if not line.startswith(("<?xml", "<robot"))]
            first = lines[0] if lines[0].strip() != "<!--" else lines[1]
            assert "of a simulated cell" in first, (name, lines[:3])
            assert not isinstance(form, CommandFormat) or first.startswith("# ")


def test_those_of_a_real_cell_do_not(tmp_path: Path) -> None:
    assert not load_profile(PROFILES / "ur10-real.yaml").is_simulated
    assert load_profile(PROFILES / "twin-wire.yaml").is_simulated
    assert finished_twin().is_simulated
    for form in all_formats().values():
        assert "simulated" not in form_line(form, simulated=False)
