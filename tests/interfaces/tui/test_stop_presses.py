"""Presses at a pseudo terminal reach both emulated controllers; a run says how a person left it."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path

import pytest

from tests.evidence.wire.terminal_presses import KEYS, PLACES, press_bench
from tests.loopback import free_port, own_address
from tests.twin import PROFILES

pytestmark = pytest.mark.waits

HOSTS = {"127.0.0.2": own_address(67), "127.0.0.3": own_address(68)}
TRACKER_HOST = own_address(67)
FEW = {"stops": "30\n  method: random", **dict.fromkeys(("identify", "train", "validate"), 10)}
"""Of the profile: stops that last for the presses and are soon planned."""


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """An emulated cell in a folder of its own, the only profile there."""
    for name in ("arms", "targets"):
        shutil.copytree(PROFILES / name, tmp_path / "profiles" / name)
    text = (PROFILES / "twin-rtde.yaml").read_text("utf-8")
    text = text.replace("127.0.0.1:50960", f"{TRACKER_HOST}:{free_port(TRACKER_HOST)}")
    for before, now in HOSTS.items():
        text = text.replace(before, now)
    path = tmp_path / "profiles" / "twin-rtde.yaml"
    for key, size in FEW.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    path.write_text(text, "utf-8")
    return path


def test_each_key_stops_both_controllers_and_nothing_begins_before_resume(profile: Path, tmp_path: Path) -> None:
    with press_bench(profile, tmp_path) as bench:
        bench.begin()
        assert set(bench.cell.arms) == {"left", "right"}
        presses = {key: bench.press(key, place) for key, place in zip(KEYS, PLACES, strict=False)}
    for key, (stop_ms, began) in presses.items():
        assert math.isfinite(stop_ms), key
        assert began == 0, key
