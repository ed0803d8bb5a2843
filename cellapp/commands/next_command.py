"""The command of the verb that comes next in a run."""

from __future__ import annotations

from pathlib import Path

from cellapp.commands.run_results import NextVerb


def next_command(verb: NextVerb, folder: Path) -> str:
    """The command of the verb that comes next; empty if there is none."""
    match verb:
        case "":
            return ""
        case "push":
            return f"cellapp push {folder} TARGETS --verify"
        case "compensate":
            return f"cellapp compensate {folder} TARGETS"
        case "plan":
            return "cellapp plan PROFILE --run NEW"
        case _:
            return f"cellapp {verb} {folder}"
