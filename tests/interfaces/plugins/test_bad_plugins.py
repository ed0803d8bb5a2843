"""Plug-ins that cannot be used: each is told with its distribution and its entry point, and all others work."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter, ValidationError

from cellapp.cell.exports.formats import format_named
from cellapp.commands.discover.run import discover_result
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.ground.errors import InputError
from cellapp.ground.profile.device_plugins import ARM_TYPES
from cellapp.robot.effects import EFFECTS
from cellapp.robot.model import CellModel
from drivers.arms.registry import ARMS
from drivers.arms.settings import ArmSettings
from drivers.plugins import Registry
from drivers.settings import OneOf
from tests.approved import assert_approved
from tests.interfaces.plugins.installed import REGISTRIES, add_distribution, add_example, installed, run_commands
from tests.twin import PROFILES, write_profile

ARM = "cellapp.drivers.arms"
EFFECT = "cellapp.robot.effects"
EXPORT = "cellapp.cell.exports"
TYPE = "cellapp.arm_types"
SETTINGS = """
from typing import Literal
from drivers.arms.settings import ArmSettings

class Half(ArmSettings):
    kind: Literal["half"] = "half"

class Whole(Half):
    def open(self, arm): ...
    def probe(self, arm, patience_s): ...

class Loose(Whole):
    kind: str = "loose"

class Unresolved(Whole):
    kind: Literal["unresolved"] = "unresolved"
    port: "Port"
"""
FORMATS = """
from cellapp.cell.exports.export_format import CellFormat
NOTE = CellFormat("note", "a note", ".txt", lambda arms, lines: "")
"""
EFFECTS_TEXT = """
from cellapp.robot.effects import Effect, LawForm
class Bare(Effect):
    slug = "bare"
class Mute(Effect):
    slug, title, meaning, variables = "mute", "mute", None, frozenset()
    forms = (LawForm("", ""),)
    def columns(self, context, law, names=None): ...
class Greedy(Mute):
    forms = (LawForm("", "words"),)
    def __init__(self, size): ...
"""
CASES = [
    (ARM, "far", "nowhere:Far"),
    (ARM, "far", "raises:Far"),
    (ARM, "far", "exits:Far"),
    (ARM, "far", "settings:Far"),
    (ARM, "far", "settings Far"),
    (ARM, "far", "formats:NOTE"),
    (ARM, "half", "settings:Half"),
    (ARM, "far", "settings:Whole"),
    (ARM, "loose", "settings:Loose"),
    (ARM, "unresolved", "settings:Unresolved"),
    (ARM, "ur", "settings:Whole"),
    (EFFECT, "far", "settings:Whole"),
    (EFFECT, "bare", "effects:Bare"),
    (EFFECT, "mute", "effects:Mute"),
    (EFFECT, "mute", "effects:Greedy"),
    (EFFECT, "far", "effects:Greedy"),
    (EFFECT, "unknown", "effects:Mute"),
    (EXPORT, "far", "settings:Whole"),
    (EXPORT, "far", "formats:NOTE"),
    (TYPE, "far.yaml", "package"),
    (TYPE, "arms/far.yaml", "package"),
    (TYPE, "far.yaml", "settings:Whole"),
]


def bad_distribution(folder: Path, groups: Mapping[str, Mapping[str, str]], name: str = "bad-one") -> Path:
    """A distribution with entry points to modules of all kinds."""
    modules = {
        "settings.py": SETTINGS,
        "formats.py": FORMATS,
        "effects.py": EFFECTS_TEXT,
        "raises.py": f'raise RuntimeError("no\\n  licence {"x" * 300}")',
        "exits.py": "raise SystemExit(3)",
    }
    (folder / "package").mkdir(parents=True)
    (folder / "package" / "__init__.py").touch()
    return add_distribution(folder, name, groups, modules)


def registry_of(group: str) -> Registry[Any]:
    return next(registry for registry in REGISTRIES if registry.group == group)


def test_bad_entries_are_refused_as_approved_and_the_rest_works(tmp_path: Path) -> None:
    said = []
    for number, (group, name, target) in enumerate(CASES):
        registry, here = registry_of(group), tmp_path / str(number)
        before = list(registry)
        with installed(bad_distribution(here / "bad", {group: {name: target}}), add_example(here / "good")):
            (bad,) = (one for one in registry.plugins if one.problem)
            assert registry.refusal(name) == ("" if name in before else bad.refusal)
            assert set(registry) - set(before) == {one.name for one in registry.plugins if not one.problem} != set()
            said.append(re.sub(r" at 0x\w+|/\d\.\d+(?=/u/)", "", bad.refusal))
        assert list(registry) == before
    assert_approved(Path(__file__).parent / "approved" / "refusals.txt", "\n".join(said))


def test_of_two_plugins_with_one_name_neither_is_used(tmp_path: Path) -> None:
    second = add_distribution(tmp_path / "second", "second", {EFFECT: {"hose_pull": "second:Hose"}}, version="2.0")
    with installed(add_example(tmp_path / "first"), second):
        assert "hose_pull" not in EFFECTS
        first, last = EFFECTS.plugins
        assert first.problem == "'hose_pull' is also in second 2.0, so neither is used"
        assert last.problem == "'hose_pull' is also in cellapp-example 1.0, so neither is used"
        found = discover_result(CellDiscovery({}, CellModel({}, None, None), None))
        assert found.notes == tuple(f"not searched for: {one.refusal}" for one in EFFECTS.plugins)
    assert discover_result(CellDiscovery({}, CellModel({}, None, None), None)).notes is None


@pytest.mark.parametrize("text", [b"", b"Metadata-Version: 2.1\nName: bad-one\n", b"Name: bad-one\nVersion: \xff\n"])
def test_a_distribution_without_name_or_version_is_refused(tmp_path: Path, text: bytes) -> None:
    folder = bad_distribution(tmp_path, {ARM: {"half": "settings:Whole"}})
    metadata = folder / "bad_one-1.0.dist-info" / "METADATA"
    metadata.write_bytes(text) if text else metadata.unlink()
    importlib.import_module("importlib_metadata")  # Dask loads it: its finder takes the place of Python's own
    with installed(folder):
        assert ARMS.plugins[0].problem == "its metadata has no name or no version", "nobody could say who took part"
        assert "half" not in ARMS


def test_a_list_of_entry_points_that_cannot_be_read_is_told_for_any_unknown_name(tmp_path: Path) -> None:
    folder = bad_distribution(tmp_path, {ARM: {"half": "settings:Whole"}})
    (folder / "bad_one-1.0.dist-info" / "entry_points.txt").write_text(f"[{ARM}]\nhalf\n", "utf-8")
    with installed(folder):
        assert ARMS.refusal("half").startswith("plug-in bad-one 1.0: its entry points cannot be read (")
        assert ARMS.refusal("ur") == ""


def test_the_first_of_two_installations_counts(tmp_path: Path) -> None:
    old = add_distribution(tmp_path / "old", "cellapp_example", {EFFECT: {"old_pull": "old:Pull"}}, version="0.9")
    with installed(add_example(tmp_path / "new"), old):
        assert [(one.name, one.version) for one in EFFECTS.plugins] == [("hose_pull", "1.0")]


def test_who_names_a_bad_plugin_is_told_why(tmp_path: Path) -> None:
    bad = bad_distribution(tmp_path, {ARM: {"far": "raises:Far"}, EXPORT: {"far": "raises:Far"}})
    with installed(bad):
        kinds = TypeAdapter[ArmSettings](Annotated[ArmSettings, OneOf(ARMS)])
        with pytest.raises(ValidationError, match=r"kind: plug-in bad-one 1\.0, kind of arm 'far' = raises:Far"):
            kinds.validate_python({"kind": "far"})
        assert kinds.validate_python({"kind": "none"}).kind == "none"
        with pytest.raises(InputError, match=r"^export: plug-in bad-one 1\.0, export 'far' = raises:Far of"):
            format_named("far")


def test_schemas_have_the_kinds_of_plugins(tmp_path: Path) -> None:
    with installed(add_example(tmp_path)):
        schema = TypeAdapter[ArmSettings](Annotated[ArmSettings, OneOf(ARMS)]).json_schema()
    assert set(schema["discriminator"]["mapping"]) == {"simulated", "ur", "none", "line"}
    assert "host" in schema["$defs"]["LineSettings"]["properties"]


def test_a_profile_that_names_a_bad_plugin_fails_and_others_do_not(tmp_path: Path) -> None:
    bad = bad_distribution(tmp_path / "bad", {ARM: {"far": "raises:Far"}, TYPE: {"far.yaml": "package"}})
    kind, type_ = (write_profile(tmp_path / name) for name in ("kind", "type"))
    kind.write_text(kind.read_text("utf-8").replace("{kind: simulated}", "{kind: far, host: x}", 1), "utf-8")
    type_.write_text(type_.read_text("utf-8").replace("arms/ur5.yaml", "far.yaml", 1), "utf-8")
    ended = run_commands([bad], f"doctor {kind}", f"doctor {type_}", f"doctor {PROFILES / 'twin.yaml'}")
    assert ended.codes == [2, 2, 0]
    assert "twin.yaml:15: arms.left.driver.kind: plug-in bad-one 1.0, kind of arm 'far' = raises:Far" in ended.err
    assert "arms.right.type: plug-in bad-one 1.0, arm type 'far.yaml' = package of [cellapp.arm_types]" in ended.err
    assert all(line.endswith("'pip uninstall bad-one'") for line in ended.err.splitlines() if line), "nothing is cut"
    assert "Traceback" not in ended.err
    assert "warning  plug-in: plug-in bad-one 1.0, kind of arm 'far'" in ended.out
    assert ARM_TYPES.get("far.yaml") is None
