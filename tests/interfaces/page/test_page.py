"""The report page: complete, self-contained, safe with any names, and valid when later results are missing."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.formats import formats_of
from cellapp.cell.profile import profile_to_json
from cellapp.cell.run import RunFile
from cellapp.cell.run.measurement_order import write_in_order
from cellapp.cell.run.records import ArmOrder
from cellapp.commands.calibrate.charts_accuracy import pair_stop_chart, stop_error_chart
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import (
    calibration_tables,
    detailed_tables,
    distance_mm,
    parameter_tables,
    transform_tables,
)
from cellapp.commands.compensate.tables import verification_tables
from cellapp.commands.discover.run import discover_run
from cellapp.commands.discover.tables import (
    accepted_table,
    invisible_table,
    not_found_table,
    numbered_steps_table,
    size_tables,
)
from cellapp.commands.export.run import calibrated_arms
from cellapp.commands.plan.view import plan_section
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.result import read_results
from cellapp.commands.report.view import all_tables
from cellapp.commands.stages import CALIBRATION_FILE, read_stages
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Section
from cellapp.commands.view.table import with_rows
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE
from cellapp.interfaces.page.page import page_text, write_page
from cellapp.robot.effects import EFFECTS, EffectTerm
from cellapp.robot.model import CellModel
from cellapp.robot.model.nominal import nominal_arm
from tests.interfaces.page.cases import discovery, nothing_missing, unknown_effect
from tests.interfaces.page.parsed_page import NOON, Page, page_of
from tests.interfaces.page.runs import (
    EVENT,
    LEFT,
    NAME,
    RIGHT,
    TARGET,
    UNREACHABLE,
    fill,
    store_calibration,
    store_discovery,
    without_devices,
)

FORMATS = formats_of(ExportFormat)


def calibration_of(run: RunFile) -> CalibrateResult:
    result = read_results(run).calibrate
    assert result is not None
    return result


def drawn_figures(page: Page) -> int:
    """Drawings in figures; those of the first screen and of legends are not in one."""
    return [tag for tag, _ in page.elements].count("figure")


def charts_of(section: Section) -> list[Chart]:
    return [part for part in section.parts if isinstance(part, Chart)]


def sections_in(section: Section) -> Iterator[Section]:
    """The sections inside of one, at any depth."""
    for part in section.parts:
        if isinstance(part, Section):
            yield part
            yield from sections_in(part)


def with_arm(result: CalibrateResult, name: str, **changes: Any) -> CalibrateResult:
    """The result with attributes of one arm replaced."""
    return result.model_copy(update={"arms": {**result.arms, name: result.arms[name].model_copy(update=changes)}})


# -- a run with every result ------------------------------------------------------------------------------------------


def test_is_well_formed(whole: RunFile, whole_page: Page) -> None:
    assert whole_page.faults == []
    found = read_results(whole).discover
    assert found is not None
    pictures = [picture for arm in found.arms.values() for picture in arm.pictures]
    assert pictures
    certainties = sum(arm.uncertainty_mm is not None for arm in found.arms.values())
    plan = plan_section(whole)
    assert plan is not None
    # errors, histogram, run, three of vectors, targets, their uncertainty, steps and effects of each arm;
    # stated bounds; two of the pair; two maps of the cell
    drawn = 23 + len(pictures) + certainties + len(charts_of(plan))
    assert drawn_figures(whole_page) == drawn
    assert drawn <= 60


def test_the_page_is_below_one_megabyte(whole_text: str) -> None:
    assert len(whole_text.encode()) < 1e6


def test_every_figure_says_what_it_shows(whole_text: str, single_text: str) -> None:
    for text in (whole_text, single_text):
        figures = re.findall(r"<figure[^>]* id=.*?</figure>", text, re.DOTALL)
        assert len(figures) >= 8
        for figure in figures:
            (message,) = re.findall(r'<p class="message">(.*?)</p>', figure, re.DOTALL)
            assert re.search(r"\d", message), figure[:200]
            assert message.endswith(".")


def test_needs_nothing_else(whole_page: Page, whole_text: str) -> None:
    tags = {tag for tag, _ in whole_page.elements}
    assert tags.isdisjoint({"link", "img", "image", "iframe", "object", "embed", "base", "form"})
    names = {name for _, attributes in whole_page.elements for name in attributes}
    assert names.isdisjoint({"src", "srcset", "action", "data", "http-equiv", "background", "xlink:href"})
    assert not [name for name in names if name.startswith("on")]
    assert all(value.startswith("#") for value in whole_page.values("href"))
    outside = r"url\((?!#)|@import|@font-face|javascript:"
    assert re.search(outside, whole_text) is None
    without_scripts = re.sub(r"<script>.*?</script>", "", whole_text, flags=re.DOTALL)
    escaped = without_scripts.replace("https://evil.example/x.js", "").replace("http://evil.example", "")
    assert "http:" not in escaped
    assert "https:" not in escaped


def test_ids_are_unique_and_all_references_lead_somewhere(whole_page: Page, whole_text: str) -> None:
    ids = whole_page.values("id")
    assert len(ids) > 40
    assert len(set(ids)) == len(ids)
    referred = {value[1:] for value in whole_page.values("href")} | set(re.findall(r"url\(#([^)]*)\)", whole_text))
    assert referred
    assert referred <= set(ids)


def test_figures_take_their_colours_from_the_page(whole_text: str) -> None:
    for svg in re.findall(r"<svg.*?</svg>", whole_text, re.DOTALL):
        assert re.search(r"#[0-9a-fA-F]{6}\b", svg) is None
        assert "currentColor" in svg or "var(--" in svg or "<text" in svg
    styled = set(re.findall(r"(--\w+):", whole_text))
    assert set(re.findall(r"var\((--\w+)\)", whole_text)) <= styled
    assert "prefers-color-scheme: dark" in whole_text


def test_holds_every_table(whole: RunFile, whole_page: Page) -> None:
    results = read_results(whole)
    calibrate, discover, verify = results.calibrate, results.discover, results.verify
    assert calibrate is not None
    assert discover is not None
    assert verify is not None
    cells = set(whole_page.texts)
    tables = [*calibration_tables(calibrate), *parameter_tables(calibrate), *verification_tables(verify)]
    assert len(tables) == 6
    makers = (numbered_steps_table, accepted_table, invisible_table, not_found_table)
    found = [make(name, arm) for name, arm in discover.arms.items() for make in makers]
    found += [table for name, arm in discover.arms.items() for table in size_tables(name, arm)]
    assert found[0].rows
    tables += with_rows(*found)
    for table in tables:
        assert table.title in cells
        for row in table.text_rows():
            assert {cell for cell in (*table.headings, *row) if cell} <= cells
    assert "theta1" in cells  # merged into another one


def test_numbers_stand_on_the_right(whole: RunFile, whole_text: str) -> None:
    verify = read_results(whole).verify
    assert verify is not None
    error = verify.targets[0].nominal_mm
    assert f'<td class="number" data-value="{error!r}">{error:.4f}</td>' in whole_text
    assert '<th scope="col" class="number">mean</th>' in whole_text
    assert '<th scope="col">unit</th>' in whole_text


def test_mentions_every_step(whole: RunFile, whole_page: Page) -> None:
    verify = read_results(whole).verify
    assert verify is not None
    text = whole_page.text
    assert "backlash" in text
    for arm in verify.arms.values():
        before, after = arm.nominal_mm.mean, arm.compensated_mm.mean
        assert after < before
        assert f"{before:.4f}" in text
        assert f"{after:.4f}" in text
    assert f"target {UNREACHABLE}: " in text
    assert "distance between both arms " in text
    assert "60: 30 identify, 10 train, 20 validate, 0 unused; driver: simulated" in text
    assert "Out of date" not in text


def test_a_simulated_cell_is_called_so_in_the_first_line(whole_page: Page, whole_text: str, single_text: str) -> None:
    assert whole_page.words.split("Calibration report: ")[2].startswith(f"{' '.join(NAME.split())} (simulated cell)")
    assert 'content: "simulated cell"' in whole_text
    assert "simulated cell" not in single_text, "its readings are given; nothing is simulated"


def test_hostile_names_are_only_text(whole_page: Page) -> None:
    for name in (LEFT, RIGHT, NAME, TARGET, UNREACHABLE, EVENT):
        assert name in whole_page.text


def test_figures_show_what_the_tables_say(whole: RunFile) -> None:
    data, calibrate = read_report_data(whole), calibration_of(whole)
    floors = []
    for name, arm in calibrate.arms.items():
        chart = stop_error_chart(name, data.held_out[name], arm.tracker_mm)
        errors = {one.name: one.y for one in chart.series}
        floors.append(chart.limits[0].value)
        assert list(errors) == list(arm.validate_)
        assert {"nominal", "geometry", "effects"} <= set(errors)
        for stage, stored in arm.validate_.items():
            assert len(errors[stage]) == 20
            assert errors[stage].mean() == pytest.approx(stored.position_mm.mean, rel=1e-9)
    assert any("network" in arm.validate_ for arm in calibrate.arms.values())
    pair = pair_stop_chart(calibrate)
    methods = [method for method in calibrate.pair if method != "nominal"]
    assert {"method_1", "effects"} <= set(methods)
    assert [one.name for one in pair.series] == methods
    for one, method in zip(pair.series, methods):
        assert one.y.mean() == pytest.approx(calibrate.pair[method].cooperative_mm.mean, rel=1e-9)
    left, right = (arm.tracker_mm for arm in calibrate.arms.values())
    assert [*floors, pair.limits[0].value] == [left, right, distance_mm(left, right)]


def test_errors_stand_beside_their_intervals_and_the_tracker(whole: RunFile, whole_page: Page) -> None:
    calibrate = calibration_of(whole)
    tables = detailed_tables(calibrate)
    assert len(tables) == len(calibrate.arms) + 1
    cells = set(whole_page.texts)
    for table in (*tables, *transform_tables(calibrate)):
        assert table.title in cells
        for row in table.text_rows():
            assert {cell for cell in (*table.headings, *row) if cell} <= cells
    summary = calibrate.pair["effects"].cooperative_mm
    assert summary.mean_ci95 is not None
    low, high = summary.mean_ci95
    shown = {row[0]: dict(zip(tables[-1].headings, row)) for row in tables[-1].text_rows()}["geometry and effects"]
    assert shown["95 % of mean"] == f"{low:.4f} to {high:.4f}"
    assert shown["p95"] == f"{summary.p95:.4f}"
    left, right = (arm.tracker_mm for arm in calibrate.arms.values())
    noise = distance_mm(left, right)
    assert noise is not None
    assert shown["rms / tracker"] == f"{summary.rms / noise:.1f}"


def test_inter_base_transform_by_either_way(whole: RunFile, whole_page: Page) -> None:
    for method in calibration_of(whole).pair.values():
        assert method.identified
        for estimate in method.identified.values():
            factor = 1e3 if estimate.unit == "m" else 180.0 / np.pi
            for value in (estimate.value, estimate.standard_error, estimate.by_tracker):
                assert value is not None
                assert f"{value * factor:.5f}" in whole_page.texts


def test_provenance_says_what_was_derived_from_the_order_of_the_readings(single: RunFile, single_text: str) -> None:
    assert "Order of measurement" not in Page(single_text).text
    write_in_order(single, {"only": ArmOrder(by="rows", approach=7, step=8)})
    assert (
        "arm only: measured in the order of the rows; 7 approach signs and 8 steps"
        in Page(page_text(single, NOON)).text
    )


def test_provenance_names_its_files_by_their_hashes(whole: RunFile, whole_page: Page) -> None:
    profile = hashlib.sha256(profile_to_json(whole.profile).encode()).hexdigest()
    calibration = hashlib.sha256((whole.folder / CALIBRATION_FILE).read_bytes()).hexdigest()
    assert profile in whole_page.texts
    assert calibration in whole_page.texts
    assert len([text for text in whole_page.texts if re.fullmatch(r"[0-9a-f]{64}", text)]) == 4


def test_same_run_same_bytes_except_for_the_time(single: RunFile, single_text: str) -> None:
    path = write_page(single)
    assert path == single.folder / "report.html"
    written = path.read_bytes().decode("utf-8")
    time = r'<time datetime="[^"]*">[^<]*</time>'
    assert re.sub(time, "", written) == re.sub(time, "", single_text)
    assert not list(single.folder.glob("*.part"))


# -- results that are missing -----------------------------------------------------------------------------------------


def test_says_what_is_missing_and_how_to_get_it(single_text: str) -> None:
    page = Page(single_text)
    text = page.text
    assert page.faults == []
    assert drawn_figures(page) == 8  # errors, histogram, run, three of vectors; two maps
    assert "cellapp discover DIR" in text
    assert "cellapp push DIR TARGETS --verify" in text
    assert "the profile has 1 arm(s)" in text
    assert "no effects: not searched for yet" in text
    assert "Missing effects were not searched for yet." in text


def test_readings_without_stated_uncertainty(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", without_devices("only")) as run:
        fill(run, sigma_m=None)
        calibrate_run(run)
        discover_run(run)
        text = page_text(run, NOON)
        tables = all_tables(read_results(run))
        assert "nan" not in {cell for table in tables for row in table.text_rows() for cell in row}
    page = Page(text)
    assert page.faults == []
    assert not re.search(r"noise floor, \d", page.words), "no uncertainty is stated"


def test_tracker_column_is_empty_where_no_uncertainty_is_stated(single: RunFile) -> None:
    result = with_arm(calibration_of(single), "only", tracker_mm=None)
    (table,) = detailed_tables(result)
    assert {row[-1] for row in table.rows} == {None}
    store_calibration(single, result)
    assert "The readings state no uncertainty" in page_text(single, NOON)


def test_uncalibrated_run_is_refused(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", without_devices("only")) as run:
        fill(run)
        with pytest.raises(InputError, match="run 'cellapp calibrate' first"):
            write_page(run)
        assert not (run.folder / "report.html").exists()


def test_exported_model_is_not_needed(single: RunFile, single_text: str) -> None:
    (single.folder / CALIBRATION_FILE).unlink()
    assert page_text(single, NOON) == single_text


def test_old_run_without_its_model_is_refused(single: RunFile, tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "old", single.profile) as old:
        fill(old)
        old.write_result(CALIBRATE, calibration_of(single).to_json())
        with pytest.raises(InputError, match=r"model is missing.*run 'cellapp calibrate'"):
            write_page(old)


def test_page_that_cannot_be_written(single: RunFile) -> None:
    (single.folder / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html is a folder"):
        write_page(single)
    assert not list(single.folder.glob("*.part"))


# -- a discovery in which everything occurs ---------------------------------------------------------------------------


def test_discovery_shows_everything_that_was_found(double: RunFile) -> None:
    store_discovery(double, discovery(LEFT, RIGHT))
    text = page_text(double, NOON)
    page = Page(text)
    assert page.text.count("The effect is ") == len(unknown_effect(LEFT).pictures)
    assert page.faults == []
    ids = page.values("id")
    assert len(set(ids)) == len(ids)
    assert f"Arm {LEFT}: unknown effect" in page.texts
    assert f"Arm {RIGHT}: nothing missing" in page.texts
    for words in (
        "Something that the library does not have; 31 µm rms held out.",
        "pedestal_compliance or link_bending would explain these data as well as joint_compliance",
        "Nearly as good as joint_compliance, but ruled out by these data: tracker_angle_error.",
        "There is no figure of joint_compliance for joint 6: the SMR hardly moves with this joint.",
        "Effect without a name: joint 5, q2",
        "No reading was taken from 128° to -170°.",
        "With 20 simulations without effects",
        "Something behaves like backlash, but of the opposite sign: check the approach convention.",
        "Law not quite as expected: what joint_compliance moves beside its law is 18 % of what the law moves.",
        "What it means: joint compliance, joints 2-4, 6",
        "The gears of joints 2, 3, 4 and 6 twist. Usual size: 1 to 3 mm (computed).",
        "Repeat 20 stops with a second payload.",
        "What is left still depends on time (p below 0.001).",
        f"Arm {LEFT}: probability of each effect that was tested",
        f"Arm {LEFT}: structure of what is left",
    ):
        assert words in page.words
    captions = [attributes["aria-label"] for tag, attributes in page.elements if tag == "figure"]
    assert f"Arm {LEFT}: transmission error, joint 1" in captions
    assert f"Arm {LEFT}: joint compliance, joint 3, against the gravity torque on joint 3" in captions
    for svg in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        assert re.search(r"#[0-9a-fA-F]{6}\b", svg) is None


def test_nothing_missing_is_said(double: RunFile) -> None:
    store_discovery(double, DiscoverResult(arms={name: nothing_missing(name) for name in (LEFT, RIGHT)}))
    text = page_of(double).text
    assert "Out of date" not in text
    assert "nothing missing: 23 µm rms held out" in text
    assert "no effects: none was found" in text


def test_effects_of_time_are_drawn_as_they_were_evaluated(double: RunFile) -> None:
    step = EffectTerm(
        slug="base_step",
        names=("base_step_x",),
        values=np.array([2e-3]),
        standard_errors=np.array([1e-6]),
        units=("m",),
        law=EFFECTS["base_step"].law("onset", {"onset_s": 30.5}),
    )
    model = CellModel.from_json(read_stages(double).current[CALIBRATE].model or "")
    arms = {**model.arms, LEFT: replace(model.arms[LEFT], effects=(step,))}
    store_discovery(double, discovery(LEFT, RIGHT), replace(model, arms=arms).to_json())
    readings = double.readings(LEFT)
    rows = readings.in_split("validate")
    held_out = readings.take(rows)
    geometry = model.arms[LEFT].predict(held_out.q)
    after = held_out.time_s > 30.5
    assert 0 < after.sum() < len(after)
    chart = stop_error_chart(LEFT, read_report_data(double).held_out[LEFT], None)
    (shown,) = (one.y for one in chart.series if one.name == "effects")
    plain = np.linalg.norm(held_out.p_M - geometry, axis=1) * 1e3
    assert shown[~after] == pytest.approx(plain[~after], abs=1e-6)
    assert np.abs(shown[after] - plain[after]).min() > 0.2


def test_a_calibration_that_did_not_converge_is_no_good_news(single: RunFile) -> None:
    result = with_arm(calibration_of(single), "only", converged=False, message="gave up after 50 iterations")
    store_calibration(single, result)
    text = page_of(single).text
    assert "the calibration did not converge (gave up after 50 iterations): do not use it" in text


# -- numbers ----------------------------------------------------------------------------------------------------------


def test_distance_noise_is_that_of_two_points() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(0.0, 0.02, (20_000, 3)), rng.normal(0.0, 0.05, (20_000, 3))
    lengths = [float(np.sqrt(np.mean(np.sum(noise**2, axis=1)))) for noise in (first, second)]
    apart = np.array([1000.0, 0.0, 0.0])
    errors = np.linalg.norm(apart + first - second, axis=1) - 1000.0
    assert distance_mm(*lengths) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.03)
    assert distance_mm(0.1, None) is None


def test_parameters_show_how_far_they_are_from_nominal(single: RunFile, single_text: str) -> None:
    identified = calibration_of(single).arms["only"].identified["a2"].value
    nominal = nominal_arm(single.profile.arms["only"]).rows[1, 2]
    cells = (f"{nominal * 1e3:.5f}", f"{identified * 1e3:.5f}", f"{(identified - nominal) * 1e3:+.5f}")
    expected = "".join(rf'<td class="number"[^>]*>{re.escape(cell)}</td>' for cell in cells)
    assert re.search(f'<tr><th scope="row">a2</th>{expected}', single_text)


def test_says_what_files_for_other_programs_do_not_hold(whole: RunFile, whole_text: str, single_text: str) -> None:
    text = " ".join(whole_text.split())
    assert ", ".join(FORMATS) in text
    losses = [export.lost_together for export in calibrated_arms(whole, read_stages(whole)).values()]
    assert any(losses)
    for loss in losses:
        assert loss is None or f"{loss.rms_mm:.3f} mm rms, {loss.max_mm:.3f} mm at most" in text
    assert "cellapp export DIR --as FORMAT" in single_text


def test_other_readings_have_another_hash(single: RunFile, tmp_path: Path) -> None:
    def hash_on(run: RunFile) -> str:
        texts = [text for text in page_of(run).texts if text]
        return texts[texts.index("SHA-256 of the readings of arm only") + 1]

    before = hash_on(single)
    with RunFile.create(tmp_path / "other", single.profile) as other:
        fill(other, sigma_m=21e-6)
        calibrate_run(other)
        assert re.fullmatch(r"[0-9a-f]{64}", hash_on(other))
        assert hash_on(other) != before
    assert hash_on(single) == before


def test_importing_the_page_loads_no_drawing_library() -> None:
    code = "import sys, cellapp.interfaces.page.page; print({'jinja2', 'rich'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "set()"
