"""The result of ``rehearse`` as a table and sentences."""

from __future__ import annotations

from cellapp.cell.driving.records import RehearseResult
from cellapp.cell.driving.rehearsal_rungs import RUNGS
from cellapp.commands.record import Request, View
from cellapp.commands.rehearse.result import RehearsalLog
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import Cell, table_of_cells
from cellapp.ground.counting import counted

_SLOW = 1.5
"""A motion is listed as slow if it takes this factor longer, and a second more."""


def view(result: RehearseResult, request: Request | None = None) -> View:
    """Show times and deviations of each arm, refusals, slow motions, and the next rung."""
    offs = {arm: [one.off_mrad[arm] for one in result.motions if arm in one.off_mrad] for arm in result.arms}
    rows = ((arm, sum(off) / len(off), max(off)) for arm, off in offs.items() if off)
    took, expected = (sum(getattr(one, key) for one in result.motions) for key in ("seconds", "expected_s"))
    lines = [
        f"rung '{result.rung}': {RUNGS[result.rung].words}; arms {', '.join(result.arms)}",
        *(f"arm {arm}: {words}" for arm, words in result.controllers.items()),
        f"{counted(len(result.visited), 'stop')} reached, {len(result.refused)} refused,"
        f" {counted(len(result.motions), 'motion')} in {took:.1f} s; the motions alone should take {expected:.1f} s",
        *(f"stop {stop}: {why}" for stop, why in result.refused.items()),
        *(
            f"slow: to {'home' if one.stop is None else f'stop {one.stop}'} in {one.seconds:.1f} s instead of"
            f" {one.expected_s:.1f} s"
            for one in result.motions
            if one.seconds > _SLOW * one.expected_s + 1.0
        ),
        *result.notes,
        f"missing: {', '.join(result.missing)}" if result.missing else "all rungs are passed",
    ]
    offsets = ("mean off [mrad]", ".4f"), ("most off [mrad]", ".4f")
    table = table_of_cells("Commanded and reached joint positions", rows, "arm", *offsets)
    failed = () if result.passed else (result.ended or "no stop was reached",)
    return View((table, *lines), failed)


def log_section(log: RehearsalLog) -> Section:
    """Show the record of each rung from when the run was collected, for the report."""
    numbers = ("stops", "d"), ("refused", "d"), ("most off [mrad]", ".4f")
    rows = list[tuple[Cell, ...]]()
    for name in RUNGS:
        if (one := log.rungs.get(name)) is None:
            rows.append((name, "", "", None, None, None, "not driven"))
            continue
        off = max((off for motion in one.motions for off in motion.off_mrad.values()), default=None)
        outcome = "passed" if one.passed else one.ended or "no stop was reached"
        rows.append((name, one.when, ", ".join(one.arms), len(one.visited), len(one.refused), off, outcome))
    passed = sum(one.passed for one in log.rungs.values())
    return Section(
        [table_of_cells("Rungs of the rehearsal", rows, "rung", "when", "arms", *numbers, "outcome")],
        message=f"{passed} of {counted(len(RUNGS), 'rung')} passed before the readings were taken.",
        about="What rehearse recorded of these arms before the plan was collected: the controllers in simulation"
        " mode first, then real arms at 5 % speed.",
    )
