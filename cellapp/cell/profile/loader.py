"""Reading of a profile from YAML, with file and line of every value, or from the JSON that a run stores."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from cellapp.cell.profile.controller_file import controller_table
from cellapp.cell.profile.messages import (
    KeyPath,
    PlacedError,
    Spot,
    YamlDocument,
    described,
    dotted,
    plain,
    short,
    validation_message,
)
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import file_text
from cellapp.ground.profile.device_plugins import ARM_TYPES
from cellapp.ground.profile.schema import VERSION, ArmType, Profile
from cellapp.ground.removed import without_removed_keys
from cellapp.ground.results import plain_data
from cellapp.ground.starters import TWIN, starters_folder
from drivers.settings import Section

S = TypeVar("S", bound=BaseModel)

_MOST_LEVELS = 50
"""Limit of nesting: a profile has about eight levels; an alias that contains itself gives more."""
_MOST_VALUES = 300_000
"""Limit of values: a profile has some hundreds, a long list of targets a hundred thousand; aliases of aliases multiply
to more."""
_LARGEST_INT = 2**63
"""Limit of integers: larger ones fit neither numpy nor SQLite."""


EXPONENT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")
"""Numbers such as 1e-8 and 2.5e4, which YAML 1.1 reads as texts."""


class _Loader(yaml.SafeLoader):
    """YAML's safe loader that also reads numbers with an exponent."""


class _FastLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """The same loader on libyaml, ten times as fast; some installations of PyYAML lack it."""


for _loader in (_Loader, _FastLoader):
    _loader.add_implicit_resolver("tag:yaml.org,2002:float", EXPONENT, list("-+.0123456789"))


def load_profile(path: Path) -> Profile:
    """Read and check a profile.

    ``extends`` names a profile beside it, or one that comes with the program: keys of the file override its keys at
    every level, and ``null`` removes one. ``type`` of an arm may be the path of an arm-type file, relative to the
    profile's file, or the name of one that a plug-in brings; a file beside the profile comes first.

    Raises
    ------
    InputError
        One sentence for each of the first few errors, with file, line and key.
    """
    document = load_text(Path(path))
    return checked_profile(document, _folders(document))


def explained(path: Path) -> list[tuple[str, str, str]]:
    """Return key, value as JSON, and origin of every value of a profile: file and line, or that it is the default.

    Raises
    ------
    InputError
        As ``load_profile``.
    """
    document = load_text(Path(path))
    values = leaves(checked_profile(document, _folders(document)))
    return [(dotted(at), value, _origin(document.places, at)) for at, value in values.items()]


def _origin(places: Mapping[KeyPath, Spot], at: KeyPath) -> str:
    given = next((at[:end] for end in range(len(at), 0, -1) if at[:end] in places), ())
    has_keys = any(len(key) > len(given) and key[: len(given)] == given for key in places)
    if not given or (given != at and has_keys):  # a section that is given, without this key
        return "default"
    return f"{places[given].file}:{places[given].line}"


def leaves(profile: Profile) -> dict[KeyPath, str]:
    """Return every value of a profile as JSON, by its keys, as ("arms", "left", "base", "position", 0)."""
    return {at: json.dumps(value, ensure_ascii=False) for at, value in _walk((), json.loads(profile_to_json(profile)))}


def _walk(at: KeyPath, value: object) -> Iterator[tuple[KeyPath, object]]:
    if isinstance(value, dict) and value:
        for key, inside in value.items():
            yield from _walk((*at, str(key)), inside)
    elif isinstance(value, list) and value:
        for index, inside in enumerate(value):
            yield from _walk((*at, index), inside)
    else:
        yield at, value


def _folders(document: YamlDocument) -> tuple[Path, ...]:
    """Return the folder of a document's file, then those of the files that it extends."""
    return tuple(dict.fromkeys(Path(place.file).parent for place in (document.places[()], *document.places.values())))


def profile_from_dict(content: Mapping[str, Any], folder: Path = Path()) -> Profile:
    """Check a profile that is not a file: the keys and values of one, tuples and arrays as lists.

    Paths of arm types and meshes are relative to ``folder``.

    Raises
    ------
    InputError
        As ``load_profile``, with the key.
    """
    document = document_in_memory(plain_data(content), "profile")
    _check_version(document)
    return checked_profile(document, (folder,))


def document_in_memory(data: Any, name: str) -> YamlDocument:
    """Return plain data that are not a file as a document; ``name`` stands for the file in messages."""
    document = YamlDocument(data)
    _enter_places(document, (), data, name)
    return document


def _enter_places(document: YamlDocument, at: KeyPath, value: Any, name: str) -> None:
    """Enter the place of a value, and of all values below it."""
    document.places[at] = Spot(name, 0, at)
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inside:
        _enter_places(document, (*at, key), part, name)


def checked_profile(document: YamlDocument, folders: Sequence[Path]) -> Profile:
    """Validate a document as a profile; files that it names are in the first of ``folders`` that has them.

    Raises
    ------
    InputError
        As ``load_profile``.
    """
    _read_arm_types(document, folders)
    _locate_meshes(document, folders)
    profile = validated(Profile, document)
    _require_own_factories(profile, document.places)
    return profile


def _require_own_factories(profile: Profile, places: Mapping[KeyPath, Spot]) -> None:
    """Raise ``InputError`` if an arm's factory calibration is that of another type."""
    if any(arm.factory is not None for arm in profile.arms.values()):
        from cellapp.cell.profile.factory import require_own_factories  # numerics; other profiles load without

        require_own_factories(profile, places, own_arm_types)


def with_sections(profile: Profile, path: Path, names: Sequence[str]) -> Profile:
    """Complete a profile by a YAML file that holds some of its sections; keys of the file override the profile's.

    Raises
    ------
    InputError
        As ``load_profile``, with file and line; also for a section that is not among ``names``.
    """
    document = _parse_yaml(_read_text(path), path)
    for name in document.data:
        if name not in names:
            place = document.places[name,]
            raise PlacedError(place, f"unknown section; expected {' or '.join(repr(one) for one in names)}")
    stored = json.loads(profile_to_json(profile))
    document.data = stored | {name: _completed(stored.get(name), part) for name, part in document.data.items()}
    return validated(Profile, document)


def _completed(stored: Any, given: Any) -> Any:
    """Merge ``given`` into ``stored``, at every level: ``given`` wins, None removes, another kind replaces."""
    if not isinstance(stored, dict) or not isinstance(given, dict):
        return given
    if any(key in given and given[key] != stored.get(key) for key in ("kind", "shape")):
        return given
    merged = stored | {key: _completed(stored.get(key), value) for key, value in given.items()}
    return {key: value for key, value in merged.items() if given.get(key, "") is not None}


def load_text(path: Path) -> YamlDocument:
    """Return the plain data of a profile's file, as ``read_document``. Raises ``InputError``."""
    return read_document(_read_text(path), path)


def read_yaml(path: Path, schema: type[Section], needed: str) -> YamlDocument:
    """Return the plain data of a file other than a profile; ``needed`` says what to give where there is none.

    Raise ``InputError``.
    """
    return replace(_parse_yaml(file_text(path, needed), path), schema=schema)


def read_document(text: str, path: Path) -> YamlDocument:
    """Return the plain data of a profile's text, whose file is, or will be, ``path``. Raises ``InputError``.

    Types of arms are still the paths of their files.
    """
    document = _extended(_parse_yaml(text, path), path)
    _check_version(document)
    return document


def _extended(document: YamlDocument, path: Path, below: tuple[Path, ...] = ()) -> YamlDocument:
    """Complete a document by the profile that it extends, if any; ``below`` are those that extend this one."""
    if "extends" not in document.data:
        return document
    name, place = document.data.pop("extends"), document.places["extends",]
    base = path.parent / str(name)
    if not base.is_file() and f"{name}.yaml" in (one.name for one in starters_folder().glob("*.yaml")):
        base = starters_folder() / f"{name}.yaml"
    if not base.is_file():
        raise PlacedError(place, f"no such profile: {short(str(name))}; give a file beside this one, or '{TWIN}'")
    if base.resolve() in (path.resolve(), *below):
        raise PlacedError(place, f"{short(str(name))} extends this profile, too; one of them must stand alone")
    its = _extended(_parse_yaml(_read_text(base), base), base, (path.resolve(), *below))
    own, known = document.data.get("arms"), its.data.get("arms")
    for arm, keys in own.items() if isinstance(own, dict) and isinstance(known, dict) else ():
        if arm not in known and isinstance(keys, dict) and "type" not in keys:
            listed = ", ".join(map(str, known))
            raise PlacedError(document.places["arms", arm], f"no such arm in {base.name}, whose arms are {listed}")
    return replace(document, data=_completed(its.data, document.data), places=its.places | document.places)


def _read_arm_types(document: YamlDocument, folders: Sequence[Path]) -> None:
    """Replace the paths of arm types by the contents of the files: from the first of ``folders``, else from a plug-in.

    The paths of the controllers' own calibrations are replaced, too.

    Raises
    ------
    InputError
        If no such file exists, or it cannot be read.
    """
    for at, arm in _with_text(document, "arms", "type"):
        arm_type = _read_arm_type(folders, arm["type"], document.places[at])
        arm["type"] = arm_type.data
        document.places |= {at + inside: place for inside, place in arm_type.places.items()}
    for at, arm in _with_text(document, "arms", "factory"):
        arm["factory"] = _read_controller(folders, arm["factory"], document.places[at], arm.get("type"))


def _with_text(document: YamlDocument, section: str, key: str) -> Iterator[tuple[KeyPath, dict[str, Any]]]:
    """Yield the entries of a section that have a text as ``key``, with the path of that."""
    entries = document.data.get(section)
    for name, entry in (entries if isinstance(entries, dict) else {}).items():
        if isinstance(entry, dict) and isinstance(entry.get(key), str):
            yield (section, name, key), entry


def arm_type_of_text(text: str, path: Path) -> ArmType:
    """Parse the text of an arm type whose file is ``path``. Raise ``InputError`` with file and line."""
    return validated(ArmType, replace(_parse_yaml(text, path), schema=ArmType))


def validated(schema: type[S], document: YamlDocument) -> S:
    """Return a document as its type. Raise ``InputError`` with file, line and key of the first wrong values."""
    try:
        return schema.model_validate(document.data)
    except ValidationError as error:
        raise InputError(validation_message(error, document)) from None


def own_arm_types() -> dict[str, ArmType]:
    """Return the arm types of this program, by their short names."""
    paths = sorted((starters_folder() / "arms").glob("*.yaml"))
    return {path.stem: arm_type_of_text(_read_text(path), path) for path in paths}


def _locate_meshes(document: YamlDocument, folders: Sequence[Path]) -> None:
    """Replace the paths of mesh files by absolute ones, in the first of ``folders`` that has the file.

    Raises
    ------
    InputError
        If none of them has it.
    """
    for at, obstacle in _with_text(document, "obstacles", "file"):
        advice = "give the path of an STL file relative to the profile's file"
        obstacle["file"] = str(_found_file(folders, obstacle["file"], document.places[at], advice).resolve())


def profile_to_json(profile: Profile) -> str:
    """Return a profile as one JSON text that needs no other file than the meshes of obstacles.

    ``profile_from_json`` returns an equal profile.
    """
    return profile.model_dump_json(by_alias=True)


def profile_from_json(text: str) -> Profile:
    """Return the profile that ``profile_to_json`` wrote, removed keys ignored. Raise ``InputError`` for other text."""
    try:
        content, _ = without_removed_keys(json.loads(text))
        profile = Profile.model_validate_json(json.dumps(content))
    except (ValueError, RecursionError) as error:
        if not isinstance(error, ValidationError):
            raise InputError(f"stored profile: text: not JSON ({error})") from None
        first = error.errors(include_url=False)[0]
        where = ".".join(str(key) for key in first["loc"])
        hint = "; if a plug-in has that kind, install it" if first["type"] == "union_tag_invalid" else ""
        raise InputError(f"stored profile: {where or 'text'}: {plain(first['msg'])}{hint}") from None
    _require_own_factories(profile, {})
    return profile


def _check_version(document: YamlDocument) -> None:
    version = document.data.get("version")
    if isinstance(version, int) and not isinstance(version, bool) and version > VERSION:
        raise InputError(
            f"{document.places['version',]}: this profile is of version {version}, this cellapp reads versions up to"
            f" {VERSION}; install a newer cellapp"
        )


def _read_arm_type(folders: Sequence[Path], name: str, place: Spot) -> YamlDocument:
    path = _first_file(folders, name) or ARM_TYPES.get(name)
    if path is None and (refusal := ARM_TYPES.refusal(name)):
        raise PlacedError(place, refusal)
    path = path or _found_file(folders, name, place, "give a path relative to the profile's file, or the keys here")
    return _parse_yaml(_read_text(path), path)


_DESCRIBED = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")


def _described(path: Path, arm_type: object) -> dict[str, object]:
    """Return a section ``factory`` from a ``default_kinematics.yaml`` of UR's ROS description: poses of joints."""
    import numpy as np  # late: profiles without such a file load without numerics

    from cellapp.robot.kinematics.chain import plain_rows_of
    from cellapp.robot.kinematics.transforms import rotation_zyx, transform

    joints, found = _parse_yaml(_read_text(path), path).data, []
    try:
        for name in _DESCRIBED:
            x, y, z, roll, pitch, yaw = (float(joints["kinematics"][name][key]) for key in _ORIGIN)
            found.append(transform(rotation_zyx(yaw, pitch, roll), [x, y, z]))
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{path}: no default_kinematics.yaml: expected under 'kinematics' {', '.join(_DESCRIBED)}, each with"
            f" {', '.join(_ORIGIN)}; or give the calibration.conf of the controller"
        ) from None
    rows = [[one.theta, one.d, one.a, one.alpha] for one in ArmType.model_validate(arm_type).joints]
    if len(rows) != len(found):
        raise InputError(f"{path}: poses of {len(found)} joints; the arm's type has {len(rows)}")
    deltas = (plain_rows_of(np.array(found), np.array(rows)) - np.array(rows)).T.tolist()
    return dict(zip(("delta_theta", "delta_d", "delta_a", "delta_alpha"), map(tuple, deltas), strict=True))


def _read_controller(folders: Sequence[Path], name: str, place: Spot, arm_type: object) -> dict[str, object]:
    advice = (
        "give the calibration.conf of the controller, relative to the profile's file: 'cellapp doctor PROFILE"
        " --controllers FOLDER' writes one"
    )
    path = _found_file(folders, name, place, advice)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _described(path, arm_type)
    return controller_table(_read_text(path), path)


def _first_file(folders: Sequence[Path], name: str) -> Path | None:
    """Return the path of the first of ``folders`` that has a file of that name; None if none has."""
    for path in (folder / name for folder in folders):
        with contextlib.suppress(OSError, ValueError):  # a name too long for the file system, or with a null character
            if path.is_file():
                return path
    return None


def _found_file(folders: Sequence[Path], name: str, place: Spot, advice: str) -> Path:
    """Return ``_first_file``. Raise ``InputError`` with an ``advice`` if there is none."""
    if (path := _first_file(folders, name)) is None:
        raise PlacedError(place, f"file not found: {short(str(folders[0] / name), 200)}; {advice}")
    return path


# -- YAML with its lines ----------------------------------------------------------------------------------------------


def _require_few_levels(text: str) -> None:
    """Raise ``RecursionError`` for too deep nesting: libyaml recurses in C, which would end the process."""
    loader, level = _FastLoader(text), 0
    while loader.check_event():
        event = loader.get_event()
        level += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if level > _MOST_LEVELS:
            raise RecursionError


def _parse_yaml(text: str, path: Path, reader: type[yaml.SafeLoader] = _FastLoader) -> YamlDocument:
    """Return the plain data of a text; Python's own loader reports errors, libyaml does not name what is wrong."""
    try:
        if reader is _FastLoader:
            _require_few_levels(text)
        loader = reader(text)
        node = loader.get_single_node()
        if node is None:
            raise InputError(f"{path}: the file is empty; expected a mapping of keys to values")
        if not isinstance(node, yaml.MappingNode):
            raise InputError(f"{path}:{_line(node)}: expected keys with values at the top, got {described(node)}")
        places = dict[KeyPath, Spot]()
        return YamlDocument(_plain_data(node, (), Spot(str(path), _line(node), ()), places, loader), places)
    except yaml.YAMLError as error:
        if reader is _FastLoader:
            return _parse_yaml(text, path, _Loader)
        if isinstance(error, yaml.MarkedYAMLError) and (at := error.problem_mark):
            raise InputError(f"{path}:{at.line + 1}: not YAML: {error.problem}; check indentation and quotes") from None
        line = text.count("\n", 0, getattr(error, "position", None)) + 1
        raise InputError(f"{path}:{line}: not YAML: {getattr(error, 'reason', error)}; remove that character") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply; a file has a handful of levels") from None


def _read_text(path: Path) -> str:
    if path.is_fifo():  # reading would wait endlessly for a writer
        raise InputError(f"{path}: is a pipe, not a file; save the profile as a file and give its path")
    return file_text(path, "give a profile such as profiles/twin.yaml")


def _plain_data(node: yaml.Node, at: KeyPath, place: Spot, places: dict[KeyPath, Spot], loader: yaml.SafeLoader) -> Any:
    """Return a node as dict, list, text, number, bool or None; enter its place and those below it into ``places``."""
    if len(at) > _MOST_LEVELS:
        raise InputError(f"{place}: nested too deeply; a file has a handful of levels")
    if len(places) > _MOST_VALUES:
        raise InputError(f"{place.file}: more than {_MOST_VALUES} values; no file needs them")
    places[at] = place
    if isinstance(node, yaml.MappingNode):
        return _mapping(node, at, place, places, loader)
    if isinstance(node, yaml.SequenceNode):
        return [
            _plain_data(item, (*at, index), Spot(place.file, _line(item), (*place.inside, index)), places, loader)
            for index, item in enumerate(node.value)
        ]
    return _scalar(node, place, loader)


def _mapping(
    node: yaml.MappingNode, at: KeyPath, place: Spot, places: dict[KeyPath, Spot], loader: yaml.SafeLoader
) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = key_node.value if isinstance(key_node, yaml.ScalarNode) else None
        if key is None or key_node.tag != "tag:yaml.org,2002:str":
            text = f"'{short(key)}'" if key is not None else "this"
            raise InputError(
                f"{place.file}:{_line(key_node)}: {text} is not a key; a key is a word, or put it in quotes"
            )
        here = Spot(place.file, _line(key_node), (*place.inside, key))
        if key in result:
            raise InputError(f"{here}: duplicate key (first in line {places[*at, key].line}); keep one")
        result[key] = _plain_data(value_node, (*at, key), here, places, loader)
    return result


def _scalar(node: yaml.Node, place: Spot, loader: yaml.SafeLoader) -> str | int | float | bool | None:
    kind = node.tag.removeprefix("tag:yaml.org,2002:")
    if kind == "timestamp":
        return str(node.value)
    if kind not in ("str", "int", "float", "bool", "null"):
        raise InputError(f"{place}: '{node.tag}' is not used here; write a number, a text or true/false")
    try:
        value: str | int | float | bool | None = loader.construct_object(node)
    except (ValueError, KeyError):
        raise InputError(
            f"{place}: '{short(node.value)}' is not of type {kind}; write a number, a text, true or false"
        ) from None
    infinite = isinstance(value, float) and not math.isfinite(value)
    # an infinite stiffness in the plant's effects means a rigid joint
    if infinite and (value != math.inf or place.inside[:2] != ("plant", "effects")):
        raise InputError(f"{place}: expected a finite number, got {node.value}")
    if isinstance(value, str) and re.search("[\ud800-\udfff]", value):
        raise InputError(f"{place}: half a character (an escape such as \\ud800); write the whole character")
    if isinstance(value, int) and abs(value) > _LARGEST_INT:
        raise InputError(f"{place}: {str(node.value)[:20]}... is too large a number")
    return value


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1
