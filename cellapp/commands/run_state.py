"""The state of a run: what is measured, what holds, how it is judged, what comes next. Every medium asks it.

Only this module says what is left to do, and that the page or the certificate is out of date.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from cellapp.cell.run.file import RunFile
from cellapp.cell.run.recordings import all_known_readings, recordings_digest
from cellapp.cell.run.sqlite_file import REPORT_FILE, last_session
from cellapp.commands.judgements import judge_run
from cellapp.commands.next_step import ArmProgress, Next, open_steps, repetitions
from cellapp.commands.run_results import RunResults, read_results
from cellapp.commands.stages import (
    CERTIFICATE_FILE,
    Basis,
    NextVerb,
    RunStages,
    basis_of,
    counted_basis,
    next_command,
    read_history,
    read_stages,
)
from cellapp.estimation.uncertainty.budget import MeasuredConditions, measured_conditions
from cellapp.estimation.uncertainty.records import Conformity, Judgement, overall
from cellapp.ground.results import CALIBRATE, CERTIFICATE, COMPENSATE, ISO9283
from cellapp.ground.shell import shell_word

DATA_MARK = "cellapp-data"
"""Name of the page's ``meta`` element with the ``data_mark`` of the run when the page was written."""
_MARK = re.compile(rf'<meta name="{DATA_MARK}" content="([0-9a-f]{{64}})">')
_HEAD = 20_000
"""How many characters of the page are read to find its marks."""


@dataclass(frozen=True, eq=False)
class RunState:
    """The state of an open run; each part is computed when it is asked for, once.

    ``counted``: to see which stages hold, readings are only counted, which is quick; what comes next does not depend on
    page and certificate then.
    """

    run: RunFile
    counted: bool = False

    # -- what is stored ------------------------------------------------------------------------------------------------

    @cached_property
    def now(self) -> Basis:
        """The basis of a stage that is stored now."""
        return (counted_basis if self.counted else basis_of)(self.run)

    @cached_property
    def stages(self) -> RunStages:
        """The newest stages, and which of them no longer hold."""
        return read_stages(self.run, lambda run: self.now)

    @cached_property
    def results(self) -> RunResults:
        """The current results."""
        return read_results(self.run, self.stages)

    @cached_property
    def arms(self) -> dict[str, ArmProgress]:
        """How much of each arm's plan is measured; the readings are counted, not read."""
        planned, measured = self.run.planned_counts(), self.run.split_counts()
        states = {}
        for name, arm in self.run.profile.arms.items():
            splits, total = measured.get(name, {}), planned.get(name, 0)
            states[name] = ArmProgress(
                type=arm.type.model,
                planned=total - len(self.run.profile.plan.reserves(total)),
                measured=sum(splits.values()),
                splits={split or "none": n for split, n in splits.items()},
                recorded=recordings_digest(self.run, name)[0],
            )
        return states

    # -- how it is judged ----------------------------------------------------------------------------------------------

    @cached_property
    def measured(self) -> dict[str, MeasuredConditions]:
        """Conditions of the readings of a calibrated run."""
        if self.results.calibrate is None or self.run.removed_kinds():
            return {}
        return measured_conditions(all_known_readings(self.run))

    @cached_property
    def judgements(self) -> tuple[Judgement, ...]:
        """Every error against its tolerance; empty if the profile has none."""
        profile = self.run.profile
        return judge_run(profile, self.results, self.measured) if profile.tolerances.any_given else ()

    @property
    def conformity(self) -> Conformity | None:
        """The verdict on the tolerances; None if the profile has none or nothing is judged."""
        if not self.run.profile.tolerances.any_given:
            return None
        if CALIBRATE in self.results.out_of_date or self.run.removed_kinds():
            return "not decided"
        return overall(self.judgements)

    # -- what comes next -----------------------------------------------------------------------------------------------

    def missing_step(self, folder: Path | None = None) -> Next | None:
        """Return the first step of the day that is missing or out of date, for a run in ``folder``; None without
        one."""
        folder = folder or self.run.folder
        if self.run.removed_kinds():
            return Next("Measure the cell anew:", next_command("plan", folder), "plan")
        if not (verb := self._missing_verb()):
            return None
        begun = verb == "collect" and any(arm.measured for arm in self.arms.values())
        words = "Repeat what is out of date:" if self.stages.out_of_date else "Go on with:"
        if verb == "collect":
            words = "Measure the planned stops that are left, then calibrate and discover again:"
        return Next(words, next_command(verb, folder) + (" --resume" if begun else ""), verb)

    @cached_property
    def next_step(self) -> Next:
        """What comes next; it is empty only if nothing is missing, out of date, undecided or failed."""
        if missing := self.missing_step():
            return missing
        remaining = list(open_steps(self.run.profile, self.results, self.judgements))
        tests = (one for one in remaining if one.verb == ISO9283 and one.command)
        said = [] if self.counted else self.complaints
        again = (step for words, step in repetitions(self.run.folder) if any(one.startswith(words) for one in said))
        return next((one for found in (tests, again, remaining) for one in found), Next(""))

    def _missing_verb(self) -> NextVerb:
        run, arms, stages = self.run, self.arms.values(), self.stages
        if not any(arm.measured or arm.recorded for arm in arms):
            return "collect" if any(arm.planned for arm in arms) else ""  # a run of tests alone has no plan
        last = last_session(run.sessions())
        ended = None if last is None else last.outcome
        if ended == "complete" and run.untried_stops():  # they were added to the plan
            return "collect"
        done = ended in ("complete", "accurate enough")
        if not done and not stages.current and any(arm.measured < arm.planned for arm in arms):
            return "collect"
        verb = stages.next_verb()
        if verb == "push" and not any(arm.driver.has_device for arm in run.profile.arms.values()):
            verb = "" if COMPENSATE in stages.current and COMPENSATE not in stages.out_of_date else "compensate"
        return verb or ("" if (run.folder / REPORT_FILE).exists() else "report")

    # -- what is out of date -------------------------------------------------------------------------------------------

    @cached_property
    def data_mark(self) -> str:
        """SHA-256 of all that a page of the run is made of: profile, readings, the newest stage of each name."""
        parts = [self.now.model_dump_json(), *(f"{name} {one.digest}" for name, one in self.stages.current.items())]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    @cached_property
    def complaints(self) -> list[str]:
        """What is out of date, one sentence each: readings, stages, the page, the certificate; empty if nothing is."""
        outdated = [f"'{name}' is out of date ({reason})" for name, reason in self.stages.out_of_date.items()]
        removed = [f"arm '{arm}': {reason}" for arm, reason in self.run.removed_kinds().items()]
        return [*removed, *outdated, *self._of_page(), *self._of_certificate()]

    def _of_page(self) -> Iterator[str]:
        text = _text(self.run.folder / REPORT_FILE, _HEAD)
        found = None if text is None else _MARK.search(text)
        if text is not None and (found is None or found.group(1) != self.data_mark):
            why = "an older version wrote it" if found is None else "the run has changed since"
            yield f"{REPORT_FILE} is out of date ({why}); run 'cellapp report {shell_word(self.run.folder)}'"

    def _of_certificate(self) -> Iterator[str]:
        """Say whether the certificate is not stored in the run, or certifies other data than the newest one."""
        text, newest = _text(self.run.folder / CERTIFICATE_FILE), self.stages.current.get(CERTIFICATE)
        if text is None:
            return
        if newest is None:
            yield f"{CERTIFICATE_FILE} is not of this run: it stores no certificate"
            return
        same = [one for one in read_history(self.run) if one.name == CERTIFICATE and _same_json(text, one.text)]
        if not same:
            yield f"{CERTIFICATE_FILE} is not a certificate that the run stores"
        elif same[-1].basis != newest.basis:
            yield f"{CERTIFICATE_FILE} is an earlier certificate, of other data"


def complaints_in(folder: Path) -> list[str]:
    """Return the complaints of the run in a folder as it is now: ``--strict`` fails if there are any."""
    with RunFile.open(folder) as run:
        return RunState(run).complaints


def _same_json(one: str, other: str) -> bool:
    try:
        return bool(json.loads(one) == json.loads(other))
    except ValueError:
        return False


def _text(path: Path, most: int = -1) -> str | None:
    """Read the first ``most`` characters of a file, all if negative; None if there is no file."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(most)
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError):
        return ""  # there is a file, but not the one that was written
