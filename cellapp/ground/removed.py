"""What earlier versions had and this one has not: commands, keys of profiles, readings; what to do instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

VERSION = "0.1.0"
"""The version in which everything below was removed."""
_EVIDENCE = "the source's 'python -m tests.evidence' has what made the project's figures"
COMMANDS: Mapping[str, str] = {
    "follow": "'cellapp compensate DIR PATHS --out FILE' writes the joint path for the controller",
    "iso9283 compliance": "measure static compliance with a force gauge and your own dial indicator",
    "iso9283 stabilisation": "'cellapp iso9283 --run DIR' measures poses, distances, drift and paths",
    "fleet": "use 'cellapp runs FOLDER --history ARM' for an arm, 'cellapp show DIR --against DIR' for two runs",
    "check-certificate": "use 'sha256sum -c SHA256SUMS' in the folder of the certificate, and minisign or GPG",
    "sign-key": "use minisign or GPG to sign the SHA256SUMS that 'cellapp certificate DIR' writes",
    "recalibrate": "use 'cellapp calibrate DIR' and 'cellapp discover DIR' of each run; 'cellapp runs' lists them",
    "touch": "measure the arm with a tracker ('cellapp collect DIR'), or take readings of one with"
    " 'cellapp import PROFILE CSV --run NEW'",
    "replay": "'cellapp show DIR collection' lists the stops of a run and its faults, the page draws them",
    "power": "use 'cellapp trials power DIR'",
    "demo": "use 'cellapp init --demo'",
    "schema": "use 'cellapp docs --schema'",
    "at-rest": "use 'cellapp job confirm-rest DIR ARM'",
    "locate": "use 'cellapp check DIR --tracker-moved'",
    "compare": "use 'cellapp show DIR --against DIR'",
    "correct": "use 'cellapp compensate DIR PROGRAM --out FILE'",
    "pause": "use 'cellapp job pause DIR'",
    "resume": "use 'cellapp job resume DIR'",
    "abort": "use 'cellapp job abort DIR'",
    **{
        f"trials {name}": _EVIDENCE
        for name in (
            *("league", "benchmark", "blind-matrix", "truth", "paper", "parameter-sets", "coverage", "cost"),
            *("targets", "plans", "check", "signature"),
        )
    },
}
"""Name of a removed command, as it is typed -> what to do instead."""
PROFILE_KEYS: Mapping[str, str] = {
    "plant.torques": "leave it out; masses are those that the profile states",
    "notify": "delete it; in a script, call your command after 'cellapp collect DIR' by its exit code",
    "arms.*.driver.trigger_output": "delete it; the motion tells the offset of the clocks",
    **{
        f"arms.*.smr.{key}": "mount a 6-D probe (smr.probe), or import readings of three SMRs"
        for key in ("name", "nests", "distances")
    },
}
"""Removed key of a profile, with dots, ``*`` for any name or index -> what to do instead."""
READINGS: Mapping[str, tuple[str, str]] = {
    "point": ("a ball in sockets", "measure the arm with a tracker"),
    "smr": (
        "several SMRs at a stop",
        "export them as CSV, then 'cellapp import PROFILE CSV --run NEW' makes one position and rotation",
    ),
}
"""Column that only readings of a removed kind have -> what they are of, and what to do instead."""


def removed_command(name: str) -> str:
    """Return the sentence about a removed command; empty if no earlier version had it."""
    instead = COMMANDS.get(name)
    return f"'cellapp {name}' was removed in {VERSION}: {instead}" if instead else ""


def removed_readings(column: str) -> str:
    """Return what to say of readings of a removed kind, which have this column."""
    what, instead = READINGS[column]
    return f"readings of {what} were removed in {VERSION}: {instead}"


def removed_key(path: Sequence[str | int]) -> str:
    """Return what to say of a removed key at its path in a profile; empty if no earlier version had it."""
    for key, instead in PROFILE_KEYS.items():
        parts = key.split(".")
        if len(parts) == len(path) and all(part in ("*", str(at)) for part, at in zip(parts, path, strict=True)):
            return f"was removed in {VERSION}: {instead}"
    return ""


def without_removed_keys(content: Any, path: tuple[str | int, ...] = ()) -> tuple[Any, list[str]]:
    """Return plain data of a profile without its removed keys, and these keys with dots."""
    if isinstance(content, list):
        parts = [without_removed_keys(value, (*path, index)) for index, value in enumerate(content)]
        return [value for value, _ in parts], [key for _, keys in parts for key in keys]
    if not isinstance(content, dict):
        return content, []
    kept, found = {}, list[str]()
    for key, value in content.items():
        at = (*path, key)
        if removed_key(at):
            found.append(".".join(map(str, at)))
        else:
            kept[key], below = without_removed_keys(value, at)
            found += below
    return kept, found
