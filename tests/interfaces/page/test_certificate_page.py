"""The certificate as a page: escaped, complete without scripts or network, on two sheets of A4 at most."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright
from pypdf import PdfReader

from cellapp.commands.certificate.result import (
    SIMULATED,
    CertificateResult,
    CertifiedArm,
    CertifiedErrors,
    CertifiedInstrument,
)
from cellapp.commands.certificate.view import budget_table, certificate_sentences, certificate_tables, errors_table
from cellapp.estimation.uncertainty.records import Judgement, UncertaintyContribution
from cellapp.ground.results import ErrorSummary
from cellapp.interfaces.page.page import certificate_page

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


@pytest.mark.fast
def test_names_that_a_user_wrote_are_text() -> None:
    text = certificate_page(certificate(HOSTILE, "right"))
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text
    assert "http" not in text


@pytest.mark.fast
def test_a_contribution_that_is_not_given_leaves_the_sum_open() -> None:
    given = certificate("left", "right")
    changed = given.model_copy(update={"contributions": (*given.contributions, line("SMR", "left", None))})
    rows = {row[0]: row for row in budget_table(changed).text_rows()}
    assert rows["SMR"][1:3] == ("not given", "")
    assert rows["expanded, U"][1:3] == ("not given", f"{2.0 * 0.01 * 6**0.5:.4f}")


@pytest.mark.fast
def test_measured_errors_stand_before_predicted_ones() -> None:
    rows = [row[:2] for row in errors_table(certificate("left")).text_rows()]
    assert rows == [
        ("Arm left, position", "verified targets"),
        ("Arm left, position", "predicted, held out"),
        ("Both arms, distance between them", "predicted, held out"),
    ]


@pytest.mark.fast
def test_marks_come_first_and_the_rule_is_said() -> None:
    said = certificate_sentences(certificate("left"))
    assert said[0].startswith("MARK: not verified")
    assert said[1].startswith("MARK: out of date")
    assert any("not given: location; left" in one for one in said)
    assert len(certificate_tables(certificate("left"))) == 4


@pytest.mark.fast
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
