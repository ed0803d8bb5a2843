"""The first screen of the page: errors against tolerances, before and after, what was found, what to do next."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.cell.profile import load_profile
from cellapp.commands.certificate.view import certificate_sentences, certificate_tables
from cellapp.commands.certificate_result import (
    SIMULATED,
    CertificateResult,
    CertifiedArm,
    CertifiedErrors,
    CertifiedInstrument,
)
from cellapp.commands.next_step import Next
from cellapp.commands.report.data import ReportData
from cellapp.commands.report.sections import SECTIONS, placed
from cellapp.commands.report.summary import findings, judged_matrix, steps, verdict
from cellapp.commands.run_results import RunResults
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import Column, Interval, Number, Table
from cellapp.commands.view.words import judged_sentence, judgement_table
from cellapp.estimation.uncertainty.records import Characteristic, Conformity, Judgement, UncertaintyContribution
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Instrument, Tolerances, Traceability
from cellapp.ground.results import ErrorSummary
from cellapp.interfaces.page.page import certificate_page
from tests.approved import assert_approved, text_of
from tests.interfaces.page.cases import discovery
from tests.interfaces.page.parsed_page import Page
from tests.twin import PROFILES

APPROVED = Path(__file__).parent / "approved"
TWIN = load_profile(PROFILES / "twin.yaml")
TODAY = date(2026, 6, 1)
STATES: tuple[Conformity, ...] = ("conforms", "does not conform", "not decided")


def judged(
    characteristic: Characteristic, where: str, conformity: Conformity, value_mm: float | None = 0.05
) -> Judgement:
    return Judgement(
        characteristic=characteristic,
        where=where,
        value_mm=value_mm,
        expanded_mm=None if value_mm is None else 0.02,
        tolerance_mm=0.1,
        rule="guarded",
        conformity=conformity,
        source="verification, 20 targets",
        n=20,
    )


def data_of(profile: Profile | None = None, *, next_step: Next | None = None, **results: Any) -> ReportData:
    """What a run has, with results as given."""
    found = RunResults(run="/cells/run", **results)
    return ReportData(
        profile=profile or TWIN,
        results=found,
        calibrate=cast(Any, SimpleNamespace(arms={}, pair={})),
        calibrated=cast(Any, None),
        discovered=None,
        readings={},
        in_order={},
        events=(),
        model_in_force="",
        next_step=next_step,
    )


# -- verdict ----------------------------------------------------------------------------------------------------------


@given(st.lists(st.sampled_from(STATES), min_size=1, max_size=8))
def test_the_verdict_is_the_worst_of_all(states: list[Conformity]) -> None:
    found = verdict(data_of(), [judged("position", f"arm{number}", one) for number, one in enumerate(states)])
    worst = next(one for one in ("does not conform", "not decided", "conforms") if one in states)
    assert found.state == worst
    assert ("does not" in found.title) == (worst == "does not conform")
    if worst == "conforms":
        assert found.sentence == f"All {counted(len(states), 'error')} with a tolerance are inside it."
    else:
        assert found.sentence.startswith(
            f"{states.count('conforms')} of {counted(len(states), 'error')} with a tolerance"
        )


@given(
    st.lists(st.tuples(st.sampled_from(["position", "drift"]), st.sampled_from(["left", "right", "left and right"])))
)
def test_no_judgement_is_lost_in_the_matrix(which: list[tuple[Characteristic, str]]) -> None:
    judgements = [judged(characteristic, where, "conforms") for characteristic, where in which]
    matrix = judged_matrix(judgements, ["left", "right"])
    shown = [one for row in matrix.rows for one in (*row.by_arm.values(), row.together) if one is not None]
    assert sorted(id(one) for one in shown) == sorted(map(id, judgements))
    assert len(judgement_table(judgements).rows) == len(judgements)


# -- findings and next steps ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("day", "due"), [(TODAY, False), (date(2028, 1, 1), True)], ids=["before", "after"])
def test_a_tracker_whose_calibration_is_due_is_named(day: date, due: bool) -> None:
    tracker = Instrument(model="AT960", calibrated=date(2026, 3, 2), due=date(2027, 3, 2))
    profile = TWIN.model_copy(update={"traceability": Traceability(tracker=tracker)})
    said = [step.text for step in steps(data_of(profile), (), day)]
    assert any("2027-03-02" in step for step in said) == due


def summaries() -> Iterator[object]:
    """What the first screen says of runs that lack, outdated, found or were not asked for something."""
    outdated = {"discover": "5 readings were added since"}
    position = [judged("position", "left", "conforms")]
    missing = [
        judged("cooperative", "left and right", "not decided", None),
        judged("drift", "left", "not decided", None),
    ]
    cases = {
        "no tolerances": (data_of(TWIN.model_copy(update={"tolerances": Tolerances()})), []),
        "out of date": (data_of(out_of_date={"calibrate": "5 readings were added since"}), position),
        "effects": (data_of(discover=discovery("left", "right")), position),
        "stops were added": (
            data_of(next_step=Next("Measure the planned stops that are left:", "cellapp collect /cells/run")),
            [],
        ),
        "missing": (data_of(next_step=Next("Go on with:", "cellapp discover /cells/run"), out_of_date=outdated), []),
        "not measured": (data_of(), missing),
    }
    for name, (data, judgements) in cases.items():
        yield f"--- {name}"
        yield verdict(data, judgements)
        yield judged_sentence(judgements) if judgements else ""
        yield from (*findings(data), *steps(data, judgements, TODAY), judged_matrix(judgements, ["left", "right"]))


def test_the_summary_says_what_was_approved() -> None:
    assert_approved(APPROVED / "summary.txt", "\n".join(map(str, summaries())))


# -- sections and tables ----------------------------------------------------------------------------------------------


def test_sections_that_have_nothing_are_left_out_and_the_others_keep_their_order() -> None:
    made = {key: None if key == "paths" else Section([], message="Something.") for key in reversed(list(SECTIONS))}
    sections = placed(made, {"calibrate": "readings were added"})
    assert [section.key for section in sections] == [key for key in SECTIONS if key != "paths"]
    marked = {section.key for section in sections if section.outdated}
    assert {"accuracy", "residuals", "parameters"} <= marked
    assert not any(section.folded for section in sections if section.outdated)
    assert "discovery" not in marked, "what does not hold there is left out"


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_saved_numbers_are_exact(value: float) -> None:
    row = (
        value,
        Number(value, 2),
        Number(value, 2, "mm"),
        Interval(value, value),
        int(value) if abs(value) < 1e9 else 0,
    )
    columns = (Column("a", ".3f"), *(Column(name, "") for name in "bcde"))
    ((shown, number, with_unit, interval, whole),) = Table("t", columns, (row,)).shown_and_exact()
    assert float(shown[1] or shown[0]) == value
    assert float(number[1] or number[0]) == value
    assert with_unit[1] == "", "a number with its own unit is saved as it is shown"
    assert [float(limit) for limit in interval[1].split(" to ")] == [value, value]
    assert whole[1] == ""


# -- The certificate as a page: escaped, complete without scripts or network, on two sheets of A4 at most --------------

HOSTILE = "<script>alert(1)</script>"
BEFORE = ErrorSummary(mean=4.0, rms=4.2, std=1.0, max=6.0, p95=5.9, n=20)
AFTER = ErrorSummary(mean=0.026, rms=0.03, std=0.01, max=0.054, p95=0.041, n=20)
SOURCES = ("tracker", "SMR centering", "air temperature", "arm repeatability", "calibrated model", "station")


def line(source: str, where: str, value: float | None) -> UncertaintyContribution:
    return UncertaintyContribution(
        source=source, standard_mm=value, evaluation="B", basis="as its certificate states it", where=where
    )


def certificate(*arms: str) -> CertificateResult:
    """A certificate with all parts, of arms with these names."""
    errors = CertifiedErrors(found=BEFORE, left=AFTER, predicted_found=BEFORE, predicted_left=AFTER)
    return CertificateResult(
        number="QA 17",
        run="logs/run",
        profile=arms[0],
        issued="2026-01-02T12:00:00+00:00",
        measured=("2026-01-01T08:00:00.000+00:00", "2026-01-02T09:30:00.000+00:00"),
        program="cellapp 0.1.0",
        organisation=arms[0],
        arms={name: CertifiedArm(type="UR10", readings=400, errors=errors, payload_kg=(0.3, 0.3)) for name in arms},
        pair=CertifiedErrors(predicted_found=BEFORE, predicted_left=AFTER),
        instruments=tuple(CertifiedInstrument(role=role, serial="7") for role in ("laser tracker", "SMR", "bar")),
        judgements=tuple(judged("position", name, "conforms") for name in arms),
        contributions=tuple(line(source, name, 0.01) for name in arms for source in SOURCES),
        limits=("The as-left figures are of the verified targets.",),
        missing=("location", arms[0]),
        warnings=("not verified: nothing was measured",),
        out_of_date=("verify: 20 readings were added since",),
        files=("certificate.json", "certificate.html"),
        rests_on={"certified/profile.json": "0" * 64, "certified/readings.csv": "1" * 64},
    )


def test_names_that_a_user_wrote_are_text() -> None:
    text = certificate_page(certificate(HOSTILE, "right"))
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text
    assert "http" not in text


def test_a_certificate_says_what_was_approved() -> None:
    """With a contribution that is not given, the sum stays open; a simulated cell is called so in the first line."""
    given = certificate("left", "right")
    simulated = given.model_copy(
        update={
            "contributions": (*given.contributions, line("SMR", "left", None)),
            "warnings": (f"{SIMULATED}: no real arm was measured",),
        }
    )
    parts = [text_of([*certificate_sentences(one), *certificate_tables(one)]) for one in (given, simulated)]
    pages = [Page(certificate_page(one)).text for one in (given, simulated)]
    shown = "\n".join([*parts, *pages])
    assert_approved(APPROVED / "certificate.txt", shown)
