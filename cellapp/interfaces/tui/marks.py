"""Marks of the steps, as a sign and in words: what each step concluded, as completion alone is not a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from cellapp.interfaces.tui.workspace import STEPS, Step, Workspace, step_of

if TYPE_CHECKING:
    from cellapp.commands.conclusions import Conclusion

Kind = Literal["open", "next", "running", "done", "conforms", "cannot say", "part", "does not conform", "out of date"]
SIGNS: Mapping[Kind, str] = {
    "open": " ",
    "next": "▸",
    "running": "…",
    "done": "✓",
    "conforms": "≤",
    "cannot say": "?",
    "part": "◐",
    "does not conform": "✗",
    "out of date": "!",
}
"""Sign of each kind: ``done`` is done and up to date, ``conforms`` is within its tolerance given its uncertainty."""
_ENDED = ("complete", "accurate enough")


@dataclass(frozen=True)
class Mark:
    """Progress of a step, also in words; ``is_next`` if it is the next step, whatever its mark."""

    kind: Kind
    words: str
    is_next: bool = False


def marks_of(workspace: Workspace, measured: int, planned: int, left: int, running: Step | None) -> dict[Step, Mark]:
    """Return the mark of every step; ``running`` is the step that a job does now."""
    marks: dict[Step, Mark] = {step: Mark("open", "not begun") for step in STEPS}
    if workspace.profile is not None:
        marks["cell"] = Mark("done", "a profile is open")
    if workspace.overview is not None:
        marks["plan"] = (
            Mark("done", f"{planned} stops are planned") if planned else Mark("done", "readings are imported")
        )
    if measured:
        marks["collect"] = _collected(workspace, measured, planned, left)
    marks.update(_concluded(workspace))
    after = workspace.next_step
    for step, mark in marks.items():
        if step == running:
            marks[step] = Mark("running", "a job does it now")
        elif step == after:
            marks[step] = Mark("next" if mark.kind == "open" else mark.kind, mark.words, is_next=True)
    return marks


def _collected(workspace: Workspace, measured: int, planned: int, left: int) -> Mark:
    collection = workspace.collection
    if collection is not None and collection.missing_share > collection.tolerated_share:
        return Mark("part", f"{collection.missing_share:.0%} of the planned readings are missing")
    last = None if collection is None else collection.last
    accurate = last is not None and last.outcome == "accurate enough"
    if left and not accurate:
        return Mark("part", f"{measured} of {planned} stops are measured")
    return Mark("done", f"{measured} stops are measured" + (", accurate enough" if left else ""))


def _concluded(workspace: Workspace) -> dict[Step, Mark]:
    """Return the marks of steps with stored results: the worst valid conclusion, or that something is out of date."""
    found: dict[Step, list[Conclusion]] = {}
    for stage, conclusion in workspace.conclusions.items():
        if (step := step_of(stage)) is not None:  # a later version may have other stages
            found.setdefault(step, []).append(conclusion)
    if not found and not workspace.overview:
        return {}
    from cellapp.commands.conclusions import Conclusion, worst  # late: only needed once a run was read

    accept = found.setdefault("accept", [])
    if workspace.overview is not None and workspace.overview.complaints:  # that screen lists them all
        accept.append(Conclusion("out of date", "; ".join(workspace.overview.complaints)))
    if workspace.conformity is not None and (accept or workspace.reported):
        accept.append(Conclusion(workspace.conformity, f"the run: {workspace.conformity}"))
    elif workspace.reported:
        accept.append(Conclusion("done", "the report is written; the profile has no tolerances"))
    return {step: Mark(one.kind, one.words) for step, several in found.items() if (one := worst(several)) is not None}
