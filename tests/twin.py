"""The simulated cell of ``profiles/twin.yaml``, made small enough for tests."""

from __future__ import annotations

import functools
import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, TypeAdapter

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.profile import load_profile
from cellapp.cell.targets.targets import load_targets
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import AnyObstacle, Obstacles
from drivers.clock import SimulatedClock
from drivers.plant import Plant

PROFILES = Path(__file__).parents[1] / "profiles"


def write_profile(folder: Path) -> Path:
    """Copy the profiles into ``folder``, with 30 stops for the twin and few readings in each split."""
    shutil.copytree(PROFILES, folder, dirs_exist_ok=True)
    path = folder / "twin.yaml"
    make_small(path)
    return path


def write_few_targets(path: Path) -> None:
    """Write three targets of the twin: one with a tolerance that is met, one that is not, one without."""
    listed = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())[:3]
    keys = [one.model_dump(include={"name", "arm", "position", "rpy"}) for one in listed]
    few = [*({**one, "tolerance": size} for one, size in zip(keys, (2e-3, 1e-6), strict=False)), keys[2]]
    path.write_text(json.dumps({"schema": "cellapp-targets", "version": 1, "targets": few}), "utf-8")


def make_small(path: Path) -> None:
    """Give the twin's profile in a file 30 stops and few readings in each split."""
    text = path.read_text("utf-8")
    sizes = {"stops": 30, "identify": 15, "train": 5, "validate": 10, "pair_identify": 10, "pair_validate": 10}
    for key, size in sizes.items():
        text, found = re.subn(rf"^  {key}: .*$", f"  {key}: {size}", text, flags=re.MULTILINE)
        assert found == 1, key
    text = re.sub(r"^  iterations: .*$", "  iterations: 10", text, flags=re.MULTILINE)
    path.write_text(text, "utf-8")


@functools.cache
def whole_twin() -> Profile:
    """The cell of ``profiles/twin.yaml``, read once: profiles are frozen, and reading takes longer than most tests."""
    return load_profile(PROFILES / "twin.yaml")


def small_twin(stops: int = 30, *, plan: dict[str, Any] | None = None, plant: dict[str, Any] | None = None) -> Profile:
    """The twin with ``stops`` stops and few readings in each split; keys of its ``plan`` and ``plant`` changed."""
    profile = whole_twin()
    splits = {"identify": 15, "train": 5, "validate_": 10, "pair_identify": 10, "pair_validate": 10}
    return altered(profile, plan={"stops": stops, **(plan or {})}, plant=plant or {}, splits=splits)


HIDDEN = {
    "left": {"joint_compliance": {"stiffness": [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]}},
    "right": {"backlash": {"play": [2.0e-4, 2.0e-4, 1.0e-4, 0.0, 0.0, 0.0]}},
}
"""Effects of the simulated cell that discovery finds from 120 stops."""


def finished_twin(stops: int = 120) -> Profile:
    """The twin with two hidden effects and enough stops to find them."""
    profile = small_twin(stops, plant={"effects": HIDDEN})
    share = stops / 120
    sizes = {"identify": 80, "train": 1, "validate_": 39, "pair_identify": 50, "pair_validate": 30}
    return altered(profile, splits={key: max(1, int(size * share)) for key, size in sizes.items()})


def plant_of(cell: Cell) -> Plant:
    """The plant behind an open simulated cell."""
    assert isinstance(cell.clock, SimulatedClock)
    return cell.clock.plant


def opening(change: Callable[[Cell], None]) -> Callable[..., Any]:
    """Open the cell of a profile and do something to it first."""

    @contextmanager
    def opened(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options) as cell:
            change(cell)
            yield cell

    return opened


Model = TypeVar("Model", bound=BaseModel)


def altered(model: Model, **changes: Any) -> Model:
    """The model with keys changed; where a mapping is given, keys of the model there, or of models by their names."""
    update = {}
    for key, value in changes.items():
        now = getattr(model, key)
        if isinstance(value, Mapping) and isinstance(now, BaseModel):
            value = altered(now, **value)
        elif isinstance(value, Mapping) and isinstance(now, Mapping):
            value = _altered_by_name(now, value)
        update[key] = value
    return model.model_copy(update=update)


def _altered_by_name(now: Mapping[str, Any], changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """The models with keys of some changed, or what is given instead of all of them."""
    if not changes or not all(isinstance(now.get(name), BaseModel) for name in changes):
        return changes
    if any(isinstance(its, BaseModel) for its in changes.values()):
        return changes
    return {**now, **{name: altered(now[name], **its) for name, its in changes.items()}}


def with_arm(profile: Profile, name: str, **changes: Any) -> Profile:
    """The profile with keys of one arm changed."""
    return altered(profile, arms={name: changes})


def with_arms(profile: Profile, **changes: Any) -> Profile:
    """The profile with the same keys changed in both arms."""
    return altered(profile, arms=dict.fromkeys(profile.arms, changes))


def with_obstacles(text: str, profile: Profile | None = None) -> Profile:
    """The profile, or the small twin, with the obstacles of a text as it stands in files of profiles."""
    obstacles = TypeAdapter[dict[str, AnyObstacle]](Obstacles).validate_python(yaml.safe_load(text))
    return (profile or small_twin()).model_copy(update={"obstacles": obstacles})
