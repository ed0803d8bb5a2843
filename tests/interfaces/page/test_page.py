"""The report page: complete, self-contained, safe with any names, and valid when later results are missing."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import profile_to_json
from cellapp.cell.run import ReferenceRow, RunFile
from cellapp.cell.run.measurement_order import write_in_order
from cellapp.cell.run.records import ArmOrder
from cellapp.cell.targets.records import VerifyResult
from cellapp.commands.calibrate.charts import pair_stop_chart, stop_error_chart
from cellapp.commands.calibrate.view import distance_mm
from cellapp.commands.report.data import read_report_data
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import CALIBRATION_FILE, append_stage, basis_of, basis_on_model, read_stages
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, CHECK, COMPENSATE, DISCOVER, ISO9283, VERIFY
from cellapp.interfaces.page.page import page_text, write_page
from tests.approved import assert_approved, without_digits
from tests.estimation.uncertainty.cases import pose_test
from tests.interfaces.page.cases import discovery, nothing_missing
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
)
from tests.interfaces.page.test_views import COMPENSATED, VERIFIED, checked
from tests.sure import sure
from tests.twin import altered


def calibration_of(run: RunFile) -> CalibrateResult:
    result = sure(read_results(run).calibrate)
    return result


APPROVED = Path(__file__).parent / "approved"


# -- what the page says in every state, as one text each; numbers depend on the processor ------------------------------


def as_made(run: RunFile) -> None:
    """Calibrated and no more."""


def everything(run: RunFile) -> None:
    """Every result that a run can have."""
    store_discovery(run, discovery(*run.profile.arms))
    in_force = sure(read_stages(run).in_force)
    basis = basis_on_model(run, in_force)
    for name, result in ((COMPENSATE, COMPENSATED), (VERIFY, VERIFIED), (CHECK, checked()), (ISO9283, pose_test())):
        append_stage(run, name, result, basis)
    session = run.begin_session()
    run.record_request(session, "suspend", EVENT)
    run.add_reference(ReferenceRow(EVENT, 0, 0.0, np.zeros(3), session))
    run.log("warning", EVENT)
    write_in_order(run, {"left": ArmOrder(by="rows", approach=7, step=8)})


def nothing_found(run: RunFile) -> None:
    store_discovery(run, DiscoverResult(arms={name: nothing_missing(name) for name in run.profile.arms}))


def pushed_but_not_measured(run: RunFile) -> None:
    append_stage(run, VERIFY, VerifyResult(arms={}, targets=()), basis_of(run))


def without_uncertainty(run: RunFile) -> None:
    store_calibration(run, altered(calibration_of(run), arms={"only": {"tracker_mm": None}}))


def found_again(run: RunFile) -> None:
    """Everything, and a search since that found something else: the verification is of an earlier model."""
    everything(run)
    nothing_found(run)


def measured_again(run: RunFile) -> None:
    """Everything, and stops since."""
    everything(run)
    for name in run.arms():
        readings = run.readings(name).take(np.arange(5))
        run.add_readings(name, replace(readings, configuration=readings.configuration + 1000))


def of_another_version(run: RunFile) -> None:
    text = json.dumps({"schema": "cellapp-discover", "version": 1, "arms": {"only": {}}})
    basis = basis_of(run).model_copy(update={"profile": "changed"})
    run.append_stage(DISCOVER, basis.model_dump_json(), text, None)


PAGES: dict[Callable[[RunFile], None], str] = {
    **dict.fromkeys((as_made, pushed_but_not_measured, without_uncertainty), "single"),
    **dict.fromkeys((of_another_version,), "single"),
    **dict.fromkeys((everything, nothing_found, found_again, measured_again), "pair"),
}


@pytest.mark.parametrize("change", PAGES, ids=lambda change: change.__name__)
def test_a_page_says_what_was_approved(
    change: Callable[[RunFile], None], calibrated_folders: Path, tmp_path: Path
) -> None:
    shutil.copytree(calibrated_folders / PAGES[change], tmp_path / "run")
    with RunFile.open(tmp_path / "run", write=True) as run:
        change(run)
        page = page_of(run)
    assert page.faults == []
    text = re.sub(r"(?s)\{\"(kind|arms|series)\".*?\n", "", page.text.replace(str(tmp_path), "FOLDER"))
    assert_approved(APPROVED / f"page-{change.__name__.replace('_', '-')}.txt", text, without_digits)


def test_a_calibration_that_did_not_converge_is_none(single: RunFile) -> None:
    text = calibration_of(single).to_json().replace('"converged":true', '"converged":false')
    with pytest.raises(InputError, match=r"calibrate: arms\.only\.converged: .* repeat that step"):
        CalibrateResult.from_json(text, "calibrate")


def test_it_needs_nothing_else_and_names_are_only_text(whole_page: Page, whole_text: str) -> None:
    """Of a run with hostile names: well formed, alone, every reference leads somewhere, figures say what they show."""
    assert whole_page.faults == []
    assert len(whole_text.encode()) < 5e6
    for name in (LEFT, RIGHT, NAME, TARGET, UNREACHABLE, EVENT):
        assert name in whole_page.text
    tags = {tag for tag, _ in whole_page.elements}
    assert tags.isdisjoint({"link", "img", "image", "iframe", "object", "embed", "base", "form"})
    names = {name for _, attributes in whole_page.elements for name in attributes}
    assert names.isdisjoint({"src", "srcset", "action", "data", "http-equiv", "background", "xlink:href"})
    assert not [name for name in names if name.startswith("on")]
    assert re.search(r"url\((?!#)|@import|@font-face|javascript:", whole_text) is None
    without_scripts = re.sub(r"<script>.*?</script>", "", whole_text, flags=re.DOTALL)
    assert not re.search("https?:(?!//evil.example)", without_scripts)
    ids = whole_page.values("id")
    assert len(set(ids)) == len(ids) > 30
    references = whole_page.values("href")
    assert all(value.startswith("#") for value in references)
    assert {value[1:] for value in references} | set(re.findall(r"url\(#([^)]*)\)", whole_text)) <= set(ids)
    figures = re.findall(r"<figure[^>]* id=.*?</figure>", whole_text, re.DOTALL)
    assert 20 < len(figures) <= 60
    for figure in figures:
        (message,) = re.findall(r'<p class="message">(.*?)</p>', figure, re.DOTALL)
        assert re.search(r"\d.*\.$", message, re.DOTALL), figure[:200]
    for svg in re.findall(r"<svg.*?</svg>", whole_text, re.DOTALL):
        assert re.search(r"#[0-9a-fA-F]{6}\b", svg) is None, "colours are those of the page"
    styled = set(re.findall(r"(--\w+):", whole_text))
    assert set(re.findall(r"var\((--\w+)\)", whole_text)) <= styled
    assert "prefers-color-scheme: dark" in whole_text
    assert 'content: "simulated cell"' in whole_text
    assert re.search(r'<td class="number" data-value="[-\d.e]{9,}">\d+\.\d{4}</td>', whole_text), "exact, on the right"


def test_what_cannot_be_written_is_refused(single: RunFile, single_text: str, tmp_path: Path) -> None:
    (single.folder / CALIBRATION_FILE).unlink()
    assert page_text(single, NOON) == single_text, "the exported model is not needed"
    (single.folder / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html is a folder"):
        write_page(single)
    assert not list(single.folder.glob("*.part"))
    with RunFile.create(tmp_path / "old", single.profile) as run:
        fill(run)
        with pytest.raises(InputError, match=r"run 'cellapp calibrate .*' first"):
            write_page(run)
        append_stage(run, CALIBRATE, calibration_of(single), basis_of(run))
        with pytest.raises(InputError, match=r"model is missing.*run 'cellapp calibrate .*'"):
            write_page(run)
        assert not (run.folder / "report.html").exists()


# -- numbers and files ------------------------------------------------------------------------------------------------


def test_figures_show_what_the_tables_say(whole: RunFile) -> None:
    data, calibrate = read_report_data(RunState(whole)), calibration_of(whole)
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
    pair = pair_stop_chart(calibrate)
    methods = [method for method in calibrate.pair if method != "nominal"]
    assert {"method_1", "effects"} <= set(methods)
    assert [one.name for one in pair.series] == methods
    for one, method in zip(pair.series, methods):
        assert one.y.mean() == pytest.approx(calibrate.pair[method].cooperative_mm.mean, rel=1e-9)
    left, right = (arm.tracker_mm for arm in calibrate.arms.values())
    assert [*floors, pair.limits[0].value] == [left, right, distance_mm(left, right)]


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


# -- numbers ----------------------------------------------------------------------------------------------------------
