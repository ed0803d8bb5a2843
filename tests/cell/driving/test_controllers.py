"""The controllers of a run are recorded and compared; a UR arm of a profile is driven with what the profile says."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp import __version__
from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.driving.cell_checks import check_controllers
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import CONTROLLERS_RESULT, recorded_controllers
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import predicted_smr
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import ControllerTable
from cellapp.robot.kinematics.chain import nominal_geometry, plain_geometry
from cellapp.robot.model.nominal import published_rows
from drivers.arms.protocol import LinkLost
from drivers.arms.simulated import SimulatedArm
from drivers.findings import ArmIdentity
from tests.interfaces.plugins.installed import add_example, add_toys, installed, run_commands
from tests.interfaces.plugins.line_controller import LineController, line_controllers
from tests.twin import altered, small_twin, with_arm, write_profile

_DELTAS = ("delta_theta", "delta_d", "delta_a", "delta_alpha")
PROFILES = Path(__file__).parents[3] / "profiles"


class Known(SimulatedArm):
    """A simulated arm that says of itself what a test wants."""

    says = ArmIdentity("UR10", "20153012345", "3.15.8", None, "0000000a")
    notes: tuple[str, ...] = ()
    silent = False

    def identify(self) -> ArmIdentity:
        if self.silent:
            raise LinkLost(f"arm {self.name}: gone")
        return self.says

    def warnings(self) -> tuple[str, ...]:
        return self.notes


@pytest.fixture
def run(tmp_path: Path) -> Iterator[RunFile]:
    with RunFile.create(tmp_path / "run", small_twin(12)) as made:
        yield made


@pytest.fixture
def cell(run: RunFile, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    monkeypatch.setattr("drivers.arms.simulated.SimulatedArm", Known)
    with open_cell(run.profile) as opened:
        yield opened


def left(cell: Cell) -> Known:
    arm = cell.arms["left"]
    assert isinstance(arm, Known)
    return arm


def test_a_changed_checksum_is_refused_by_name_and_noted_where_one_insists(run: RunFile, cell: Cell) -> None:
    check_controllers(run, cell)
    left(cell).says = replace(Known.says, dh_checksum="0000000b")
    with pytest.raises(HardwareError, match=r"arm left: .* was 0000000a, now it is 0000000b.*nothing was moved$"):
        check_controllers(run, cell)
    with pytest.raises(HardwareError, match=r"nothing was moved\. Insist with --out-of-date"):
        check_controllers(run, cell, insist=False)
    (note,) = check_controllers(run, cell, insist=True)
    assert note.startswith("arm left: ")
    assert [event.text for event in run.events() if event.level == "warning"] == [note]


def test_another_calibration_than_that_of_the_profile_is_refused(run: RunFile, cell: Cell, tmp_path: Path) -> None:
    rows = published_rows(run.profile.arms["left"])
    arm = nominal_geometry(rows, np.zeros(3))
    arm.rows[1, 4] = 1e-3
    deltas = plain_geometry(arm).rows[:, :4] - rows  # the lengths of axes that are nearly parallel cancel
    assert np.abs(deltas).max() > 100.0
    table = ControllerTable(**dict(zip(_DELTAS, deltas.T.tolist(), strict=True)), checksum="0000000a")
    with RunFile.create(tmp_path / "own", with_arm(run.profile, "left", factory=table)) as own:
        with pytest.raises(HardwareError, match=r"arm left: its controller has another .*arms\.left\.factory"):
            check_controllers(own, cell)
        left(cell).says = replace(Known.says, dh_rows=tuple(map(tuple, (rows + deltas).tolist())))
        assert check_controllers(own, cell) == ()
        np.testing.assert_array_equal(recorded_controllers(own)["left"].dh_rows, rows + deltas)
        left(cell).says = replace(Known.says, dh_rows=tuple(map(tuple, (rows + 0.99 * deltas).tolist())))
        with pytest.raises(HardwareError, match="another calibration"):
            check_controllers(own, cell)


def test_another_controller_is_refused(run: RunFile, cell: Cell) -> None:
    check_controllers(run, cell)
    left(cell).says = replace(Known.says, serial="20150000000")
    with pytest.raises(HardwareError, match=r"arm left: .*began with controller 20153012345, this one is 20150000000"):
        check_controllers(run, cell)


def test_a_silent_controller_is_a_fault_of_the_hardware(run: RunFile, cell: Cell) -> None:
    left(cell).silent = True
    with pytest.raises(HardwareError, match="arm left: gone"):
        check_controllers(run, cell)


# -- the UR driver of a profile ---------------------------------------------------------------------------------------


@pytest.fixture
def real() -> Profile:
    return load_profile(PROFILES / "ur10-ur5.yaml")


def test_an_arm_of_seven_joints_is_no_ur(real: Profile) -> None:
    arm = real.arms["left"]
    seven = altered(arm, type={"joints": (*arm.type.joints, arm.type.joints[0])})
    profile = real.model_copy(update={"arms": {"left": seven}})
    with pytest.raises(InputError, match=r"arms\.left\.type: UR10 has 7 joints, a UR arm has 6"), open_cell(profile):
        pass


@pytest.mark.parametrize(
    "record",
    ['{"model": 1}', '{"model": "", "serial": "", "software": "", "dh_checksum": "a", "dh_rows": [[1, 2, 3]]}'],
)
def test_a_damaged_record_is_named(run: RunFile, cell: Cell, record: str) -> None:
    run.write_document(CONTROLLERS_RESULT, f'{{"left": {record}}}')
    with pytest.raises(InputError, match=r"the document .controllers. is damaged; start a new run"):
        check_controllers(run, cell)


# -- Kinds of devices and a type of arm from plug-ins: schema, doctor and cell know them, the safety gate as well ------

STOPS = 8
SHIFT_M = 0.004
HOME = (0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0)


@pytest.fixture
def controllers() -> Iterator[tuple[LineController, ...]]:
    """Those of both arms."""
    with line_controllers(HOME, HOME) as both:
        yield both


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example and the toys."""
    return add_toys(add_example(tmp_path_factory.mktemp("plugins")))


def foreign_profile(folder: Path, ports: tuple[int, int] = (1, 2)) -> Path:
    """The twin with devices of plug-ins and a UR3 at the right, without its simulated cell."""
    path = write_profile(folder)
    text = path.read_text("utf-8").partition("# What the simulated cell really is")[0]
    for port in ports:
        text = text.replace("{kind: simulated}", f"{{kind: line, host: 127.0.0.1, port: {port}}}", 1)
    text = text.replace("{kind: simulated}", "{kind: toy, shift: 4 mm}").replace("arms/ur5.yaml", "ur3.yaml")
    text = text.replace("stops: 30", f"stops: {STOPS}\n  method: random", 1)
    path.write_text(f"{text}\nsensors:\n  air: {{kind: toy, temperature: 23.5 degC}}\n", "utf-8")
    return path


def test_devices_of_plugins_are_probed_opened_and_measured(
    tmp_path: Path, plugins: Path, controllers: tuple[LineController, LineController]
) -> None:
    profile = foreign_profile(tmp_path / "profiles", (controllers[0].port, controllers[1].port))
    run, readings = tmp_path / "run", tmp_path / "readings.csv"
    ended = run_commands(
        [plugins],
        f"doctor {profile}",
        f"plan {profile} --run {run}",
        f"collect {run}",
        f"collect {run} --allow-motion",
        f"export {run} --csv {readings}",
        f"show {run} log",
    )
    assert ended.codes == [0, 0, 2, 0, 0, 0], ended.err
    adds = "kind of arm line, arm type ur3.yaml, effect hose_pull, export serial-link"
    assert f"ok       plug-in cellapp-example 1.0: adds {adds}" in ended.out
    assert f"ok       arm left: the controller at 127.0.0.1:{controllers[0].port} answers" in ended.out
    assert "ok       tracker: a toy that is 4 mm off" in ended.out
    assert "ok       sensor air: air 23.5 degC, 0 s old" in ended.out
    assert "this moves real arms (left, right); nothing was moved" in ended.err, "as of any arm that is not simulated"
    assert f"{STOPS} stops stored" in ended.out
    opened = f"devices opened by cellapp {__version__} with cellapp-example 1.0 (kind of arm line, effect hose_pull)"
    assert f"{opened} and cellapp-toys 1.0 (kind of tracker toy, kind of weather station toy)" in ended.out
    assert all(one.commands for one in controllers)
    check_readings(tmp_path / "nominal", plugins, readings)
    with pytest.raises(InputError, match="if a plug-in has that kind, install it"), RunFile.open(run):
        pass


def check_readings(folder: Path, plugins: Path, readings: Path) -> None:
    """Assert that each SMR was read where the chains of a UR10 and of the plug-in's UR3 have it, shifted."""
    path = write_profile(folder)
    path.write_text(path.read_text("utf-8").replace("arms/ur5.yaml", "ur3.yaml"), "utf-8")
    with installed(plugins):
        bodies = cell_bodies(load_profile(path))
    with readings.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * STOPS
    assert {float(row["temperature_c"]) for row in rows} == {23.5}
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
        ("{kind: line", "{kind: lines", "arms.left.driver.kind", "'none' or 'line', got 'lines'"),
    ],
)
def test_a_misspelt_setting_of_a_plugin_is_named(
    tmp_path: Path, plugins: Path, setting: str, misspelt: str, key: str, says: str
) -> None:
    profile = foreign_profile(tmp_path)
    text = profile.read_text("utf-8")
    line = text[: text.index(setting)].count("\n") + 1
    profile.write_text(text.replace(setting, misspelt, 1), "utf-8")
    with installed(plugins), pytest.raises(InputError) as refused:
        load_profile(profile)
    assert f"{profile.name}:{line}: {key}: " in str(refused.value)
    assert says in str(refused.value)
