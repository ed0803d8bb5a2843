"""The storm on the wire: its draws and checks, and a small one from end to end."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.evidence.wire.storm import storm_trial
from tests.evidence.wire.storm_cell import undisturbed_profile, wire_profile
from tests.evidence.wire.storm_faults import FAULTS, KILL, drawn_events
from tests.evidence.wire.storm_operator import stored
from tests.loopback import free_port, own_address, own_arms
from tests.twin import PROFILES

pytestmark = pytest.mark.waits

HOSTS = own_arms(51)
TRACKER_HOST = own_address(51)


def at_own_addresses() -> Profile:
    """The cell on the wire at addresses of this test."""
    profile = load_profile(PROFILES / "twin-rtde.yaml")
    arms = {
        name: arm.model_copy(update={"driver": arm.driver.model_copy(update={"host": HOSTS[name]})})
        for name, arm in profile.arms.items()
    }
    url = f"socket://{TRACKER_HOST}:{free_port(TRACKER_HOST)}"
    driver = profile.tracker.driver.model_copy(update={"url": url})
    return profile.model_copy(update={"arms": arms, "tracker": profile.tracker.model_copy(update={"driver": driver})})


def test_events_are_of_all_kinds_and_in_order() -> None:
    events = drawn_events(400, 200, 50, ("left", "right"), np.random.default_rng(3))
    counts = Counter(event.kind for event in events)
    assert counts.pop(KILL) == 50
    assert set(counts) == set(FAULTS) - {KILL}
    assert max(counts.values()) - min(counts.values()) <= 1
    assert [event.at_stop for event in events] == sorted(event.at_stop for event in events)
    assert max(event.at_stop for event in events) < 320
    assert events == drawn_events(400, 200, 50, ("left", "right"), np.random.default_rng(3))


def test_a_storm_needs_devices_that_can_be_emulated_here() -> None:
    profile = at_own_addresses()
    assert wire_profile(profile, 7).plan.stops == 7
    with pytest.raises(InputError, match=r"arms\.left\.driver: a storm needs kind 'ur' at a loopback address"):
        wire_profile(undisturbed_profile(profile), 7)
    left = profile.arms["left"]
    real = left.model_copy(update={"driver": left.driver.model_copy(update={"host": "192.168.1.2"})})
    with pytest.raises(InputError, match="at a loopback address"):
        wire_profile(profile.model_copy(update={"arms": {**profile.arms, "left": real}}), 7)
    with pytest.raises(InputError, match="'plant'"):
        wire_profile(profile.model_copy(update={"plant": None}), 7)


def test_a_folder_that_exists_is_not_written_to(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give the path of a new folder"):
        storm_trial(at_own_addresses(), 4, 0, 0, keep=tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs loopback addresses beyond 127.0.0.1")
def test_a_small_storm_loses_and_doubles_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    result = storm_trial(at_own_addresses(), 6, 2, 1, seed=1, keep=folder)
    printed = (folder / "output.txt").read_text("utf-8", errors="replace")
    assert result.complaints == (), printed
    assert (result.faults, result.kills) == (2, 1)
    assert (result.lost, result.doubled, result.motions_after_a_stop) == (0, 0, 0)
    assert result.readings + len(result.missing) == 12
    assert result.clearance_mm is not None
    assert result.clearance_mm > 0.0
    assert "Traceback" not in printed
    with RunFile.open(folder / "run") as run:
        assert len(run.sessions()) <= result.sessions
        assert run.sessions()[-1].outcome == "complete"
    assert len(stored(folder / "run")) == result.readings
