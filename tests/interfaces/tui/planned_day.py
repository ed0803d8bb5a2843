"""A day on the wire: a profile whose controllers and tracker are emulated at addresses of a test, and a planned run."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.commands.plan.run import new_planned_run
from tests.loopback import free_port, own_address
from tests.twin import PROFILES

_SETTLE_S = 0.05
"""Wall time, of which the emulated arms need less."""
_WAITS = "collection:\n  suspend: {target: {retry: 0.5}}\n"
"""The program looks for the target again after this, instead of 2 s."""
_SPLITS = {"identify": 1, "train": 0, "validate": 1, "pair_identify": 1, "pair_validate": 1}


def planned_day(folder: Path, stops: int, address: int) -> Path:
    """Write the profile and the run ``logs/day`` into a folder; the arms have own addresses from ``address`` on."""
    for name in ("arms", "targets"):
        shutil.copytree(PROFILES / name, folder / "profiles" / name)
    host = own_address(address)
    text = (PROFILES / "twin-rtde.yaml").read_text("utf-8").replace("127.0.0.1:50960", f"{host}:{free_port(host)}")
    for number, before in enumerate(("127.0.0.2", "127.0.0.3")):
        text = text.replace(f"host: {before}", f"host: {own_address(address + number)}, settle_time: {_SETTLE_S}")
    for key, size in {"stops": stops, **_SPLITS}.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    profile = folder / "profiles" / "twin-rtde.yaml"
    profile.write_text(text + _WAITS, "utf-8")
    new_planned_run(load_profile(profile), folder / "logs" / "day").close()
    return folder
