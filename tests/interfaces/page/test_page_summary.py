"""The first screen of the page: errors against tolerances, before and after, what was found, what to do next."""

from __future__ import annotations

import shutil
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from playwright.sync_api import sync_playwright
from pypdf import PdfReader

from cellapp.cell.profile import load_profile
from cellapp.commands.certificate.result import (
    SIMULATED,
    CertificateResult,
    CertifiedArm,
    CertifiedErrors,
    CertifiedInstrument,
)
from cellapp.commands.certificate.view import budget_table, certificate_sentences, certificate_tables, errors_table
from cellapp.commands.report.data import ReportData
from cellapp.commands.report.result import RunResults
from cellapp.commands.report.sections import SECTIONS, placed
from cellapp.commands.report.summary import judged_matrix, summary, verdict
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import Column, Interval, Number, Table, number_column
from cellapp.commands.view.words import CHARACTERISTIC_WORDS, judged_sentence, judgement_table
from cellapp.estimation.uncertainty.records import Characteristic, Conformity, Judgement, UncertaintyContribution
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Instrument, Tolerances, Traceability
from cellapp.ground.results import ErrorSummary
from cellapp.interfaces.page.page import certificate_page
from tests.interfaces.page.cases import discovery
from tests.twin import PROFILES

TWIN = load_profile(PROFILES / "twin.yaml")
TODAY = date(2026, 6, 1)
STATES: tuple[Conformity, ...] = ("conforms", "does not conform", "cannot say")


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


def data_of(profile: Profile | None = None, *, next_step: str = "", **results: Any) -> ReportData:
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
    worst = next(one for one in ("does not conform", "cannot say", "conforms") if one in states)
    assert found.state == worst
    assert ("does not" in found.title) == (worst == "does not conform")
    if worst == "conforms":
        assert found.sentence == f"All {counted(len(states), 'error')} with a tolerance are inside it."
    else:
        assert found.sentence.startswith(
            f"{states.count('conforms')} of {counted(len(states), 'error')} with a tolerance"
        )


def test_what_does_not_conform_is_named() -> None:
    sentence = judged_sentence(
        [
            judged("position", "left", "does not conform"),
            judged("position", "right", "does not conform"),
            judged("pose_accuracy", "left", "cannot say"),
            judged("drift", "left", "cannot say", None),
            judged("distance", "left", "conforms"),
        ]
    )
    assert "2 do not: position error of left and right" in sentence
    assert "1 not decided within the uncertainty; 1 not measured." in sentence


def test_without_tolerances_it_says_how_to_give_them() -> None:
    profile = TWIN.model_copy(update={"tolerances": Tolerances()})
    found = verdict(data_of(profile), ())
    assert found.state is None
    assert "no tolerances" in found.title
    assert "'tolerances'" in found.sentence


def test_nothing_is_judged_on_a_calibration_that_is_out_of_date() -> None:
    found = verdict(
        data_of(out_of_date={"calibrate": "5 readings were added since"}), [judged("position", "left", "conforms")]
    )
    assert found.state == "cannot say"
    assert "out of date" in found.sentence


@given(
    st.lists(st.tuples(st.sampled_from(["position", "drift"]), st.sampled_from(["left", "right", "left and right"])))
)
def test_no_judgement_is_lost_in_the_matrix(which: list[tuple[Characteristic, str]]) -> None:
    judgements = [judged(characteristic, where, "conforms") for characteristic, where in which]
    matrix = judged_matrix(judgements, ["left", "right"])
    shown = [one for row in matrix.rows for one in (*row.by_arm.values(), row.together) if one is not None]
    assert sorted(id(one) for one in shown) == sorted(map(id, judgements))
    assert len(judgement_table(judgements).rows) == len(judgements)


def test_arms_stand_beside_each_other() -> None:
    matrix = judged_matrix(
        [
            judged("position", "left", "conforms"),
            judged("position", "right", "conforms"),
            judged("cooperative", "left and right", "conforms"),
        ],
        ["left", "right"],
    )
    assert matrix.arms == ("left", "right")
    assert [(row.label, list(row.by_arm)) for row in matrix.rows] == [
        ("Position error", ["left", "right"]),
        (CHARACTERISTIC_WORDS["cooperative"], []),
    ]


# -- before and after -------------------------------------------------------------------------------------------------


# -- findings and next steps ------------------------------------------------------------------------------------------


def test_effects_are_named_with_their_cause_and_what_to_check() -> None:
    found = summary(data_of(discover=discovery("left", "right")), (), TODAY)
    headings = [one.heading for one in found.found]
    assert any(heading.startswith("Arm left: joint compliance, joints 2-4, 6") for heading in headings)
    assert "Arm left: unknown effect" in headings
    assert "Arm right: nothing missing" in headings
    assert any("The gears of joints 2, 3, 4 and 6 twist." in one.text for one in found.found)
    steps = {step.text: step.command for step in found.steps}
    assert steps["Arm left: measure stops that decide what discovery left open:"] == "cellapp discover DIR --propose 30"


def test_steps_do_not_show_whose_folder_it_is() -> None:
    data = data_of(next_step="cellapp discover /cells/run")
    assert summary(data, (), TODAY).steps[0].command == "cellapp discover DIR"


@pytest.mark.parametrize(
    ("verb", "outdated", "words"),
    [
        ("collect", {}, "Measure the planned stops that are left, then calibrate and discover again:"),
        ("discover", {}, "Go on with:"),
        ("discover", {"discover": "5 readings were added since"}, "Repeat what is out of date:"),
    ],
    ids=["stops were added", "missing", "out of date"],
)
def test_the_first_step_is_what_the_run_lacks(verb: str, outdated: dict[str, str], words: str) -> None:
    data = data_of(next_step=f"cellapp {verb} /cells/run", out_of_date=outdated)
    first = summary(data, (), TODAY).steps[0]
    assert (first.text, first.command) == (words, f"cellapp {verb} DIR")


def test_what_has_a_tolerance_and_was_not_measured_is_asked_for() -> None:
    judgements = [
        judged("cooperative", "left and right", "cannot say", None),
        judged("drift", "left", "cannot say", None),
    ]
    commands = [step.command for step in summary(data_of(), judgements, TODAY).steps]
    assert commands[:2] == ["cellapp push DIR TARGETS --verify", "cellapp iso9283 PROFILE --run DIR"]


@pytest.mark.parametrize(("day", "due"), [(TODAY, False), (date(2028, 1, 1), True)], ids=["before", "after"])
def test_a_tracker_whose_calibration_is_due_is_named(day: date, due: bool) -> None:
    tracker = Instrument(model="AT960", calibrated=date(2026, 3, 2), due=date(2027, 3, 2))
    profile = TWIN.model_copy(update={"traceability": Traceability(tracker=tracker)})
    steps = [step.text for step in summary(data_of(profile), (), day).steps]
    assert any("2027-03-02" in step for step in steps) == due


# -- sections and tables ----------------------------------------------------------------------------------------------


def test_sections_that_have_nothing_are_left_out_and_the_others_keep_their_order() -> None:
    made = {key: None if key == "paths" else Section("", [], "Something.") for key in reversed(list(SECTIONS))}
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
    columns = (number_column("a", ".3f"), *(Column(name, "number") for name in "bcde"))
    ((shown, number, with_unit, interval, whole),) = Table("t", columns, (row,)).shown_and_exact()
    assert float(shown[1] or shown[0]) == value
    assert float(number[1] or number[0]) == value
    assert with_unit[1] == "", "a number with its own unit is saved as it is shown"
    assert [float(limit) for limit in interval[1].split(" to ")] == [value, value]
    assert whole[1] == ""


# -- The certificate as a page: escaped, complete without scripts or network, on two sheets of A4 at most --------------

HOSTILE = "<script>alert(1)</script>"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BEFORE = ErrorSummary(mean=4.0, rms=4.2, std=1.0, max=6.0, p95=5.9, n=20)
AFTER = ErrorSummary(mean=0.026, rms=0.03, std=0.01, max=0.054, p95=0.041, n=20)
SOURCES = ("tracker", "SMR centering", "air temperature", "arm repeatability", "calibrated model", "station")


def judgement(where: str) -> Judgement:
    return Judgement(
        characteristic="position",
        where=where,
        value_mm=0.054,
        expanded_mm=0.043,
        tolerance_mm=0.1,
        rule="guarded",
        conformity="conforms",
        source="verification, 20 targets",
        n=20,
    )


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
        judgements=tuple(judgement(name) for name in arms),
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


def test_a_contribution_that_is_not_given_leaves_the_sum_open() -> None:
    given = certificate("left", "right")
    changed = given.model_copy(update={"contributions": (*given.contributions, line("SMR", "left", None))})
    rows = {row[0]: row for row in budget_table(changed).text_rows()}
    assert rows["SMR"][1:3] == ("not given", "")
    assert rows["expanded, U"][1:3] == ("not given", f"{2.0 * 0.01 * 6**0.5:.4f}")


def test_measured_errors_stand_before_predicted_ones() -> None:
    rows = [row[:2] for row in errors_table(certificate("left")).text_rows()]
    assert rows == [
        ("Arm left, position", "verified targets"),
        ("Arm left, position", "predicted, held out"),
        ("Both arms, distance between them", "predicted, held out"),
    ]


def test_marks_come_first_and_the_rule_is_said() -> None:
    said = certificate_sentences(certificate("left"))
    assert said[0].startswith("MARK: not verified")
    assert said[1].startswith("MARK: out of date")
    assert any("not given: location; left" in one for one in said)
    assert len(certificate_tables(certificate("left"))) == 4


def test_a_simulated_cell_is_called_so_in_the_first_line() -> None:
    simulated = certificate("left").model_copy(update={"warnings": (f"{SIMULATED}: no real arm was measured",)})
    first = "Simulated cell: no calibration of real arms."
    assert certificate_page(simulated).split('<p class="soft">')[1].startswith(first)
    assert first not in certificate_page(certificate("left"))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_it_prints_on_two_sheets_and_fits_a_telephone(tmp_path: Path) -> None:
    path = tmp_path / "certificate.html"
    path.write_text(certificate_page(certificate("left", "right")), "utf-8")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM)
        page = browser.new_page(viewport={"width": 390, "height": 800}, java_script_enabled=False)
        page.goto(path.as_uri())
        assert page.locator(".certificate h2").inner_text() == "Calibration certificate"
        box = page.locator(".certificate").bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= 390
        page.pdf(path=tmp_path / "certificate.pdf", prefer_css_page_size=True)
        browser.close()
    sheets = PdfReader(tmp_path / "certificate.pdf").pages
    assert len(sheets) <= 2
    assert [round(float(side) / 72.0 * 25.4) for side in sheets[0].mediabox[2:]] == [210, 297]
    printed = " ".join(sheet.extract_text() for sheet in sheets)
    assert "QA 17" in printed
    assert "of 2" in printed
