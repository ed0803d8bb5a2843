"""The simulated cell of ``profiles/twin.yaml``, made small enough for tests."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from cellapp.collection.cell import Cell
from cellapp.profile import Profile, load_profile
from drivers.clock import SimulatedClock
from drivers.plant import Plant

PROFILES = Path(__file__).parents[1] / "profiles"


def write_profile(folder: Path) -> Path:
    """Copy the profiles into ``folder``, with 30 stops for the twin and few readings in each split."""
    shutil.copytree(PROFILES, folder, dirs_exist_ok=True)
    path = folder / "twin.yaml"
    text = path.read_text("utf-8")
    sizes = {"stops": 30, "identify": 15, "train": 5, "validate": 10, "pair_identify": 10, "pair_validate": 10}
    for key, size in sizes.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    text = re.sub(r"^  iterations: .*$", "  iterations: 10", text, flags=re.MULTILINE)
    path.write_text(text, "utf-8")
    return path


def small_twin(stops: int = 30, *, plan: dict[str, Any] | None = None, plant: dict[str, Any] | None = None) -> Profile:
    """The twin with ``stops`` stops and few readings in each split; keys of its ``plan`` and ``plant`` changed."""
    profile = load_profile(PROFILES / "twin.yaml")
    assert profile.plant is not None
    splits = {"identify": 15, "train": 5, "validate_": 10, "pair_identify": 10, "pair_validate": 10}
    return profile.model_copy(
        update={
            "plan": profile.plan.model_copy(update={"stops": stops, **(plan or {})}),
            "plant": profile.plant.model_copy(update=plant or {}),
            "splits": profile.splits.model_copy(update=splits),
        }
    )


def plant_of(cell: Cell) -> Plant:
    """The plant behind an open simulated cell."""
    assert isinstance(cell.clock, SimulatedClock)
    return cell.clock.plant


def with_arms(profile: Profile, **changes: Any) -> Profile:
    """The profile with the same keys changed in both arms."""
    arms = {name: arm.model_copy(update=changes) for name, arm in profile.arms.items()}
    return profile.model_copy(update={"arms": arms})
