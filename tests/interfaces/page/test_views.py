"""Views of hand-made results that have everything a result can have, and of runs, approved as whole texts."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving.records import CollectResult
from cellapp.cell.planning.planned_stops import (
    PLAN_DESIGN_RESULT,
    read_plan_design,
    read_planned_stops,
    write_planned_stops,
)
from cellapp.cell.run import Outcome, ReferenceRow, RunFile
from cellapp.cell.targets.records import (
    ArmVerification,
    CompensateResult,
    MeasuredPair,
    MeasuredTarget,
    TargetCommand,
    UnknownCondition,
    VerifyResult,
)
from cellapp.cell.targets.targets import Partner, Target, target_record
from cellapp.commands.check.request import VERB as CHECK_VERB
from cellapp.commands.collect.charts import residual_chart
from cellapp.commands.collect.result import CollectedStop, ResidualRange
from cellapp.commands.collect.state import collection_state
from cellapp.commands.collect.view import collect_lines, other_notes, residual_range_words, stored_view
from cellapp.commands.compensate.target_list import target_list, target_state, target_words
from cellapp.commands.compensate.view import targets_section
from cellapp.commands.compensate.words import PART_WORDS, compensate_lines, verify_lines
from cellapp.commands.discover.request import VERB as DISCOVER_VERB
from cellapp.commands.discover.view import discovery_section
from cellapp.commands.plan.check_view import design_sentences, design_tables
from cellapp.commands.plan.run import new_planned_run, planned_stops
from cellapp.commands.plan.view import plan_section
from cellapp.commands.report.data import out_of_date_lines, read_report_data
from cellapp.commands.report.sections import report_sections
from cellapp.commands.run_results import RunResults, read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.commands.stages import append_stage, basis_on_model, read_stages
from cellapp.commands.stored_model import stage_in_force
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.words import law_words, probability_words
from cellapp.estimation.discovery.records import DiscoverResult, LawRecord, Noise
from cellapp.estimation.monitoring.records import (
    CheckedArm,
    CheckedPoint,
    CheckedStop,
    CheckResult,
    FoundChange,
    WeakChange,
)
from cellapp.estimation.uncertainty.records import UncertaintyParts
from cellapp.ground.errors import InputError
from cellapp.ground.profile import DiscoverySettings
from cellapp.ground.results import CHECK, Estimate
from cellapp.interfaces.page.page import template
from cellapp.robot.effects import EFFECTS
from tests.approved import assert_approved, text_of, without_digits
from tests.interfaces.page.cases import ERRORS, discovery, unknown_effect
from tests.interfaces.page.plan_cases import plan_design
from tests.robot.effects.cell import context_of
from tests.sure import sure
from tests.twin import small_twin
from tests.verbs import collect_stops, plan_new_run

APPROVED = Path(__file__).parent / "approved"


# -- discovery --------------------------------------------------------------------------------------------------------


def discoveries() -> Parts:
    """What a terminal shows; the section of the page; noise that was estimated; a law that hardly fits."""
    result, arm = discovery("left", "right"), unknown_effect("left")
    estimated = arm.model_copy(update={"noise_floor_mm": None, "noise_mm": Noise(rms=0.031, source="estimated")})
    ahead = {f"half_play{j}": Estimate(value=-3e-5, standard_error=1e-5, unit="rad") for j in (2, 3)}
    changed = {"law_misfit": 0.02, "parameters": {**arm.accepted[1].parameters, **ahead}}
    exact = arm.model_copy(update={"accepted": (arm.accepted[1].model_copy(update=changed),)})
    others = {"estimated": estimated, "exact": exact}
    return [
        *DISCOVER_VERB.view(result).parts,
        "--- page",
        discovery_section(result, DiscoverySettings()),
        "--- others",
        *DISCOVER_VERB.view(DiscoverResult(arms=others)).parts,
        "--- probabilities",
        *(probability_words(p) or "nothing" for p in (None, 0.0, 0.004, 0.5, 0.985, 0.9999, 1.0)),
    ]


CONTEXT = context_of()
LAWS = [(slug, law) for slug, effect in EFFECTS.items() for law in effect.laws(CONTEXT)]
LAWS += [
    ("transmission_error", EFFECTS["transmission_error"].law("gear", {"ratio": 100.0})),
    ("transmission_error", EFFECTS["transmission_error"].law("curve", {"cycles": 100.0})),
]


@pytest.mark.parametrize(("slug", "name"), sorted({(slug, law.name) for slug, law in LAWS}))
def test_every_law_has_words(slug: str, name: str) -> None:
    law = next(law for s, law in LAWS if (s, law.name) == (slug, name))
    words = law_words(slug, LawRecord(name=law.name, constants=dict(law.constants)))
    assert words
    assert "_" not in words
    # more than the law's own name: that says nothing to whoever does not know the program
    assert words.split(",")[0] != name.replace("_", " ")


# -- check ------------------------------------------------------------------------------------------------------------


def checked(**changes: Any) -> CheckResult:
    """A check of two arms, of which the first has changed and the second was not measured at the last stop."""

    def stop(number: int, **errors_mm: float) -> CheckedStop:
        points = {
            name: CheckedPoint(q=(0.1,) * 6, measured_M=(3.0, 0.1, 0.4), error_mm=error)
            for name, error in errors_mm.items()
        }
        return CheckedStop(points=points, log_evidence=2.0 * number, log_valid=-number, p_value=0.1, time_s=number)

    zero = FoundChange(
        arm="left", what="zero of joint 3", value=2.985e-4, standard_error=5.2e-6, unit="rad", p_value=0.0,
        moved_mm=0.187, rivals=("base of arm left",),
    )  # fmt: skip
    fields: dict[str, Any] = {
        **{"verdict": "arm changed", "model": "discover", "planned": 20, "sure_after": 3, "p_value": 2e-9},
        **{"changes": (zero,), "seconds": 27.4},
        "arms": {
            "left": CheckedArm(stops=3, expected_mm=0.026, rms_mm=0.221, left_mm=0.187),
            "right": CheckedArm(stops=2, expected_mm=0.027, rms_mm=0.025),
        },
        "weak": (WeakChange(arm="right", what="a5", moved_mm=0.03, detected=0.07e-3, unit="m"),),
        "stops": (stop(1, left=0.25, right=0.02), stop(2, left=0.23, right=0.03), stop(3, left=0.21)),
        **{"next_step": "calibrate again", "notes": ("a note",)},
    }
    return CheckResult(**{**fields, **changes})


def checks() -> Parts:
    """Each verdict with what it complains of."""
    moved = FoundChange(
        arm="tracker", what="tracker", value=None, standard_error=None, unit="", p_value=1e-5, moved_mm=3.0
    )
    stale = "'discover' is out of date (reasons)"
    results = [
        checked(),
        checked(verdict="tracker moved", changes=(moved,), station_shift_mm=36.07, station_turn_deg=0.5839),
        *(checked(verdict=one, changes=(), stale=stale) for one in ("valid", "not decided", "not explained")),
        checked(verdict="valid", changes=(), weak=(), stops=()),
    ]
    return [
        part
        for one in results
        for part in (
            *(f"--- {one.verdict}", *CHECK_VERB.view(one).parts),
            *("complaints:", *one.complaints(), "strict:", *one.complaints(strict=True)),
        )
    ]


def test_the_page_and_the_overview_show_a_check(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        basis = basis_on_model(run, stage_in_force(run, read_stages(run)))
        append_stage(run, CHECK, checked(notes=("<b>left</b>",)), basis)
        assert "do not use it as it is: the last 'check' found: arm changed" in overview_sentences(
            run_overview(RunState(run))
        )
        data = read_report_data(RunState(run))
        (section,) = (one for one in report_sections(run, data) if one.key == "check")
    assert dict(out_of_date_lines(data))[CHECK].endswith("(arm left: zero of joint 3)")
    drawn = template("sections/layout.html").module.folding(section)  # type: ignore[attr-defined]
    assert all(cell in drawn for cell in ("zero of joint 3", "0.2985", "0.0052", "mrad"))
    assert "&lt;b&gt;left" in drawn
    assert "<b>left" not in drawn


# -- targets ----------------------------------------------------------------------------------------------------------

PARTS = UncertaintyParts(
    parameters=0.010, effects=0.006, network=0.004, extrapolation=0.0, noise=0.012, conditions=0.002
)
ONE = Target(name="one", arm="left", position=(0.1, 0.2, 0.3), rpy=(0.0, 0.0, math.pi / 2), tolerance=1e-4)
BOTH = Target(
    name="both", arm="left", position=(0.5, 0.0, 0.2), frame="tracker", tolerance=5e-5,
    partner=Partner(arm="right", position=(0.3, 0.0, 0.0)),
)  # fmt: skip
FAR = Target(name="far", arm="right", position=(4.0, 0.0, 0.0))


def command(target: Target, arm: str = "", **values: object) -> TargetCommand:
    known = {"refusal": "", "q_nominal": (0.0,) * 6, "q_compensated": (0.1,) * 6, "uncertainty_mm": 0.013}
    return TargetCommand.model_validate({**dict(target_record(target, arm or target.arm)), **known, **values})


def measured(target: Target, before: float | None, *after: float, **values: object) -> MeasuredTarget:
    known = {"nominal_mm": before, "compensated_mm": after[0] if after else None, "rounds_mm": after, "note": ""}
    known |= {"corrected_mm": after[-1]} if len(after) > 1 else {}
    return MeasuredTarget.model_validate({**dict(target_record(target, target.arm)), **known, **values})


COMPENSATED = CompensateResult(
    targets=(
        command(
            ONE, branches=4, visible=True, residual_um=0.0004, residual_urad=0.0012, parts=PARTS, within_mm=0.061,
            verdict="in", approach=(1, 0, -1, 0, 0, 0),
            unknown=(UnknownCondition(condition="temperature", effects=("thermal_growth",), mm=0.04),),
        ),
        command(BOTH, parts=PARTS, within_mm=0.07, verdict="out"),
        command(BOTH, "right", parts=PARTS, within_mm=0.02, verdict="in", visible=False),
        command(FAR, q_nominal=None, q_compensated=None, uncertainty_mm=None, refusal="out of reach"),
    )
)  # fmt: skip
VERIFIED = VerifyResult(
    arms={"left": ArmVerification(nominal_mm=ERRORS, compensated_mm=ERRORS, corrected_mm=ERRORS)},
    targets=(
        measured(
            ONE, 4.2, 0.05, 0.02, within_mm=0.061, verdict="in", wanted_M=(1.0, 2.0, 3.0), predicted_M=(1.0, 2.0, 3.0),
            measured_M=(1.00003, 2.0, 3.00004),
        ),
        measured(BOTH, 3.0, 0.08, within_mm=0.07, verdict=""),
        measured(FAR, None, note="out of reach"),
    ),
    pairs=(
        MeasuredPair(
            name="both", arms=("left", "right"), wanted_mm=300.0, nominal_mm=2.0, compensated_mm=0.06,
            tolerance_mm=0.05, verdict="out",
        ),
    ),
    cooperative=ArmVerification(nominal_mm=ERRORS, compensated_mm=ERRORS),
)  # fmt: skip


def targets() -> Parts:
    """The section before and after measuring, the list, words of targets that were edited since."""
    results, predicted = (RunResults(run="run", compensate=COMPENSATED, verify=one) for one in (VERIFIED, None))
    edited, moved = ONE.model_copy(update={"tolerance": 1e-5}), ONE.model_copy(update={"position": (0.1, 0.2, 0.31)})
    return [
        "--- compensated",
        *compensate_lines(COMPENSATED),
        targets_section(COMPENSATED, None, {}),
        "--- measured",
        *verify_lines(VERIFIED),
        targets_section(COMPENSATED, VERIFIED, {"left": 0.02}),
        *("--- list", target_list((ONE, BOTH, FAR), results), target_list((ONE, BOTH), predicted)),
        *(target_words(one, results) for one in (ONE, edited, moved, BOTH, FAR)),
        *(str(target_state(one, results).needs_attention) for one in (ONE, BOTH, FAR)),
    ]


def test_the_parts_add_up_to_the_uncertainty(whole: RunFile) -> None:
    results = read_results(whole)
    for target in sure(results.compensate).targets:
        if target.parts is not None and target.uncertainty_mm is not None:
            parts = [getattr(target.parts, part) for part in PART_WORDS]
            assert math.isclose(math.hypot(*parts), target.uncertainty_mm, rel_tol=1e-9)


# -- plans, collecting -----------------------------------------------------------------------------------------------


def missing(count: int) -> tuple[Outcome, ...]:
    return tuple(Outcome(stop=2 * k, arm="left", kind="not measured", reason="no SMR") for k in range(count))


def collections() -> Parts:
    """Few and many missing readings, rows of stops, notes; the chosen stop in its chart."""
    ended = tuple(
        Outcome(stop=stop, arm=arm, kind="not tried", reason="the session ended before")
        for stop in range(10, 30)
        for arm in ("left", "right")
    )
    notes = ("stop 3, arm left: not measured: no SMR", "smallest distance between the arms 80 mm")
    many = CollectResult(
        stops=380, notes=(), missing=missing(14), missing_share=0.0175, tolerated_share=0.05,
        standard_error_mm={"left": 0.0123},
    )  # fmt: skip
    early = CollectResult(stops=10, notes=notes, missing=(*missing(1), *ended), missing_share=0.5)
    stops = [CollectedStop(stop=k, arm=arm, residual_mm=0.1 * k + 0.1) for k in range(3) for arm in ("left", "right")]
    stops.append(CollectedStop(stop=3, arm="left", suspicion="not measured: no SMR"))
    return [
        *("--- many", *collect_lines(many), "--- early", *collect_lines(early)),
        *("--- other notes", *other_notes(early, notes), *other_notes(None, notes)),
        *(residual_chart(stops), residual_chart(stops, ("left", "right"), chosen=stops[3])),
    ]


VIEWS: dict[str, Callable[[], Parts]] = {
    "discovery": discoveries,
    "check": checks,
    "targets": targets,
    "plan design": lambda: [*design_sentences(plan_design()), *design_tables(plan_design())],
    "collection": collections,
}


@pytest.mark.parametrize("name", VIEWS)
def test_a_view_says_what_was_approved(name: str) -> None:
    assert_approved(APPROVED / f"{name.replace(' ', '-')}.txt", text_of(VIEWS[name]()))


# -- runs -------------------------------------------------------------------------------------------------------------


def test_a_collection_with_gaps_pauses_and_drift_is_shown(tmp_path: Path) -> None:
    plan_new_run(small_twin(20, plan={"method": "random"}), tmp_path / "run")
    with RunFile.open(tmp_path / "run", write=True) as run:
        run.add_stop(
            3, {}, [Outcome(3, "left", "not measured", "no SMR"), Outcome(3, "right", "left out", "forbidden")]
        )
        collect_stops(run, resume=True)
        session = run.begin_session()
        run.record_request(session, "pause", "paused by a person")
        for number, x_mm in enumerate((0.0, 0.02, 0.05)):
            run.add_reference(
                ReferenceRow("nest A", 10 * number, 60.0 * number, np.array([x_mm * 1e-3, 0, 0]), session)
            )
        state = collection_state(run)
        stops = run.readings("left").configuration.tolist()
    assert state is not None
    assert_approved(
        APPROVED / "collected-run.txt",
        text_of([*stored_view(state).parts, residual_range_words(state)]),
        without_digits,
    )
    rows = {(one.stop, one.arm): one for one in state.stops}
    assert len(rows) == len(state.stops)
    assert [key for key, one in rows.items() if one.retried] == [(3, "left")]
    assert {(stop, "left") for stop in stops} < set(rows)
    residuals = [one.residual_mm for one in state.stops if one.arm == "left" and one.residual_mm is not None]
    assert state.residual_ranges["left"].before_mm == pytest.approx(np.percentile(residuals, 95))
    ranges = {"left": ResidualRange(before_mm=0.3, after_mm=0.06), "right": ResidualRange()}
    assert residual_range_words(state.model_copy(update={"residual_ranges": ranges})) == (
        "Normal range of a residual (95 %): left up to 0.300 mm before calibration (running model),"
        " up to 0.060 mm after it (held-out stops)."
    )


def test_a_plan_is_shown_with_its_design_which_stays_with_it(tmp_path: Path) -> None:
    with new_planned_run(small_twin(12, plan={"method": "random"}), tmp_path / "run") as run:
        plain = sure(plan_section(run))
        write_planned_stops(run, read_planned_stops(run), design=plan_design(12))
        designed = sure(plan_section(run))
        assert_approved(APPROVED / "plans.txt", text_of([plain, designed]), without_digits)
        assert planned_stops(run).design == plan_design(12)
        write_planned_stops(run, read_planned_stops(run))
        assert read_plan_design(run) == plan_design(12)
    with RunFile.create(tmp_path / "imported", small_twin()) as run:
        assert plan_section(run) is None
        run.write_document(PLAN_DESIGN_RESULT, '{"schema": "cellapp-plan-design"}')
        with pytest.raises(InputError, match="plan_design"):
            read_plan_design(run)
