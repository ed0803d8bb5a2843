"""``doctor --bundle``: what a report to the authors holds, and that it holds no secret."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.doctor.bundle import REDACTED, bundle, newest_run, redacted, run_log
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.doctor.run import run as doctor
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import ControllerConfig, UrControllerServer, personality
from drivers.findings import Finding
from drivers.trackers.bridge_settings import BridgeSettings
from tests.approved import assert_refused
from tests.commands.emulated_cell import quiet_work
from tests.loopback import own_address
from tests.twin import PROFILES, altered, small_twin

TOKEN = "s3cret-token-of-sixteen"
PASSWORD = "hunter2hunter2"
FOUND = DoctorResult(findings=(Finding(subject="python", status="ok", text=f"the token is {TOKEN}"),))


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Profile:
    """A cell whose tracker has a token, and whose command has a password."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "token"
    file.write_text(TOKEN + "\n")
    file.chmod(0o600)
    monkeypatch.setenv("KEY_PASSPHRASE", PASSWORD)
    driver = BridgeSettings(url="socket://127.0.0.1:50960", token_file=str(file))
    twin = small_twin()
    return altered(twin, tracker={"driver": driver}, name="bundled")


def unpacked(data: bytes) -> dict[str, str]:
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        assert file.testzip() is None
        return {name: file.read(name).decode() for name in file.namelist()}


def test_no_secret_is_packed_and_the_newest_run_is(cell: Profile, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    with RunFile.create(tmp_path / "logs" / "first", cell) as run:
        run.log("warning", f"the bridge refused {TOKEN}, passphrase {PASSWORD}")
        run.log("error", "-----BEGIN PRIVATE KEY-----\nMC4CAQAw\n")
    (tmp_path / "cellapp-error.log").write_text(f"Traceback\n  password='{PASSWORD}' url=http://me:{PASSWORD}@host/\n")
    folder = newest_run(cell)
    assert folder == Path("logs/first")
    parts = unpacked(bundle(tmp_path / "cell.yaml", cell, FOUND, run_log(folder), 1.5))
    assert set(parts) == {
        *("versions.json", "doctor.json", "profile.json", "profile.yaml", "timings.json"),
        *("run-log.txt", "run-left-out.txt", "cellapp-error.log"),
    }
    for name, text in parts.items():
        for secret in (TOKEN, PASSWORD, "MC4CAQAw"):
            assert secret not in text, name
    assert f"the bridge refused {REDACTED}" in parts["run-log.txt"]
    assert json.loads(parts["profile.json"])["arms"]["left"]["type"]["model"] == cell.arms["left"].type.model
    assert {"cellapp", "python", "numpy"} <= set(json.loads(parts["versions.json"]))
    assert json.loads(parts["timings.json"])["doctor_s"] == 1.5


def test_states_of_a_controller_are_packed(tmp_path: Path) -> None:
    twin, host = small_twin(), own_address(75)
    arms = {"left": twin.arms["left"].model_copy(update={"driver": UrSettings(host=host)})}
    config = ControllerConfig("left", host, personality("CB3", "UR10", "20153012345"))
    with UrControllerServer([config]):
        states = arms["left"].driver.excerpt(5.0)
    assert [state["robot_mode"] for state in states] == ["RUNNING"] * 50
    assert (np.diff(np.array([state["received_s"] for state in states], dtype=float)) >= 0.0).all()
    (lost,) = arms["left"].driver.excerpt(0.5)
    assert "error" in lost
    profile = twin.model_copy(update={"arms": arms})
    parts = unpacked(bundle(PROFILES / "twin.yaml", profile, FOUND, {}, 0.0))
    assert "error" in json.loads(parts["rtde-left.jsonl"])
    assert parts["profile.yaml"] == (PROFILES / "twin.yaml").read_text("utf-8")


def test_the_command_writes_one_file_and_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    work, profile = quiet_work(), PROFILES / "twin.yaml"
    result = doctor(DoctorRequest(profile=profile, bundle=Path("report.zip")), work)
    assert result.written == (Path("report.zip"),)
    packed = DoctorResult.from_json(unpacked(Path("report.zip").read_bytes())["doctor.json"], "test")
    assert packed.findings == result.findings
    with pytest.raises(InputError, match="exists already"):
        doctor(DoctorRequest(profile=profile, bundle=Path("report.zip")), work)
    with pytest.raises(InputError, match="there is no run"):
        doctor(DoctorRequest(profile=profile, bundle=Path("other.zip"), run_folder=tmp_path), work)
    assert load_profile(profile).name


def test_secrets_are_known_by_where_they_stand_as_approved() -> None:
    assert_refused(Path(__file__).parent / "approved" / "redacted.txt", lambda text: redacted(text, ["abc"]))
