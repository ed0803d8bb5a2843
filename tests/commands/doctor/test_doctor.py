"""The doctor names every unmet point and never waits long; emulated controllers take the place of real ones."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.diagnosis import LONGEST_PROBE_S, examine
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.doctor.run import _end_left_programs, examine_run
from cellapp.commands.emulate import emulate, emulated_arms
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken
from drivers.arms.protocol import JointLimits, LinkLost
from drivers.arms.ur_probe import UrKinematics, UrProbe, probe_ur
from drivers.arms.ur_rtde_reader import UrSample
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import FREE_PORTS, ControllerConfig, UrControllerServer, personality
from drivers.findings import Finding
from drivers.plant import Plant
from tests.approved import assert_approved
from tests.commands.emulated_cell import on_free_ports, quiet_work
from tests.twin import PROFILES, altered, small_twin, with_arm, with_obstacles

PATIENT_S = 10.0
SAMPLE = UrSample(
    time_s=10.0,
    q=(0.0, -1.57, 0.0, -1.57, 0.0, 0.0),
    qd=(0.0,) * 6,
    robot_mode="RUNNING",
    safety_mode="NORMAL",
    program="STOPPED",
    speed_fraction=1.0,
    payload_kg=0.35,
    payload_center_m=(0.015, 0.0, 0.03),
)
READY = UrProbe(
    host="192.168.0.10",
    software="3.15.8.106339",
    series="CB3",
    model="UR10",
    serial="20153012345",
    robot_mode="RUNNING",
    safety_mode="NORMAL",
    safety_status=None,
    remote_control=None,
    program_running=False,
    ports={30001: True, 30003: True, 30004: True},
    kinematics=None,
    kinematics_note="not asked",
    limits=JointLimits(np.tile([-6.2832, 6.2832], (6, 1)), np.full(6, 3.15), np.full(6, 40.0)),
    tcp=(0.0, 0.0, 0.06, 0.0, 0.0, 0.0),
    sample=SAMPLE,
)


def with_driver(profile: Profile, arm: str, **changes: object) -> Profile:
    return with_arm(profile, arm, driver=changes)


def findings(profile: Profile, said: Callable[[str, float], UrProbe] = probe_ur) -> dict[str, Finding]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drivers.arms.ur_probe.probe_ur", said)
        found = examine(profile)
    assert len({finding.subject for finding in found}) == len(found)
    return {finding.subject: finding for finding in found}


@pytest.fixture
def twin() -> Profile:
    return load_profile(PROFILES / "twin.yaml")


@pytest.fixture
def real() -> Profile:
    """The real cell, the left arm's serial number given."""
    return with_driver(load_profile(PROFILES / "ur10-ur5.yaml"), "left", serial="20153012345")


@pytest.fixture(autouse=True)
def fast_link(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.arms.ur_probe.time_link", lambda host, timeout_s, look: (1e-3, "round trip 1.0 ms"))


def one_ready(host: str, timeout_s: float) -> UrProbe:
    return READY if host == "192.168.0.10" else replace(READY, host=host, model="UR5", serial="20153567890")


CHECKSUM = "00000001-00000002-00000003-00000004-00000005-00000006"
CALIBRATED = replace(READY, kinematics=UrKinematics(((0.0, 0.1, 0.0, 0.0),) * 6, CHECKSUM))
E_SERIES = replace(READY, series="e-Series", software="5.11.1.1108318", safety_status="NORMAL", remote_control=True)


def reporting(**changes: Any) -> UrProbe:
    """The ready controller, its arm in another state."""
    return replace(READY, sample=replace(SAMPLE, **changes))


def tight(high: float = 6.2832, speed: float = 3.15) -> UrProbe:
    """The ready controller, its third joint held tighter."""
    assert READY.limits is not None
    position, speeds = READY.limits.position.copy(), READY.limits.speed.copy()
    position[2, 1], speeds[2] = high, speed
    return replace(READY, limits=JointLimits(position, speeds, READY.limits.acceleration))


SAID = {
    "ready": READY,
    "another model": replace(READY, model="UR5"),
    "an e-Series": E_SERIES,
    "no model": replace(READY, model=None),
    "another serial number": replace(READY, serial="20150000000"),
    "no serial number": replace(READY, serial=None),
    "protective stop": replace(READY, safety_mode="PROTECTIVE_STOP"),
    "two points": replace(READY, safety_mode="PROTECTIVE_STOP", serial="20150000000"),
    "reduced": replace(READY, safety_mode="REDUCED"),
    "an unknown mode": replace(READY, safety_mode="NEW_MODE"),
    "no safety mode": replace(READY, safety_mode=None),
    "safeguard stop": replace(READY, safety_status="SAFEGUARD_STOP"),
    "power off": replace(READY, robot_mode="POWER_OFF"),
    "local control": replace(E_SERIES, remote_control=False),
    "unknown control": replace(E_SERIES, remote_control=None),
    "a program runs": replace(READY, program_running=True),
    "a closed port": replace(READY, ports={30004: False}),
    "no state": replace(READY, sample=None, sample_note="port 30004: silent"),
    "it moves": reporting(qd=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0)),
    "slider at 40 %": reporting(speed_fraction=0.4),
    "slider at 0": reporting(speed_fraction=0.0),
    "slider unknown": reporting(speed_fraction=None),
    "a program is paused": reporting(program="PAUSED"),
    "another payload": reporting(payload_kg=0.2),
    "another centre": reporting(payload_center_m=(0.015, 0.0, 0.05)),
    "payload unknown": reporting(payload_kg=None),
    "limits unknown": replace(READY, limits=None),
    "tight position": tight(high=2.0),
    "tight speed": tight(speed=0.5),
    "calibrated": CALIBRATED,
}


OBSTACLES = """
table: {shape: box, size: [1.0, 3.0, 0.1], pose: {position: [0.0, 0.0, -0.15]}}
lamp: {shape: sphere, radius: 0.1, pose: {position: [0.0, 0.0, 1.0]}}
tool: {shape: box, fixed_to: flange, arm: left, size: [0.1, 0.1, 0.1]}
hose: {shape: capsule, fixed_to: flange, arm: right, radius: 0.02, length: 0.1}
"""


def unsafe(twin: Profile) -> dict[str, Profile]:
    """Simulated cells that are not safe, or not whole."""
    near, inside = (
        f"post: {{shape: sphere, radius: 0.1, pose: {{position: [0.0, {y}, 0.5]}}}}" for y in (-0.62, -0.85)
    )
    return {
        "readings from a file": load_profile(PROFILES / "ur10-real.yaml"),
        "home in the floor": with_arm(twin, "left", home=(0.0, 0.6, 0.0, -1.5, 0.0, 0.0)),
        "no bodies": with_arm(twin, "right", type={"capsules": ()}),
        "an SMR that is never seen": with_arm(twin, "left", smr={"normal": (0.0, 0.0, -1.0), "acceptance": 0.1}),
        "an unknown effect": altered(twin, plant={"effects": {"left": {"witchcraft": {}}}}),
        "obstacles": with_obstacles(OBSTACLES),
        "an obstacle too near to home": with_obstacles(near, small_twin(plan={"clearance": 0.08})),
        "an obstacle around an arm": with_obstacles(inside),
    }


def stated(real: Profile) -> dict[str, tuple[Profile, UrProbe]]:
    """Real cells that state more, or other things, than their controllers."""
    arm = real.arms["left"]
    seven = arm.type.model_copy(update={"joints": (*arm.type.joints, arm.type.joints[-1])})
    tcp = (0.0, 0.0, 0.06, 0.0, 0.0, 0.0)
    wrong = {"tcp": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), "checksum": "0000000f" + CHECKSUM[8:]}
    return {
        "TCP and checksum as stated": (with_driver(real, "left", tcp=tcp, checksum=CHECKSUM), CALIBRATED),
        "TCP and checksum of others": (with_driver(real, "left", **wrong), CALIBRATED),
        "seven joints": (with_arm(real, "left", type=seven, home=(*(arm.home or ()), 0.0), limits=None), READY),
        "two arms at one address": (with_driver(real, "right", host="192.168.0.10"), READY),
    }


def test_what_the_doctor_finds_is_as_approved(real: Profile, twin: Profile) -> None:
    cells = {**{name: (real, said) for name, said in SAID.items()}, **stated(real)}
    cells |= {name: (profile, READY) for name, profile in unsafe(twin).items()}
    text: list[str] = []
    ready: set[Finding] = set()
    for name, (profile, said) in cells.items():

        def answers(host: str, _: float, left: UrProbe = said) -> UrProbe:
            return left if host == "192.168.0.10" else one_ready(host, 0.0)

        found = findings(profile, answers)
        text.append(f"# {name}")
        found.pop("python", None)  # it is said of the computer itself
        text += [f"{one.status}: {one.subject}: {one.text}" for one in found.values() if one not in ready]
        ready = ready or set(found.values())
    told = "\n".join(text).replace(f"this is {sys.platform}", "this is another")
    assert_approved(Path(__file__).parent / "approved" / "findings.txt", told)


def test_what_a_device_reports_is_a_value_and_no_text(real: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    warm = replace(READY, sample=replace(SAMPLE, joints_c=(25.0, 26.0, 27.0, 28.0, 29.0, 30.5)))
    monkeypatch.setattr("drivers.arms.ur_probe.probe_ur", lambda host, timeout_s: warm)
    result = examine_run(real)
    link = next(finding for finding in result.findings if finding.subject == "arm left: link")
    assert link.device is not None
    assert (link.device.model, link.device.serial, link.device.state) == ("UR10", "20153012345", "RUNNING, NORMAL")
    assert link.device.joints_c == (25.0, 26.0, 27.0, 28.0, 29.0, 30.5)
    again = DoctorResult.from_json(result.to_json(), "doctor")
    assert again == result
    assert {finding.subject.split(":")[0] for finding in result.failed} <= {"arm right", "tracker"}


def test_dead_hosts_are_asked_at_the_same_time_and_not_for_long(real: Profile) -> None:
    together = threading.Barrier(2)  # broken, and the test fails, if one is asked after the other

    def dead(host: str, timeout_s: float) -> UrProbe:
        assert timeout_s <= LONGEST_PROBE_S
        together.wait(PATIENT_S)
        raise LinkLost(f"{host}: no answer")

    found = findings(with_driver(real, "right", timeout=60.0), dead)
    assert found["arm left: link"] == Finding("arm left: link", "failed", "192.168.0.10: no answer")
    assert found["arm right: link"] == Finding("arm right: link", "failed", "192.168.0.11: no answer")
    assert "arm left: model" not in found


def test_looking_at_a_twin_loads_neither_torch_nor_a_device_library() -> None:
    code = (
        "import sys; from pathlib import Path; from cellapp.cell.driving.diagnosis import examine;"
        f" from cellapp.cell.profile import load_profile; examine(load_profile(Path({str(PROFILES / 'twin.yaml')!r})));"
        " sys.exit(','.join({'torch', 'rtde_control', 'serial', 'clr'} & set(sys.modules)) or None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("answer", ["no", "yes"])
def test_a_program_that_a_cellapp_left_is_ended_after_one_question(
    real: Profile, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    asked, ended = list[str](), list[UrSettings]()
    monkeypatch.setattr(UrSettings, "left_program", lambda self: "another cellapp, on vm, run night")
    monkeypatch.setattr(UrSettings, "end_program", lambda self: ended.append(self))

    def choose(words: str, answers: object) -> str:
        asked.append(words)
        return answer

    work = replace(quiet_work(), choose=choose)
    found = DoctorResult(findings=(Finding(subject="arm left: program", status="failed", text="it runs"),))
    assert _end_left_programs(real, found, work) is (answer == "yes")
    (words,) = asked
    assert words.startswith("arm left: a program of another cellapp, on vm, run night, runs on its controller.")
    assert ended == ([real.arms["left"].driver] if answer == "yes" else [])


# -- emulate ----------------------------------------------------------------------------------------------------------


def test_ur_arms_are_stood_in_for_on_loopback_hosts_only(real: Profile) -> None:
    with pytest.raises(InputError, match="no controller to emulate"):
        emulated_arms(real)
    arms = emulated_arms(with_driver(real, "left", host="127.0.0.5"))
    assert [(arm.arm, arm.host, arm.controller.serial) for arm in arms] == [("left", "127.0.0.5", "20153012345")]
    both = with_driver(with_driver(real, "left", host="127.0.0.1"), "right", host="localhost")
    with pytest.raises(InputError, match=r"arms\.right\.driver\.host"):
        emulated_arms(both)


def test_only_ur_arms_are_stood_in_for(twin: Profile) -> None:
    other = twin.arms["left"].type.model_copy(update={"model": "IRB 120"})
    with pytest.raises(InputError, match="IRB 120"):
        emulated_arms(with_arm(twin, "left", type=other))
    e_series = twin.arms["left"].type.model_copy(update={"model": "UR10e"})
    controller = emulated_arms(with_arm(twin, "left", type=e_series))[0].controller
    assert (controller.series, controller.model) == ("e-Series", "UR10")


def test_a_port_in_use_is_named_and_nothing_is_left_open(twin: Profile) -> None:
    before = threading.active_count()
    other = ControllerConfig("other", "127.0.0.3", personality("CB3", "UR5", "20150000001"), ports=FREE_PORTS)
    with UrControllerServer([other]) as server:
        _, taken = server.addresses.arms["other"]["dashboard"]
        left, right = on_free_ports(twin)
        arms = [left, right.model_copy(update={"dashboard_port": taken})]
        with pytest.raises(HardwareError, match=rf"arm right: cannot listen on 127\.0\.0\.3:{taken}"):
            emulate(twin, JobToken(), lambda _: None, arms)
    assert threading.active_count() == before


def test_a_simulated_cell_that_fails_ends_the_emulation(twin: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    up = threading.Event()

    def fails_once_it_runs(profile: Profile, *, watch_clearance: bool = False) -> Plant:
        plant = build_plant(profile)
        advance = plant.advance

        def failing(duration_s: float) -> None:
            if up.is_set():
                raise FloatingPointError("no equilibrium")
            advance(duration_s)

        monkeypatch.setattr(plant, "advance", failing)
        return plant

    monkeypatch.setattr("cellapp.commands.emulate.build_plant", fails_once_it_runs)
    before = threading.active_count()
    with pytest.raises(HardwareError, match=r"cannot go on \(FloatingPointError: no equilibrium\)"):
        emulate(twin, JobToken(), lambda _: up.set(), on_free_ports(twin))
    assert threading.active_count() == before


def test_the_real_cell_has_a_table_and_a_pillar_and_is_safe_at_home() -> None:
    profile = load_profile(PROFILES / "ur10-ur5.yaml")
    assert {"table", "pillar"} <= set(profile.obstacles)
    assert refuse_stop(cell_bodies(profile), home_positions(profile)) == ""
