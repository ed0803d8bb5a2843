"""Serving the profile's tracker: the door, the token, the settings, the doctor, and the trial of the link."""

from __future__ import annotations

import os
import sys
import threading
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import tracker_driver
from cellapp.cell.driving.diagnosis import examine
from cellapp.cell.profile import load_profile
from cellapp.commands.emulate import EmulatedTracker, EmulateResult, emulate
from cellapp.commands.tracker_bridge import TrackerBridgeRequest, TrackerBridgeResult, serve_tracker, view
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import JobToken
from drivers.settings import SettingError
from drivers.trackers.bridge import BridgeTracker
from drivers.trackers.bridge_token import read_token
from drivers.trackers.protocol import Preparation, TargetLost, TrackerRefused
from tests.approved import assert_refused
from tests.commands.emulated_cell import behind_bridge, on_free_ports
from tests.twin import small_twin, write_profile
from tests.waiting import WAIT_S

pytestmark = pytest.mark.waits

PATIENT_S = WAIT_S
TOKEN = "correct horse battery staple"
behind = partial(behind_bridge, timeout=2.0)


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n", "utf-8")
    path.chmod(0o600)
    return path


def asked(**options) -> TrackerBridgeRequest:
    return TrackerBridgeRequest(profile=Path("cell.yaml"), **options)


@contextmanager
def served(profile: Profile, **options):
    cancel, up, found = JobToken(), threading.Event(), []

    def announce(where: TrackerBridgeResult) -> None:
        found.append(where)
        up.set()

    request = asked(**{"port": 0} | options)
    thread = threading.Thread(target=serve_tracker, args=(profile, request, cancel, announce))
    thread.start()
    try:
        assert up.wait(PATIENT_S)
        yield found[0]
    finally:
        cancel.cancel()
        thread.join(PATIENT_S)
    assert not thread.is_alive()


def test_a_profiles_tracker_is_served_until_cancelled(token_file: Path) -> None:
    before = threading.active_count()
    with served(small_twin(), token_file=token_file) as where:
        assert view(where).parts[0] == f"tracker (simulated) at 127.0.0.1 port {where.port}, with a token"
        url = f"socket://127.0.0.1:{where.port}"
        profile = behind(small_twin(), url, token_file=str(token_file))
        tracker = tracker_driver(profile, None)
        tracker.connect()
        assert tracker.identify().serial == "SIM-tracker"
        with pytest.raises(TargetLost):
            tracker.measure(np.array([1.0, 0.5, 0.2]), 1.0)
        tracker.disconnect()
        stranger = tracker_driver(behind(small_twin(), url), None)
        with pytest.raises(TrackerRefused, match="asks for a token"):
            stranger.connect()
    assert threading.active_count() == before


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"host": "0.0.0.0"}, "reachable from other machines: give a token"),
        ({"token_env": "CELLAPP_TEST_NO_SUCH_TOKEN"}, "CELLAPP_TEST_NO_SUCH_TOKEN is not set"),
        ({"token_file": Path("/no/such/token")}, "cannot be read"),
    ],
)
def test_a_door_that_would_stand_open_is_refused(options, why) -> None:
    with pytest.raises(InputError, match=why):
        serve_tracker(small_twin(), asked(**options), JobToken(), lambda _: pytest.fail("it listens"))


def test_a_bridge_serves_no_bridge() -> None:
    profile = behind(small_twin(), "socket://127.0.0.1:50960")
    with pytest.raises(InputError, match=r"tracker\.driver is 'bridge'; to be served it must be"):
        serve_tracker(profile, asked(), JobToken(), lambda _: None)


def test_a_port_in_use_is_said() -> None:
    with served(small_twin()) as where, pytest.raises(HardwareError, match=f"cannot listen at .* port {where.port}"):
        serve_tracker(small_twin(), asked(port=where.port), JobToken(), lambda _: None)


def test_the_token_comes_from_where_it_is_said_to_be(token_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CELLAPP_TEST_TOKEN", TOKEN)
    assert read_token(None, None) is None
    assert read_token(str(token_file), None) == TOKEN
    assert read_token(None, "CELLAPP_TEST_TOKEN") == TOKEN
    monkeypatch.setenv("CELLAPP_TEST_TOKEN", "short secret")
    with pytest.raises(SettingError, match="at least 16 printable ASCII characters") as caught:
        read_token(None, "CELLAPP_TEST_TOKEN")
    assert "short secret" not in str(caught.value)
    token_file.write_bytes(b"\xff\xfe\x00" * 20)
    with pytest.raises(SettingError, match="a binary file, not a token"):
        read_token(str(token_file), None)


@pytest.mark.skipif(sys.platform == "win32", reason="files have no such permissions there")
def test_a_token_that_others_may_read_is_none(token_file: Path) -> None:
    token_file.chmod(0o640)
    with pytest.raises(SettingError, match=f"other users may read the bridge's token; run: chmod 600 {token_file}"):
        read_token(str(token_file), None)
    assert os.stat(token_file).st_mode & 0o777 == 0o640


# -- profile -----------------------------------------------------------------------------------------------------------


def written(folder: Path, driver: str) -> Path:
    path = write_profile(folder)
    before, _, after = path.read_text("utf-8").rpartition("driver: {kind: simulated}")
    path.write_text(f"{before}driver: {driver}{after}", "utf-8")
    return path


def test_settings_that_cannot_be_are_refused_as_approved(tmp_path: Path) -> None:
    assert_refused(
        Path(__file__).parent / "approved" / "bridge-settings.txt",
        lambda driver: load_profile(written(tmp_path, driver)),
        tmp_path,
    )


# -- doctor, emulation -------------------------------------------------------------------------------------------------


def trackers_finding(profile: Profile):
    return next(finding for finding in examine(profile) if finding.subject == "tracker")


def test_the_doctor_asks_the_tracker_behind_the_bridge() -> None:
    with served(small_twin()) as where:
        profile = behind(small_twin(), f"socket://127.0.0.1:{where.port}")
        finding = trackers_finding(profile)
        assert (finding.status, finding.text.partition(",")[0]) == ("ok", "simulated tracker")
        assert finding.text.endswith(f"behind the bridge at socket://127.0.0.1:{where.port}; ready")
        holder = BridgeTracker(f"socket://127.0.0.1:{where.port}", timeout_s=2.0)
        holder.connect()
        finding = trackers_finding(profile)
        assert finding.status == "failed"
        assert "the tracker is held by 127.0.0.1" in finding.text
        holder.disconnect()
    finding = trackers_finding(profile)
    assert finding.status == "failed"
    assert "see that the tracker's computer runs 'cellapp tracker-bridge PROFILE'" in finding.text
    finding = trackers_finding(behind(small_twin(), "socket://127.0.0.1:1", token_file="/no/such/token"))
    assert finding.status == "failed"
    assert "/no/such/token" in finding.text


def test_arms_and_tracker_are_emulated_together() -> None:
    profile = behind(small_twin(), "socket://127.0.0.1:50960")
    cancel = JobToken()

    def announced(served: EmulateResult) -> None:
        assert served.tracker is not None
        tracker = BridgeTracker(f"socket://127.0.0.1:{served.tracker.port}", timeout_s=5.0, preparation=Preparation())
        tracker.connect()
        with pytest.raises(TargetLost, match="no SMR within 100 mm"):
            tracker.measure(np.array([1.0, 0.5, 0.2]), 1.0)
        tracker.disconnect()
        cancel.cancel()

    before = threading.active_count()
    anywhere = EmulatedTracker(host="127.0.0.1", port=0)
    assert emulate(profile, cancel, announced, on_free_ports(profile), pace=20.0, tracker=anywhere).tracker
    assert threading.active_count() == before
