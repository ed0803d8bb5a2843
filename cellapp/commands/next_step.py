"""Progress of a run: what is measured of each arm, and the verb that comes next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import recordings_digest
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.certificate.iso9283_judgements import unmeasured_tests
from cellapp.commands.stages import CERTIFICATE_FILE, NextVerb, RunStages, next_command
from cellapp.estimation.iso9283.norm import IsoTest
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.ground.errors import InputError
from cellapp.ground.results import CERTIFICATE, CHECK, COMPENSATE, ISO9283, Record
from cellapp.ground.shell import shell_word

_AGAIN: Mapping[str, NextVerb] = {
    f"'{CHECK}'": "check",
    REPORT_FILE: "report",
    f"'{CERTIFICATE}'": "certificate",
    CERTIFICATE_FILE: "certificate",
}
"""Beginning of a complaint -> the verb that mends it, in the order of the steps."""


class ArmState(Record):
    """How much of one arm's plan is measured, and in which splits; points that were ``recorded`` in motion."""

    type: str
    planned: int
    measured: int
    splits: Mapping[str, int]
    recorded: int = 0


def arm_states(run: RunFile) -> dict[str, ArmState]:
    """Return how much of each arm's plan is measured; counts the readings without reading them."""
    planned, measured = run.planned_counts(), run.split_counts()
    states = {}
    for name, arm in run.profile.arms.items():
        splits, total = measured.get(name, {}), planned.get(name, 0)
        states[name] = ArmState(
            type=arm.type.model,
            planned=total - len(run.profile.plan.reserves(total)),
            measured=sum(splits.values()),
            splits={split or "none": n for split, n in splits.items()},
            recorded=recordings_digest(run, name)[0],
        )
    return states


def next_step(
    run: RunFile, stages: RunStages, arms: Mapping[str, ArmState], complaints: Sequence[str] = ()
) -> tuple[NextVerb, str]:
    """Return the verb that comes next and its command; both empty if nothing is left to do and nothing complained of.

    ``complaints``: what is out of date, as ``complaints_of`` says; then the last steps renew check, page, certificate.
    """
    if run.removed_kinds():
        return "", ""
    verb = _next_verb(run, stages, arms)
    if not verb and (tests := _missing_tests(run, stages)):
        return "iso9283", f"cellapp iso9283 {tests[0]} --run {shell_word(run.folder)}"
    if not verb:
        verb = next((again for words, again in _AGAIN.items() if any(one.startswith(words) for one in complaints)), "")
    begun = verb == "collect" and any(arm.measured for arm in arms.values())
    return verb, next_command(verb, run.folder) + (" --resume" if begun else "")


def _next_verb(run: RunFile, stages: RunStages, arms: Mapping[str, ArmState]) -> NextVerb:
    if not any(arm.measured or arm.recorded for arm in arms.values()):
        return "collect" if any(arm.planned for arm in arms.values()) else ""  # a run of tests alone has no plan
    sessions = [one for one in run.sessions() if not one.again]
    ended = sessions[-1].outcome if sessions else None
    if ended == "complete" and _has_new_stops(run):
        return "collect"
    done = ended in ("complete", "accurate enough")
    if not done and not stages.current and any(arm.measured < arm.planned for arm in arms.values()):
        return "collect"
    verb = stages.next_verb()
    if verb == "push" and not any(arm.driver.has_device for arm in run.profile.arms.values()):
        verb = "" if COMPENSATE in stages.current and COMPENSATE not in stages.out_of_date else "compensate"
    return verb or ("" if (run.folder / REPORT_FILE).exists() else "report")


def _missing_tests(run: RunFile, stages: RunStages) -> tuple[IsoTest, ...]:
    """Return the tests of ISO 9283 that the tolerances need and the run lacks, for arms that can be driven."""
    names = [name for name, arm in run.profile.arms.items() if arm.driver.has_device]
    stored = None if ISO9283 in stages.out_of_date else stages.current.get(ISO9283)
    if not run.profile.tolerances.any_given or not names:
        return ()
    try:
        tested = {} if stored is None else Iso9283Result.from_json(stored.text, ISO9283).arms
    except InputError:  # of another version: the page and the terminal say so
        tested = {}
    return unmeasured_tests(run.profile.tolerances, names, tested)


def _has_new_stops(run: RunFile) -> bool:
    """Return whether stops were added to the plan that no session has tried yet; reserves do not count."""
    total = max(run.planned_counts().values(), default=0)
    tried = run.stops_done() | {one.stop for one in run.outcomes()}
    return any(stop not in tried for stop in range(total) if stop not in run.profile.plan.reserves(total))
