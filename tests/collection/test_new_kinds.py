"""A new kind of device is one module and one registry line: schema, doctor and cell then know it."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cellapp.profile import load_profile
from cellapp.safety.cell_bodies import cell_bodies
from cellapp.safety.gate import predicted_smr
from tests.twin import PROFILES, write_profile

STOPS = 30
SHIFT_M = 0.004


def toy_profile(folder: Path) -> Path:
    """The twin with toys for all devices, without its simulated cell."""
    path = write_profile(folder)
    text = path.read_text("utf-8").partition("# What the simulated cell really is")[0]
    start = '[0.0, "-90 deg", 0.0, "-90 deg", 0.0, 0.0]'
    text = text.replace("{kind: simulated}", f"{{kind: toy, start: {start}}}", 2)
    text = text.replace("{kind: simulated}", "{kind: toy, shift: 4 mm}")
    path.write_text(f"{text}\nsensors:\n  air: {{kind: toy, temperature: 23.5 degC}}\n", "utf-8")
    return path


def run_with_toys(*commands: str) -> tuple[list[int], str, str]:
    """Exit codes, standard output and standard error of commands, in one process whose registries have the toys."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.collection.cellapp_with_toys", json.dumps([line.split() for line in commands])],
        cwd=PROFILES.parent, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1]), done.stdout, done.stderr


def test_toy_devices_are_probed_opened_and_measured(tmp_path: Path) -> None:
    profile, run, readings = toy_profile(tmp_path / "profiles"), tmp_path / "run", tmp_path / "readings.csv"
    codes, out, err = run_with_toys(
        f"doctor {profile}", f"plan {profile} --run {run}", f"collect {run}", f"export {run} --csv {readings}"
    )
    assert codes == [0, 0, 0, 0], err
    assert "ok       arm left: weight: a UR10 of 6 joints weighs nothing" in out
    assert "ok       tracker: a toy that is 4 mm off" in out
    assert "ok       sensor air: air 23.5 degC, 0 s old" in out
    assert f"{STOPS} stops stored" in out
    with readings.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * STOPS
    assert {float(row["temperature_c"]) for row in rows} == {23.5}
    bodies = cell_bodies(load_profile(PROFILES / "twin.yaml"))
    for name in ("left", "right"):
        arm = [row for row in rows if row["arm"] == name]
        q = np.array([[float(row[f"q{joint}"]) for joint in range(1, 7)] for row in arm])
        p_M = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in arm])
        np.testing.assert_allclose(
            p_M - predicted_smr(bodies, name, q), np.tile([SHIFT_M, 0.0, 0.0], (STOPS, 1)), atol=1e-9
        )


@pytest.mark.parametrize(
    ("setting", "misspelt", "key", "says"),
    [
        ("shift: 4 mm", "shfit: 4 mm", "tracker.driver.shfit", "unknown key; did you mean 'shift'?"),
        ("shift: 4 mm", "shift: 4 deg", "tracker.driver.shift", "'deg' is not a unit of length"),
        ("temperature: 23.5 degC", "temprature: 23.5", "sensors.air.temprature", "did you mean 'temperature'?"),
        ("{kind: toy, start", "{kind: toys, start", "arms.left.driver.kind", "'none' or 'toy', got 'toys'"),
    ],
)
def test_a_misspelt_setting_of_a_toy_is_named(tmp_path: Path, setting: str, misspelt: str, key: str, says: str) -> None:
    profile = toy_profile(tmp_path)
    text = profile.read_text("utf-8")
    line = text[: text.index(setting)].count("\n") + 1
    profile.write_text(text.replace(setting, misspelt, 1), "utf-8")
    codes, _, err = run_with_toys(f"doctor {profile}")
    assert codes == [2]
    assert f"{profile.name}:{line}: {key}: " in err.replace("\n", "")
    assert says in err
