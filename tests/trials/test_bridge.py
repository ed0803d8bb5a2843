"""The trial of the bridge as a command. The trial itself runs with the tests of the bridge."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from tests.trials.bridge import app
from tests.twin import PROFILES

TWIN = str(PROFILES / "twin.yaml")


def test_what_became_of_the_measurements_is_said_and_stated_as_json() -> None:
    said = CliRunner().invoke(app, [TWIN, "--measurements", "4", "--every", "2"])
    assert said.exit_code == 0
    assert "4 measurements asked for, 4 delivered; 0 lost, 0 doubled, 0 mixed up" in said.stdout
    stated = CliRunner().invoke(app, [TWIN, "--measurements", "10", "--every", "5", "--json", "-"])
    found = json.loads(stated.stdout)
    assert (found["delivered"], found["lost"], found["doubled"], found["strange"]) == (10, 0, 0, 0)
