"""A calibration day on the simulated cell, as a new user does it: an empty folder, keys, and what the screen says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.interfaces.tui.app import CellApp
from tests.interfaces.tui.pilot import SMALL, shows
from tests.sure import sure
from tests.twin import write_profile

JOB_S = 120.0
_SIZES = {
    "stops": 60, "identify": 40, "train": 1, "validate": 19, "pair_identify": 25, "pair_validate": 15, "kind": "none",
    "null_simulations": 20,
}  # fmt: skip
_TARGETS = ("-01,", "-02,")


@pytest.fixture(autouse=True)
def _small_starter(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the first start offers is the twin with fewer stops and targets."""
    folder = tmp_path_factory.mktemp("starters")
    twin = write_profile(folder)
    text = twin.read_text("utf-8")
    for key, value in _SIZES.items():
        text, found = re.subn(rf"^(  {key}:) .*$", rf"\1 {value}", text, flags=re.MULTILINE)
        assert found == 1, key
    twin.write_text(text, "utf-8")
    targets = folder / "targets" / "twin.yaml"
    lines = targets.read_text("utf-8").splitlines()
    targets.write_text("\n".join(line for line in lines if "{name" not in line or any(t in line for t in _TARGETS)))
    monkeypatch.setattr("cellapp.cell.profile.starters.starters_folder", lambda: folder)


@pytest.mark.slow
async def test_from_an_empty_folder_to_a_verified_report() -> None:
    app = CellApp(Path("profiles"))
    async with app.run_test(size=SMALL) as pilot:
        await shows(pilot, "Welcome to cellapp", "Try the simulated twin (t)")
        await pilot.press("enter")
        await shows(pilot, "SIMULATED", "n goes to the next step")
        await pilot.press("n")
        await shows(pilot, "No run is open: plan one (keys 2, b)")
        await pilot.press("b")
        await shows(pilot, "Plan stops", "Begin (b)")
        await pilot.press("enter")
        await shows(pilot, "60 stops, 0 measured", "Next (n): collect", wait_s=JOB_S)
        await pilot.press("n")
        await shows(pilot, "READY, 60 stops", "b measures")
        await pilot.press("b")
        await shows(pilot, "Begin to collect?", "Begin (b)")
        await pilot.press("b")
        await shows(pilot, "COMPLETE, 60 stops", wait_s=JOB_S)
        await pilot.press("n")
        await shows(pilot, "Not calibrated yet: 60 of 60 stops are measured")
        await pilot.press("b")
        await shows(pilot, "held-out errors [mm]", "Next (n): discover", wait_s=JOB_S)
        await pilot.press("n")
        await shows(pilot, "Nothing was searched yet", "b searches")
        await pilot.press("b")
        await shows(pilot, "held out against a noise floor", "Next (n): push", wait_s=JOB_S)
        await pilot.press("n")
        await shows(pilot, "left-01: not compensated yet", "b Compensate")
        await pilot.press("b")
        await shows(pilot, "left-01: compensated", "Next (n): push", "m Verify", wait_s=JOB_S)
        await pilot.press("m")
        await shows(pilot, "Push and verify?", "Begin (b)")
        await pilot.press("b")
        await shows(pilot, "Next (n): report", wait_s=JOB_S)
        await pilot.press("n")
        await shows(pilot, "Errors against their tolerances", "conform")
        await pilot.press("b")
        await shows(pilot, "report: done", "Next (n): iso9283", wait_s=JOB_S)
    (folder,) = Path("logs").iterdir()
    assert (folder / "report.html").is_file()
    with RunFile.open(folder) as run:
        overview, results = run_overview(RunState(run)), read_results(run)
    assert [(stage.name, stage.out_of_date) for stage in overview.stages] == [
        (name, None) for name in ("calibrate", "discover", "compensate", "verify")
    ]
    assert overview.next_verb == "iso9283", "the profile has tolerances for tests that were not made"
    assert sure(results.verify).complaints() == []
    for arm in sure(results.verify).arms.values():
        assert arm.compensated_mm.mean < 0.1 * arm.nominal_mm.mean
