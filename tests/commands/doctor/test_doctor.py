"""The doctor names every unmet point and never waits long; emulated controllers take the place of real ones."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.examination import LONGEST_PROBE_S, examine
from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.doctor.run import _end_left_programs, examine_run
from cellapp.commands.emulate import EmulatedArm, emulate, emulated_arms
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from drivers.arms.protocol import JointLimits, LinkLost
from drivers.arms.ur_probe import UrKinematics, UrProbe, probe_ur
from drivers.arms.ur_rtde_reader import UrSample
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import FREE_PORTS, ControllerConfig, UrControllerServer, personality
from drivers.findings import Finding
from drivers.plant import Plant
from tests.commands.free_ports import on_free_ports
from tests.commands.quiet_work import quiet_work

PROFILES = Path(__file__).parents[3] / "profiles"
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
    greeting="Connected: Universal Robots Dashboard Server",
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


def change(profile: Profile, arm: str, **changes: object) -> Profile:
    """A profile with another driver section or the like for one arm."""
    changed = profile.arms[arm].model_copy(update=changes)
    return profile.model_copy(update={"arms": {**profile.arms, arm: changed}})


def with_driver(profile: Profile, arm: str, **changes: object) -> Profile:
    return change(profile, arm, driver=profile.arms[arm].driver.model_copy(update=changes))


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


def test_the_simulated_cell_is_sound(twin: Profile) -> None:
    found = findings(twin)
    assert {finding.status for finding in found.values()} == {"ok"}
    assert {"arm left", "arm right", "home", "plant", "arm left: SMR", "arm right: SMR", "tracker"} <= set(found)


def test_readings_from_a_file_need_no_device() -> None:
    found = findings(load_profile(PROFILES / "ur10-real.yaml"))
    assert found["arm left"].text == "no device: readings come from a file"
    assert {finding.status for finding in found.values()} == {"ok"}


def test_an_unsafe_home_is_refused(twin: Profile) -> None:
    home = (0.0, 0.6, 0.0, -1.5, 0.0, 0.0)  # bent down into the floor
    found = findings(change(twin, "left", home=home))["home"]
    assert found.status == "failed"
    assert "arm left" in found.text
    assert "floor" in found.text


def test_arms_without_bodies_are_refused(twin: Profile) -> None:
    bare = twin.arms["right"].type.model_copy(update={"capsules": ()})
    found = findings(change(twin, "right", type=bare))["home"]
    assert found.status == "failed"
    assert "arm right has no bodies" in found.text


def test_an_smr_that_is_never_seen_is_refused(twin: Profile) -> None:
    away = twin.arms["left"].smr.model_copy(update={"normal": (0.0, 0.0, -1.0), "acceptance": 0.1})
    found = findings(change(twin, "left", smr=away))
    assert found["arm left: SMR"].status == "failed"
    assert "smr.normal" in found["arm left: SMR"].text


def test_an_unknown_effect_of_the_plant_is_refused(twin: Profile) -> None:
    assert twin.plant is not None
    plant = twin.plant.model_copy(update={"effects": {"left": {"witchcraft": {}}}})
    found = findings(twin.model_copy(update={"plant": plant}))["plant"]
    assert found.status == "failed"
    assert "witchcraft" in found.text


def test_a_ready_controller_fails_in_nothing(real: Profile) -> None:
    found = findings(real, one_ready)
    failed = {subject for subject, finding in found.items() if finding.status == "failed"}
    assert failed == {"tracker"}
    assert found["arm left: timing"] == Finding("arm left: timing", "ok", "round trip 1.0 ms")
    assert found["arm left: motion"] == Finding("arm left: motion", "ok", "no check failed; no motion was tried")
    assert "LMF needs Windows" in found["tracker"].text
    assert found["arm left: serial"].status == "ok"
    assert found["arm right: serial"].status == "warning"  # the profile does not give it
    assert '"20153567890"' in found["arm right: serial"].text
    assert found["arm left: kinematics"] == Finding(
        "arm left: kinematics", "warning", "the controller's own D-H could not be read: not asked"
    )


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


E_SERIES = replace(READY, series="e-Series", software="5.11.1.1108318", safety_status="NORMAL", remote_control=True)


CALIBRATED = UrKinematics(
    theta=(0.0,) * 6, d=(0.1,) * 6, a=(0.0,) * 6, alpha=(0.0,) * 6, checksums=(1, 2, 3, 4, 5, 6), status=2
)


def reporting(sample: UrSample) -> UrProbe:
    """The ready controller, its arm in another state."""
    return replace(READY, sample=sample)


def tight(high: float = 6.2832, speed: float = 3.15) -> UrProbe:
    """The ready controller, its third joint held tighter."""
    assert READY.limits is not None
    position, speeds = READY.limits.position.copy(), READY.limits.speed.copy()
    position[2, 1], speeds[2] = high, speed
    return replace(READY, limits=JointLimits(position, speeds, READY.limits.acceleration))


@pytest.mark.parametrize(
    ("said", "subject", "status", "words"),
    [
        (replace(READY, model="UR5"), "model", "failed", ["UR5", "UR10", "swapped"]),
        (E_SERIES, "model", "failed", ["UR10e", "UR10"]),
        (replace(READY, model=None), "model", "warning", ["UR10"]),
        (replace(READY, serial="20150000000"), "serial", "failed", ["20150000000", "20153012345"]),
        (replace(READY, serial=None), "serial", "warning", ["20153012345"]),
        (replace(READY, safety_mode="PROTECTIVE_STOP"), "safety", "failed", ["PROTECTIVE_STOP", "see what stopped it"]),
        (replace(READY, safety_mode="REDUCED"), "safety", "failed", ["REDUCED", "limited"]),
        (replace(READY, safety_mode="NEW_MODE"), "safety", "failed", ["NEW_MODE", "pendant"]),
        (replace(READY, safety_mode=None), "safety", "failed", ["pendant"]),
        (replace(READY, safety_status="SAFEGUARD_STOP"), "safety", "failed", ["SAFEGUARD_STOP"]),
        (replace(READY, robot_mode="POWER_OFF"), "robot mode", "failed", ["POWER_OFF", "power the arm on"]),
        (replace(E_SERIES, remote_control=False), "remote control", "failed", ["Local to Remote"]),
        (replace(E_SERIES, remote_control=None), "remote control", "warning", ["Remote"]),
        (E_SERIES, "remote control", "ok", ["on"]),
        (replace(READY, program_running=True), "program", "failed", ["not this driver's runs", "pendant"]),
        (replace(READY, ports={30004: False}), "port 30004", "failed", ["firewall"]),
        (replace(READY, sample=None, sample_note="port 30004: silent"), "state", "failed", ["30004: silent"]),
        (reporting(replace(SAMPLE, qd=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0))), "state", "failed", ["the arm moves"]),
        (reporting(replace(SAMPLE, speed_fraction=0.4)), "speed slider", "warning", ["40%", "longer"]),
        (reporting(replace(SAMPLE, speed_fraction=0.0)), "speed slider", "failed", ["0 %", "raise it"]),
        (reporting(replace(SAMPLE, speed_fraction=None)), "speed slider", "warning", ["does not report"]),
        (reporting(replace(SAMPLE, program="PAUSED")), "program", "failed", ["paused", "pendant"]),
        (READY, "safety limits", "ok", ["not asked", "every planned stop"]),
        (reporting(replace(SAMPLE, payload_kg=0.2)), "payload", "failed", ["0.200 kg", "0.350 kg", "pendant"]),
        (
            reporting(replace(SAMPLE, payload_center_m=(0.015, 0.0, 0.05))),
            "payload",
            "failed",
            ["50.0] mm", "30.0] mm"],
        ),
        (reporting(replace(SAMPLE, payload_kg=None)), "payload", "warning", ["does not report", "0.350 kg"]),
        (READY, "TCP", "ok", ["60.0] mm", "not stated in the profile"]),
        (replace(READY, limits=None), "joint limits", "warning", ["pendant"]),
        (tight(high=2.0), "joint limits", "failed", ["joint 3", "114.6", "150.0", "speed_scale"]),
        (tight(speed=0.5), "joint limits", "failed", ["joint 3", "28.6 deg/s", "45.0"]),
        (replace(READY, kinematics=CALIBRATED), "kinematics", "ok", ["00000001-", "calibrated"]),
    ],
)
def test_every_unmet_point_is_named_with_what_to_do(
    real: Profile, said: UrProbe, subject: str, status: str, words: list[str]
) -> None:
    found = findings(real, lambda host, _: said if host == "192.168.0.10" else one_ready(host, 0.0))
    finding = found[f"arm left: {subject}"]
    assert finding.status == status
    assert all(word in finding.text for word in words), finding.text
    assert "arm right: model" in found


def test_all_that_would_be_refused_is_summed_up(real: Profile) -> None:
    both = replace(READY, safety_mode="PROTECTIVE_STOP", serial="20150000000")
    found = findings(real, lambda host, _: both if host == "192.168.0.10" else one_ready(host, 0.0))
    assert found["arm left: motion"].status == "failed"
    assert "because of serial, safety; no motion was tried" in found["arm left: motion"].text
    assert found["arm right: motion"].status == "ok"


def test_what_the_profile_states_of_tcp_and_checksum_is_compared(real: Profile) -> None:
    checksum = "00000001-00000002-00000003-00000004-00000005-00000006"

    def said(host: str, _: float) -> UrProbe:
        return replace(one_ready(host, 0.0), kinematics=CALIBRATED)

    right = with_driver(real, "left", tcp=(0.0, 0.0, 0.06, 0.0, 0.0, 0.0), checksum=checksum)
    found = findings(right, said)
    assert (found["arm left: TCP"].status, found["arm left: kinematics"].status) == ("ok", "ok")
    wrong = with_driver(real, "left", tcp=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), checksum="0000000f" + checksum[8:])
    found = findings(wrong, said)
    assert found["arm left: TCP"].status == "failed"
    assert "60.0] mm" in found["arm left: TCP"].text
    assert "100.0] mm" in found["arm left: TCP"].text
    assert found["arm left: kinematics"].status == "warning"  # the model is stale, the arm may move
    assert "0000000f" in found["arm left: kinematics"].text
    assert "stale" in found["arm left: kinematics"].text


def test_an_arm_of_seven_joints_is_no_ur(real: Profile) -> None:
    arm = real.arms["left"]
    seven = arm.type.model_copy(update={"joints": (*arm.type.joints, arm.type.joints[-1])})
    profile = change(real, "left", type=seven, home=(*(arm.home or ()), 0.0), limits=None)
    assert "7 joints, a UR arm has 6" in findings(profile, one_ready)["arm left: type"].text


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


def test_two_arms_at_one_address_are_refused(real: Profile) -> None:
    found = findings(with_driver(real, "right", host="192.168.0.10"), one_ready)
    assert found["arm left: address"].status == "failed"
    assert "arm right" in found["arm left: address"].text


def test_looking_at_a_twin_loads_neither_torch_nor_a_device_library() -> None:
    code = (
        "import sys; from pathlib import Path; from cellapp.cell.driving.examination import examine;"
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


def test_simulated_arms_are_stood_in_for_on_addresses_of_their_own(twin: Profile) -> None:
    arms = emulated_arms(twin)
    assert [(arm.arm, arm.controller.model, arm.host) for arm in arms] == [
        ("left", "UR10", "127.0.0.2"),
        ("right", "UR5", "127.0.0.3"),
    ]
    assert {(arm.dashboard_port, arm.primary_port) for arm in arms} == {(29999, 30001)}
    assert arms[0].controller.rows[1][2] == -0.612
    assert len({arm.controller.serial for arm in arms}) == 2


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
        emulated_arms(change(twin, "left", type=other))
    e_series = twin.arms["left"].type.model_copy(update={"model": "UR10e"})
    controller = emulated_arms(change(twin, "left", type=e_series))[0].controller
    assert (controller.series, controller.model) == ("e-Series", "UR10")


def test_the_doctor_finds_emulated_controllers_until_they_are_cancelled(real: Profile) -> None:
    profile = with_driver(with_driver(real, "left", host="127.0.0.2"), "right", host="127.0.0.3")
    cancel = CancelToken()
    listening: list[EmulatedArm] = []

    def at_their_ports(host: str, timeout_s: float) -> UrProbe:
        arm = next(arm for arm in listening if arm.host == host)
        ports = {name: getattr(arm, name) for name in ("dashboard_port", "primary_port", "script_port", "rtde_port")}
        return probe_ur(host, timeout_s, **ports)

    found: dict[str, Finding] = {}

    def announced(arms: object) -> None:
        assert isinstance(arms, list)
        listening.extend(arms)
        found.update(findings(profile, at_their_ports))
        cancel.cancel()

    before = threading.active_count()
    emulate(profile, cancel, announced, on_free_ports(profile))
    assert threading.active_count() == before
    first = listening[0]
    assert (first.controller.model, first.controller.serial, first.host) == ("UR10", "20153012345", "127.0.0.2")
    failed = {subject for subject, finding in found.items() if finding.status == "failed"}
    assert failed == {"tracker"}
    assert found["arm left: payload"].text == "0.350 kg at [15.0, 7.0, 30.0] mm"
    assert found["arm left: joint limits"].status == "ok"
    assert found["arm left: model"].text == "UR10"
    assert found["arm right: model"].text == "UR5"
    assert found["arm left: kinematics"].status == "ok"


def test_emulation_waits_until_it_is_cancelled(twin: Profile) -> None:
    cancel, up = CancelToken(), threading.Event()
    thread = threading.Thread(target=emulate, args=(twin, cancel, lambda _: up.set(), on_free_ports(twin)))
    thread.start()
    assert up.wait(PATIENT_S)
    assert thread.is_alive()
    cancel.cancel()
    thread.join(PATIENT_S)
    assert not thread.is_alive()


def test_a_port_in_use_is_named_and_nothing_is_left_open(twin: Profile) -> None:
    before = threading.active_count()
    other = ControllerConfig("other", "127.0.0.3", personality("CB3", "UR5", "20150000001"), ports=FREE_PORTS)
    with UrControllerServer([other]) as server:
        _, taken = server.addresses.arms["other"]["dashboard"]
        left, right = on_free_ports(twin)
        arms = [left, right.model_copy(update={"dashboard_port": taken})]
        with pytest.raises(HardwareError, match=rf"arm right: cannot listen on 127\.0\.0\.3:{taken}"):
            emulate(twin, CancelToken(), lambda _: None, arms)
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
        emulate(twin, CancelToken(), lambda _: up.set(), on_free_ports(twin))
    assert threading.active_count() == before


def test_waiting_on_a_token_ends_early_when_it_is_cancelled() -> None:
    cancel = CancelToken()
    assert cancel.wait(0.0) is False
    cancel.cancel()
    began = time.monotonic()
    assert cancel.wait(60.0) is True
    assert time.monotonic() - began < 30.0
