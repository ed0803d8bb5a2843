"""The verdict on a run as a table and sentences: judgements, what is out of date, what comes next."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date

from cellapp.cell.run import RunFile
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.report.data import ReportData, read_report_data
from cellapp.commands.report.result import read_results
from cellapp.commands.report.summary import Summary, summary
from cellapp.commands.view.acceptance_words import RULE_WORDS, judgement_table
from cellapp.commands.view.table import Table
from cellapp.estimation.uncertainty.records import Conformity, Judgement, overall
from cellapp.ground.errors import InputError


@dataclass(frozen=True)
class RunVerdict:
    """The judgements on a run with a title and a sentence, and next steps; ``state`` is None if nothing is judged."""

    state: Conformity | None
    title: str
    sentence: str
    judgements: tuple[Judgement, ...]
    steps: tuple[str, ...]


def read_verdict(run: RunFile, today: date) -> RunVerdict:
    """Judge a run as it is now; instruments are due as of ``today``."""
    results = read_results(run)
    data = _report_data(run)
    if data is None:
        judgements = judge_run(run.profile, results)
        title = "Not calibrated yet"
        sentence = "Collect and calibrate first; tests by ISO 9283 with nominal commands need no calibration."
        return RunVerdict(overall(judgements), title, sentence, judgements, ())
    judgements = data.judgements
    first: Summary = summary(data, judgements, today)
    steps = tuple(f"{step.text} {step.command}".strip() for step in first.steps)
    verdict = first.verdict
    return RunVerdict(verdict.state, verdict.title, verdict.sentence, judgements, steps)


def verdict_tables(verdict: RunVerdict) -> list[Table]:
    """Show every judgement: error, expanded uncertainty, tolerance, decision, and source of the error."""
    return [judgement_table(verdict.judgements)] if verdict.judgements else []


def verdict_sentences(verdict: RunVerdict) -> list[str]:
    """State the decision rules, and what comes next."""
    rules = dict.fromkeys(RULE_WORDS[one.rule] for one in verdict.judgements)
    return [*rules, *(f"next: {step}" for step in verdict.steps)]


def _report_data(run: RunFile) -> ReportData | None:
    try:
        return read_report_data(run)
    except InputError:
        return None  # not calibrated yet
