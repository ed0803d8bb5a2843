"""What each step of a run concluded, in a word. Only this module tells done from decided, undecided and stopped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from cellapp.cell.run import RunFile
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.run_results import RunResults
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.iso9283.records import Iso9283Result
from cellapp.estimation.monitoring.check.records import CheckResult
from cellapp.estimation.uncertainty.budget import measured_conditions
from cellapp.estimation.uncertainty.records import Conformity, overall
from cellapp.ground.results import (
    CALIBRATE,
    CHECK,
    COMPENSATE,
    DISCOVER,
    ISO9283,
    LOCATE,
    PATH,
    PUSH,
    VERIFY,
    StageName,
)

Kind = Literal["done", "conforms", "cannot say", "part", "does not conform", "out of date"]
WORST_FIRST: tuple[Kind, ...] = ("out of date", "does not conform", "part", "cannot say", "conforms", "done")


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


def conformity(run: RunFile, results: RunResults) -> Conformity | None:
    """Return the verdict on the tolerances of a run's profile; None if the profile has none or nothing is judged."""
    if not run.profile.tolerances.any_given:
        return None
    if CALIBRATE in results.out_of_date or run.removed_kinds():
        return "cannot say"
    readings = {name: run.readings(name) for name in run.profile.arms}
    measured = measured_conditions({name: arm for name, arm in readings.items() if len(arm)})
    return overall(judge_run(run.profile, results, None if results.calibrate is None else measured))


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
        return Conclusion("cannot say", "; ".join(open_))
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
    if "cannot say" in verdicts:
        return Conclusion("cannot say", "the uncertainty does not decide every target")
    return Conclusion("conforms", "verified within tolerance") if "in" in verdicts else Conclusion("done", "verified")


def _tests(result: Iso9283Result) -> Conclusion:
    if result.stopped:
        return Conclusion("part", result.stopped.partition(":")[0])
    judged = overall(result.judgements)
    return Conclusion("done", "tests were made") if judged is None else Conclusion(judged, f"the tests: {judged}")


def _check(result: CheckResult) -> Conclusion:
    if result.verdict == "valid":
        return Conclusion("done", "the calibration holds")
    if result.verdict == "cannot say":
        return Conclusion("cannot say", "whether the calibration holds is not known")
    return Conclusion("does not conform", f"the check found: {result.verdict}")
