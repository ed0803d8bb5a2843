"""The example lists of the twin: they load, keep what they say when they are written, and can be compensated."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.target_text import targets_text
from cellapp.cell.targets.targets import load_targets
from cellapp.robot.model import CellModel
from tests.twin import PROFILES, small_twin

EXAMPLES = ("twin-table.csv", "twin-fixture.yaml")


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_written_and_read_without_loss(name: str, tmp_path: Path) -> None:
    profile = small_twin()
    listed = load_targets(PROFILES / "targets" / name, profile)
    copy = tmp_path / "copy.yaml"
    copy.write_text(targets_text(listed), encoding="utf-8")
    assert load_targets(copy, profile) == listed


def test_the_examples_show_every_frame_and_both_arms() -> None:
    listed = [target for name in EXAMPLES for target in load_targets(PROFILES / "targets" / name, small_twin())]
    assert {target.frame for target in listed} == {"base", "tracker", "left", "right", "plate", "edge"}
    assert sum(target.partner is not None for target in listed) == 2
    assert sum(target.rpy is None for target in listed) == 1
    assert all(target.conditions.payload == 0.3 for target in listed if target.name.startswith(("hole", "pair")))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_compensated(run: RunFile, model: CellModel, name: str) -> None:
    listed = load_targets(PROFILES / "targets" / name, run.profile)
    commands = compensate(run.profile, model, listed)
    assert [(command.target.name, command.arm) for command in commands] == [
        (target.name, arm) for target in listed for arm in target.arms
    ]
    refused = {f"{command.target.name} {command.arm}": command.refusal for command in commands if command.refusal}
    assert not refused
