"""Read the examples of chapters as the program reads such files: profiles, targets, paths, results."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from cellapp.cell.planning.plan_csv import read_plan_csv
from cellapp.cell.profile import load_profile
from cellapp.cell.targets.path import load_paths
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.docs.schema import json_schema, results_by_name, written_results
from cellapp.commands.init.answers import write_answers
from cellapp.commands.registry import records
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import ArmType
from tests.cell.run.small_runs import read_readings_csv
from tests.handbook.chapters import EXCERPT, Example

STARTER = "twin"
"""The profile that examples of sections complete."""
_WHOLE = frozenset({"driver", "base", "pose", "smr", "type"})
"""Keys whose value replaces that of the starter as a whole."""
_LISTS: Mapping[str, Callable[[Path, Profile], object]] = {"cellapp-targets": load_targets, "cellapp-paths": load_paths}
_ARM_TYPE = {"model", "joints"}
"""Keys that an arm type has."""
_ANSWERS = {"name", "arms", "tracker"}
"""Sections that the answers of ``init --answers`` have; a profile has its schema, too."""


def read_example(example: Example, profiles: Path) -> None:
    """Read a block that is no command; ``profiles`` is a folder with the starter profile, its arms and its targets.

    Raises
    ------
    Exception
        Whatever that door of the program raises; ``ValueError`` if there is no door.
    """
    match example.language:
        case "yaml":
            _read_yaml(example, profiles)
        case "csv" if EXCERPT not in example.words:
            _read_csv(_written(example, profiles / "example.csv"), load_profile(profiles / f"{STARTER}.yaml"))
        case "python":
            compile(example.text, str(example.path), "exec")
        case "json":
            _read_json(example)
        case "toml":
            tomllib.loads(example.text)
        case "" | "text":
            for line in example.text.splitlines():
                if line.startswith("cellapp "):
                    raise ValueError("a command outside a block ```sh; begin it so, or the line with $")
        case "sh" | "csv" | "dockerfile" | "html" | "xml":
            pass
        case other:
            raise ValueError(f"no test reads ```{other}; write text, or add a door to {__name__}")


def merged(example: Example, profiles: Path) -> dict[str, Any]:
    """The starter profile with the sections of a block, at the place that ``part=`` names if it does."""
    given: Any = yaml.safe_load(example.text)
    for key in reversed(example.value("part").split(".") if example.value("part") else []):
        given = {key: given}
    if not isinstance(given, dict):
        raise ValueError("expected sections of a profile")
    starter = yaml.safe_load((profiles / f"{STARTER}.yaml").read_text("utf-8"))
    return dict(_completed(starter, given))


def _completed(starter: Any, given: Any) -> Any:
    if not isinstance(starter, dict) or not isinstance(given, dict):
        return given
    return starter | {
        key: value if key in _WHOLE else _completed(starter.get(key), value) for key, value in given.items()
    }


def _read_yaml(example: Example, profiles: Path) -> None:
    content = yaml.safe_load(example.text)
    if EXCERPT in example.words:
        return
    path = _written(example, profiles / "example.yaml")
    schema = content.get("schema") if isinstance(content, dict) else None
    if isinstance(schema, str) and schema in _LISTS:
        _LISTS[schema](path, load_profile(profiles / f"{STARTER}.yaml"))
    elif schema is None and isinstance(content, dict) and set(content) >= _ARM_TYPE:
        ArmType.model_validate(content)
    elif schema is None and isinstance(content, dict) and set(content) >= _ANSWERS:
        new = profiles / "answers"
        shutil.rmtree(new, ignore_errors=True)
        load_profile(Path(write_answers(path, new).profile))
    else:
        path.write_text(yaml.safe_dump(merged(example, profiles)), encoding="utf-8")
        load_profile(path)


def _read_csv(path: Path, profile: Profile) -> None:
    """Read a table as what its columns say: a plan, readings or targets."""
    columns = set(path.read_text("utf-8").partition("\n")[0].split(","))
    if {"configuration", "point"} <= columns:
        read_plan_csv(path, profile)
    elif "configuration" in columns:
        read_readings_csv(path, {name: len(arm.type.joints) for name, arm in profile.arms.items()})
    else:
        load_targets(path, profile)


def _read_json(example: Example) -> None:
    content = json.loads(example.text)
    results = results_by_name(written_results(records()))
    if isinstance(content, dict) and content.get("schema") in results:
        jsonschema.validate(content, json_schema(results[content["schema"]]))


def _written(example: Example, path: Path) -> Path:
    path.write_text(example.text, encoding="utf-8")
    return path
