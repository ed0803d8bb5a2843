"""Steps that settle what the results of a run leave open, and what each step concluded, in a word.

Only this module tells done from decided, undecided and stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.judgements import other_arms_found, unmeasured_tests
from cellapp.commands.run_results import RunResults
from cellapp.commands.stages import CERTIFICATE_FILE, NextVerb, at_targets
from cellapp.commands.view.words import named_errors
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.iso9283.norm import IsoTest
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.records import CheckResult
from cellapp.estimation.uncertainty.records import Characteristic, Judgement, overall
from cellapp.ground.profile import Profile
from cellapp.ground.results import (
    CALIBRATE,
    CERTIFICATE,
    CHECK,
    COMPENSATE,
    DISCOVER,
    ISO9283,
    LOCATE,
    PATH,
    PUSH,
    VERIFY,
    Record,
    StageName,
)
from cellapp.ground.shell import shell_word

PAIR_ERRORS: tuple[Characteristic, ...] = ("cooperative", "cooperative_orientation")
AT_TARGETS: tuple[Characteristic, ...] = ("position", "distance", "orientation", *PAIR_ERRORS)
"""Characteristics that a verification at targets measures; the others are of ISO 9283."""
_PROPOSED_STOPS = 30
"""Stops to propose if discovery could not decide: about a quarter of an hour of measuring."""


class ArmProgress(Record):
    """How much of one arm's plan is measured, and in which splits; points that were ``recorded`` in motion."""

    type: str
    planned: int
    measured: int
    splits: Mapping[str, int]
    recorded: int = 0


@dataclass(frozen=True)
class Next:
    """One thing to do next: words, the command if cellapp does it, and the verb to whose screen it belongs."""

    text: str
    command: str = ""
    verb: NextVerb = ""

    @property
    def short(self) -> str:
        """The command, else the words."""
        return self.command or self.text


def open_steps(profile: Profile, results: RunResults, judgements: Sequence[Judgement]) -> Iterator[Next]:
    """Yield what settles each result that is not decided, not measured, or outside a tolerance."""
    folder = shell_word(results.run)
    driven = [name for name, arm in profile.arms.items() if arm.driver.has_device]
    if driven:
        for test in _missing_tests(profile, results, driven)[:1]:
            yield Next("Measure by ISO 9283 what has a tolerance:", f"cellapp iso9283 {test} --run {folder}", "iso9283")
    yield from _of_stages(results, folder)
    out = [one for one in judgements if one.conformity == "does not conform"]
    if driven and results.verify is not None and any(one.characteristic in AT_TARGETS for one in out):
        words = "Correct by measuring what the model leaves at targets:"
        yield Next(words, at_targets("push", Path(results.run), " --verify --iterate 2"), "push")
    elif out:
        yield Next(f"Decide what follows: outside its tolerance is {named_errors(out)}.")
    missing = [one for one in judgements if one.value is None and one.characteristic in AT_TARGETS]
    if missing and not driven:
        yield Next(f"Not decided: {named_errors(missing)} is judged at targets, and these arms cannot be driven there.")
    elif missing:
        yield _targets_step(results, missing)
    near = [one for one in judgements if one.conformity == "not decided" and one.value is not None]
    if near and not other_arms_found(results):
        yield Next(f"Measure with a smaller uncertainty: {named_errors(near)}.")


def _of_stages(results: RunResults, folder: str) -> Iterator[Next]:
    """Yield what settles stages that stopped, failed or decided nothing; those out of date are repeated instead."""
    for name, one in stage_conclusions(results).items():
        kind, words = one.kind, f"{one.words[:1].upper()}{one.words[1:]}"
        if kind in ("done", "conforms", "out of date"):
            continue
        if name == DISCOVER:
            text = f"{words}: measure stops that decide what discovery left open:"
            yield Next(text, f"cellapp discover {folder} --propose {_PROPOSED_STOPS}", "discover")
        elif name == PATH:
            yield Next(f"{words}: mend the path, then compute it again:", "cellapp docs targets")
        elif name == CHECK and kind == "not decided":
            yield Next(f"{words}:", f"cellapp check {folder}", "check")
        elif name in (PUSH, VERIFY) and kind == "not decided":
            yield Next(f"{words}: measure with a smaller uncertainty.")
        elif name in (PUSH, VERIFY):
            again = {"part": "", "does not conform": " --iterate 2"}[kind]
            command = at_targets("push", Path(results.run), f" --verify{again}" if name == VERIFY else "")
            yield Next(f"{words}:", command, "push")
        elif name == ISO9283 and kind == "part":
            yield Next(f"{words}:", f"cellapp iso9283 --run {folder}", "iso9283")


def _targets_step(results: RunResults, missing: Sequence[Judgement]) -> Next:
    """Return how targets that have a tolerance come to be measured: what a list lacks, no repetition measures."""
    verify = results.verify
    listed = set() if verify is None else {one.arm for one in verify.targets}
    pairs = verify is not None and bool(verify.pairs)
    lacking = [one for one in missing if not (pairs if one.characteristic in PAIR_ERRORS else one.where in listed)]
    measure = at_targets("push", Path(results.run), " --verify")
    if not lacking:
        return Next(f"Measure {named_errors(missing)}, which has a tolerance:", measure, "push")
    of_pairs, of_arm = "cooperative targets (partner)", "targets of {}"
    what = dict.fromkeys(of_pairs if one.characteristic in PAIR_ERRORS else of_arm.format(one.where) for one in lacking)
    text = (
        f"Add {' and '.join(what)} to the list, which have a tolerance and are not in it; then measure them: {measure}"
    )
    return Next(text, verb="push")


def repetitions(run: Path) -> Iterator[tuple[str, Next]]:
    """Yield the beginning of each complaint about a run in a folder and the step that mends it, in the order of the
    steps."""
    folder, words = shell_word(run), "Repeat what is out of date:"
    verbs: dict[str, tuple[NextVerb, str]] = {
        f"'{COMPENSATE}'": ("compensate", at_targets("compensate", run)),
        f"'{PUSH}'": ("push", at_targets("push", run)),
        f"'{PATH}'": ("", "cellapp docs targets"),
        f"'{ISO9283}'": ("iso9283", f"cellapp iso9283 --run {folder}"),
        f"'{CHECK}'": ("check", f"cellapp check {folder}"),
        REPORT_FILE: ("report", f"cellapp report {folder}"),
        f"'{CERTIFICATE}'": ("certificate", f"cellapp certificate {folder}"),
        CERTIFICATE_FILE: ("certificate", f"cellapp certificate {folder}"),
    }
    for begins, (verb, command) in verbs.items():
        yield begins, Next(words, command, verb)


def _missing_tests(profile: Profile, results: RunResults, driven: Sequence[str]) -> tuple[IsoTest, ...]:
    """Return the tests of ISO 9283 that the tolerances need and the run lacks, for arms that can be driven."""
    stored = None if ISO9283 in results.out_of_date else results.iso9283
    return unmeasured_tests(profile.tolerances, driven, {} if stored is None else stored.arms)


Kind = Literal["done", "conforms", "not decided", "part", "does not conform", "out of date"]
WORST_FIRST: tuple[Kind, ...] = ("out of date", "does not conform", "part", "not decided", "conforms", "done")


@dataclass(frozen=True)
class Conclusion:
    """What a step concluded, and the same in words for people: "stopped after 3 of 40 targets"."""

    kind: Kind
    words: str


def worst(found: Iterator[Conclusion] | list[Conclusion]) -> Conclusion | None:
    """Return the worst conclusion; None if there are none."""
    return min(found, key=lambda one: WORST_FIRST.index(one.kind), default=None)


def stage_conclusions(results: RunResults) -> dict[StageName, Conclusion]:
    """Return the conclusion of each stored stage; for a stage that no longer holds it is always "out of date"."""
    found: dict[StageName, Conclusion] = dict(_concluded(results))
    for name, reason in results.out_of_date.items():
        found[name] = Conclusion("out of date", f"{name} is out of date: {reason}")
    return found


def _concluded(results: RunResults) -> Iterator[tuple[StageName, Conclusion]]:
    if results.calibrate is not None:
        yield CALIBRATE, Conclusion("done", "calibrated")
    if results.discover is not None:
        yield DISCOVER, _discovery(results.discover)
    if results.locate is not None:
        located = results.locate.complaints()
        yield LOCATE, Conclusion("does not conform", "; ".join(located)) if located else Conclusion("done", "located")
    if results.compensate is not None:
        yield COMPENSATE, Conclusion("done", "commands computed")
    measured: Mapping[StageName, VerifyResult | None] = {PUSH: results.push, VERIFY: results.verify}
    for name, one in measured.items():
        if one is not None:
            yield name, _verification(one, measures=name == VERIFY)
    if results.path is not None:
        refused = results.path.complaints()
        yield PATH, Conclusion("does not conform", "; ".join(refused)) if refused else Conclusion("done", "computed")
    if results.iso9283 is not None:
        yield ISO9283, _tests(results.iso9283)
    if results.check is not None:
        yield CHECK, _check(results.check)


def _discovery(found: DiscoverResult) -> Conclusion:
    open_ = [f"arm {name}: {arm.verdict}" for name, arm in found.arms.items() if arm.verdict in _UNDECIDED]
    if open_:
        return Conclusion("not decided", "; ".join(open_))
    return Conclusion("done", "; ".join(f"arm {name}: {arm.verdict}" for name, arm in found.arms.items()))


_UNDECIDED = ("unknown effect", "ambiguous")


def _verification(result: VerifyResult, *, measures: bool) -> Conclusion:
    if result.stopped:
        return Conclusion("part", result.stopped.partition(":")[0])
    if not measures:
        return Conclusion("done", "driven, not measured")
    if failed := result.complaints():
        return Conclusion("does not conform", "; ".join(failed))
    verdicts = {one.verdict for one in result.targets} | {one.verdict for one in result.pairs}
    if "not decided" in verdicts:
        return Conclusion("not decided", "the uncertainty does not decide every target")
    return Conclusion("conforms", "verified within tolerance") if "in" in verdicts else Conclusion("done", "verified")


def _tests(result: Iso9283Result) -> Conclusion:
    if result.stopped:
        return Conclusion("part", result.stopped.partition(":")[0])
    judged = overall(result.judgements)
    return Conclusion("done", "tests were made") if judged is None else Conclusion(judged, f"the tests: {judged}")


def _check(result: CheckResult) -> Conclusion:
    if result.verdict == "valid":
        return Conclusion("done", "the calibration holds")
    if result.verdict == "not decided":
        return Conclusion("not decided", "whether the calibration holds is not known")
    return Conclusion("does not conform", f"the check found: {result.verdict}")
