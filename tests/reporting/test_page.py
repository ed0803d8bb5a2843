"""The report page: complete, self-contained, safe with any names, and there also when later steps are not."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cellapp.reporting.findings import (
    accepted_table,
    gap_table,
    invisible_table,
    not_found_table,
    parameter_table,
)

from cellapp.calibration.calibrate import CALIBRATION_FILE, calibrate_run
from cellapp.calibration.evaluation import Summary, summarise
from cellapp.compensation.push import Verification, Verified, Way
from cellapp.discovery.discover import discover_run
from cellapp.effects import EffectTerm, Law
from cellapp.errors import InputError
from cellapp.kinematics.chain import smr_positions
from cellapp.model import CellModel
from cellapp.model.nominal import nominal_arm
from cellapp.profile import Discovery, NoDriver, Profile, Splits, load_profile, profile_to_json
from cellapp.reporting import figures
from cellapp.reporting.page import page_text, write_page
from cellapp.reporting.tables import (
    all_tables,
    calibration_tables,
    detailed_tables,
    distance_mm,
    parameter_tables,
    transform_tables,
    verification_tables,
)
from cellapp.run import Readings, RunFile
from tests.arms import STATION, true_geometry
from tests.reporting.made import made_result, nothing_missing

PROFILE = Path(__file__).parents[2] / "profiles" / "twin.yaml"
NOON = datetime(2026, 1, 2, 12, 0, 0, tzinfo=UTC)
LEFT = "<script>alert('left')</script>"
RIGHT = '右"><img src=x onerror=alert(2)> & $x_'
NAME = "</title></style><script src='https://evil.example/x.js'></script>"
TARGET = "<b onclick=alert(3)>t</b>"
EVENT = "<iframe src='http://evil.example'></iframe> &amp; more"
VOID = {"meta", "br", "hr", "img", "link", "input"}
FLOOR_MM = 20e-3 * np.sqrt(3.0)


def profile_of(*arms: str, network: str = "none") -> Profile:
    """Some arms of the twin's kinds under other names, all without devices."""
    twin = load_profile(PROFILE)
    none = NoDriver(kind="none")
    kinds = [arm.model_copy(update={"driver": none}) for arm in twin.arms.values()]
    return twin.model_copy(
        update={
            "name": NAME,
            "arms": dict(zip(arms, kinds)),
            "tracker": twin.tracker.model_copy(update={"driver": none}),
            "splits": Splits(identify=40, train=0, validate=20, pair_identify=40, pair_validate=20),
            "network": twin.network.model_copy(update={"kind": network}),
            "discovery": Discovery(null_simulations=20, folds=2, false_alarm=0.05),
            "plant": None,
            "targets": None,
        }
    )


def fill(run: RunFile, *, sigma_m: float | None = 20e-6) -> None:
    """60 stops of every arm with other lengths and angles, and with backlash in joints 1 to 3."""
    rng = np.random.default_rng(5)
    for shift, (name, arm) in enumerate(run.profile.arms.items()):
        station = STATION.copy()
        station[0, 3] += 1.5 * shift
        true = true_geometry(nominal_arm(arm).with_T_M_B(station), rng)
        q = rng.uniform(-2.5, 2.5, (60, 6))
        approach = rng.choice([-1, 1], (60, 6)).astype(np.int8)
        play = np.array([2e-4, 2e-4, 2e-4, 0.0, 0.0, 0.0])
        p_M = smr_positions(true, q - approach * play) + rng.normal(0.0, 20e-6, (60, 3))
        run.add_readings(
            name,
            Readings(
                configuration=np.arange(60, dtype=np.int64),
                time_s=np.arange(60.0),
                q=q,
                approach=approach,
                p_M=p_M,
                sigma_m=None if sigma_m is None else np.full(60, sigma_m),
            ),
        )


def verification() -> dict[str, Any]:
    measured = [Verified(TARGET, arm, 3.25e-3, 0.0271e-3, "") for arm in (LEFT, RIGHT)]
    refused = Verified("far", LEFT, None, None, "the model does not reach <it>")
    both: dict[Way, Summary] = {
        "nominal": summarise(np.array([3.25e-3])),
        "compensated": summarise(np.array([0.0271e-3])),
    }
    return Verification((*measured, refused), {LEFT: both, RIGHT: both}).as_dict()


class Page(HTMLParser):
    """A page taken apart; ``faults`` tells where elements are not closed as they were opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.faults: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        self.faults += self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open.pop() != tag:
            self.faults.append(f"/{tag} at {self.getpos()}")

    def handle_data(self, data: str) -> None:
        self.texts.append(data.strip())

    @property
    def text(self) -> str:
        return "\n".join(text for text in self.texts if text)

    def values(self, attribute: str) -> list[str]:
        return [value or "" for _, attributes in self.elements if (value := attributes.get(attribute, "")) != ""]


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunFile]:
    """A run with all results, whose names are as hostile as they can be."""
    with RunFile.create(tmp_path_factory.mktemp("full"), profile_of(LEFT, RIGHT, network="mlp")) as run:
        fill(run)
        run.log("warning", EVENT)
        calibrate_run(run)
        discover_run(run)
        run.write_result("verify", json.dumps(verification()))
        yield run


@pytest.fixture(scope="module")
def full_text(full: RunFile) -> str:
    return page_text(full, NOON)


@pytest.fixture(scope="module")
def page(full_text: str) -> Page:
    return Page(full_text)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one arm and of two, without devices, calibrated and no more; tests work on copies."""
    folder = tmp_path_factory.mktemp("calibrated")
    for name, arms in (("single", ["only"]), ("made", [LEFT, RIGHT])):
        with RunFile.create(folder / name, profile_of(*arms)) as run:
            fill(run)
            calibrate_run(run)
    return folder


@pytest.fixture
def single(calibrated: Path, tmp_path: Path) -> Iterator[RunFile]:
    """One arm without devices, calibrated and no more."""
    shutil.copytree(calibrated / "single", tmp_path / "single")
    with RunFile.open(tmp_path / "single", write=True) as run:
        yield run


def results_of(run: RunFile) -> dict[str, Any]:
    texts = {step: run.read_result(step) for step in ("calibrate", "discover", "verify")}
    return {step: json.loads(text) for step, text in texts.items() if text is not None}


def test_is_well_formed(full: RunFile, page: Page) -> None:
    assert page.faults == []
    # errors, histogram, two of vectors, targets, gap and pictures of each arm; two of the pair; three of the cell
    pictures = [picture for arm in results_of(full)["discover"]["arms"].values() for picture in arm["pictures"]]
    assert pictures
    assert [tag for tag, _ in page.elements].count("svg") == 17 + len(pictures)


def test_needs_nothing_else(page: Page, full_text: str) -> None:
    tags = {tag for tag, _ in page.elements}
    assert tags.isdisjoint({"script", "link", "img", "image", "iframe", "object", "embed", "base", "form", "a"})
    names = {name for _, attributes in page.elements for name in attributes}
    assert names.isdisjoint({"src", "srcset", "action", "data", "http-equiv", "background", "xlink:href"})
    assert not [name for name in names if name.startswith("on")]
    assert all(value.startswith("#") for value in page.values("href"))
    outside = r"url\((?!#)|@import|@font-face|javascript:"
    assert re.search(outside, full_text) is None
    escaped = full_text.replace("https://evil.example/x.js", "").replace("http://evil.example", "")
    assert "http:" not in escaped
    assert "https:" not in escaped


def test_ids_are_unique_and_all_references_lead_somewhere(page: Page, full_text: str) -> None:
    ids = page.values("id")
    assert len(ids) > 100
    assert len(set(ids)) == len(ids)
    referred = {value[1:] for value in page.values("href")} | set(re.findall(r"url\(#([^)]*)\)", full_text))
    assert referred
    assert referred <= set(ids)


def test_figures_take_their_colours_from_the_page(full_text: str) -> None:
    for svg in re.findall(r"<svg.*?</svg>", full_text, re.DOTALL):
        assert re.search(r"#[0-9a-fA-F]{6}\b", svg) is None
        assert "currentColor" in svg
    styled = set(re.findall(r"(--\w+):", full_text))
    assert set(re.findall(r"var\((--\w+)\)", full_text)) <= styled
    assert "prefers-color-scheme: dark" in full_text


def test_holds_every_table(full: RunFile, page: Page) -> None:
    results = results_of(full)
    cells = set(page.texts)
    calibrate, discover, verify = results["calibrate"], results["discover"], results["verify"]
    tables = [*calibration_tables(calibrate), *parameter_tables(calibrate), *verification_tables(verify)]
    assert len(tables) == 6
    shown = (gap_table, accepted_table, parameter_table, invisible_table, not_found_table)
    found = [make(name, arm) for name, arm in discover["arms"].items() for make in shown]
    assert found[0] is not None
    tables += [table for table in found if table is not None]
    for table in tables:
        assert table.title in cells
        for row in table.rows:
            assert {cell for cell in (*table.columns, *row) if cell} <= cells
    assert "theta1" in cells  # merged into another one


def test_numbers_stand_on_the_right(full_text: str) -> None:
    assert '<td class="number">3.2500</td>' in full_text
    assert '<th scope="col" class="number">mean</th>' in full_text
    assert '<th scope="col">unit</th>' in full_text


def test_speaks_of_every_step(page: Page) -> None:
    text = page.text
    assert "backlash" in text
    assert "At 1 new targets the measured mean error fell from 3.250 mm to 0.027 mm with compensation." in text
    assert "target far: the model does not reach <it>" in text
    assert "The distance between the two arms' SMRs is known to" in text
    assert "60: 40 identify, 0 train, 20 validate, 0 unused; driver: none" in text
    assert "Not in this report" not in text


def test_hostile_names_are_only_text(page: Page) -> None:
    text = page.text
    for name in (LEFT, RIGHT, NAME, TARGET, EVENT):
        assert name in text


def test_figures_show_what_the_tables_say(full: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[dict[str, Any]] = []
    floors: list[float | None] = []
    real = figures.error_figure

    def recording(key: str, configurations: Any, errors_mm: Any, floor_mm: float | None, *label: str) -> str:
        drawn.append(errors_mm)
        floors.append(floor_mm)
        return real(key, configurations, errors_mm, floor_mm, *label)

    monkeypatch.setattr(figures, "error_figure", recording)
    page_text(full, NOON)
    calibrate = results_of(full)["calibrate"]
    pair, *arms = drawn  # the pair is drawn first
    assert len(arms) == len(calibrate["arms"])
    for errors, arm in zip(arms, calibrate["arms"].values()):
        assert list(errors) == list(arm["validate"])
        assert {"nominal", "geometry", "effects"} <= set(errors)
        for stage, values in errors.items():
            assert len(values) == 20
            assert values.mean() == pytest.approx(arm["validate"][stage]["position_mm"]["mean"], rel=1e-9)
    methods = [method for method in calibrate["pair"] if method != "nominal"]
    assert {"method_1", "effects"} <= set(methods)
    assert len(pair) == len(methods)
    for values, method in zip(pair.values(), methods):
        assert values.mean() == pytest.approx(calibrate["pair"][method]["cooperative_mm"]["mean"], rel=1e-9)
    assert floors == pytest.approx([FLOOR_MM * np.sqrt(2.0 / 3.0), FLOOR_MM, FLOOR_MM])


def test_same_run_same_bytes_but_for_the_time(full: RunFile, full_text: str) -> None:
    path = write_page(full)
    assert path == full.folder / "report.html"
    written = path.read_bytes().decode("utf-8")
    time = r'<time datetime="[^"]*">[^<]*</time>'
    assert re.sub(time, "", written) == re.sub(time, "", full_text)
    assert not list(full.folder.glob("*.part"))


def test_user_settings_of_matplotlib_do_not_matter(single: RunFile) -> None:
    import matplotlib

    usual = page_text(single, NOON)
    with matplotlib.rc_context({"axes.grid": True, "svg.fonttype": "path", "font.size": 30.0, "axes.facecolor": "red"}):
        assert page_text(single, NOON) == usual


def test_says_what_is_missing_and_how_to_get_it(single: RunFile) -> None:
    page = Page(page_text(single, NOON))
    text = page.text
    assert page.faults == []
    assert [tag for tag, _ in page.elements].count("svg") == 7  # errors, histogram, two of vectors; three of the cell
    assert "cellapp discover DIR" in text
    assert "the profile names no devices" in text
    assert "cellapp push DIR TARGETS --verify" in text
    assert "the profile has 1 arm(s)" in text
    assert "Verification at new targets:" in text
    assert "Arm only, verified" not in text
    assert "no effects: not looked for yet" in text
    assert "what was missing" not in text


def test_pushed_but_not_measured_counts_as_missing(single: RunFile) -> None:
    single.write_result("verify", json.dumps(Verification((), {}).as_dict()))
    assert "none was measured with both commands" in Page(page_text(single, NOON)).text


def test_effects_of_an_earlier_calibration_are_not_shown(single: RunFile) -> None:
    pretend_discovery(single, "only", "other")
    result = results_of(single)["discover"]
    del result["arms"]["other"]
    single.write_result("discover", json.dumps(result))
    assert "what was missing" in Page(page_text(single, NOON)).text
    calibrate_run(single)
    text = Page(page_text(single, NOON)).text
    assert "what was missing" not in text
    assert "calibrated again since they were found; run anew: cellapp discover DIR" in text


def test_readings_without_stated_uncertainty(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", profile_of("only")) as run:
        fill(run, sigma_m=None)
        calibrate_run(run)
        discover_run(run)
        text = page_text(run, NOON)
        assert "nan" not in {cell for table in all_tables(results_of(run)) for row in table.rows for cell in row}
    assert 'class="swatch floor"' not in text
    assert Page(text).faults == []


@pytest.fixture
def made(calibrated: Path, tmp_path: Path) -> Iterator[RunFile]:
    """Two arms with a result of discovery that is made up, and in which all occurs that can be shown."""
    shutil.copytree(calibrated / "made", tmp_path / "made")
    with RunFile.open(tmp_path / "made", write=True) as run:
        pretend_discovery(run, LEFT, RIGHT)
        yield run


def pretend_discovery(run: RunFile, first: str, second: str) -> None:
    """A made-up result for a run; what is made up is not in its model."""
    calibrate = results_of(run)["calibrate"]
    stages = calibrate["arms"][first]["validate"]
    stages["effects"] = stages["geometry"]
    run.write_result("calibrate", json.dumps(calibrate))
    run.write_result("discover", json.dumps(made_result(first, second)))


def test_discovery_shows_everything_that_was_found(made: RunFile) -> None:
    text = page_text(made, NOON)
    page = Page(text)
    assert page.faults == []
    ids = page.values("id")
    assert len(set(ids)) == len(ids)
    assert f"Arm {LEFT}: unknown effect" in page.texts
    assert f"Arm {RIGHT}: nothing missing" in page.texts
    for words in (
        "Something that the library does not have; 31 um rms held out.",
        "In the place of joint_compliance, pedestal_compliance or link_bending would do as well",
        "Nearly as good as joint_compliance, but told apart from it: tracker_angle_error.",
        "There is no picture of joint_compliance for joint 6: the SMR hardly moves with it.",
        "No name for this: joint 5, q2",
        "No reading was taken from 128° to -170°.",
        "with 20 simulations of nothing",
    ):
        assert words in " ".join(page.text.split())
    captions = [attributes["aria-label"] for tag, attributes in page.elements if tag == "figure"]
    assert f"Arm {LEFT}: transmission error, joint 1" in captions
    assert f"Arm {LEFT}: joint compliance, joint 3, against the gravity torque on joint 3" in captions
    for svg in re.findall(r"<svg.*?</svg>", text, re.DOTALL):
        assert re.search(r"#[0-9a-fA-F]{6}\b", svg) is None


def test_pictures_draw_a_curve_with_its_band_or_a_cloud_without(made: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[figures.Seen, str, str]] = []
    real = figures.effect_figure

    def recording(key: str, seen: figures.Seen, x_label: str, y_label: str) -> str:
        drawn.append((seen, x_label, y_label))
        return real(key, seen, x_label, y_label)

    monkeypatch.setattr(figures, "effect_figure", recording)
    page_text(made, NOON)
    pictures = results_of(made)["discover"]["arms"][LEFT]["pictures"]
    assert len(drawn) == len(pictures)
    for (seen, x_label, y_label), picture in zip(drawn, pictures):
        assert (x_label, y_label) == (picture["x_label"], picture["y_label"])
        assert seen.measured.tolist() == picture["measured"]
        assert (seen.curve is None) == (picture["curve"] is None)


def test_a_line_is_drawn_through_a_function_and_none_through_a_cloud() -> None:
    x = np.linspace(0.0, 5.0, 200)
    none = np.zeros(200)
    rng = np.random.default_rng(0)
    for function in (np.sin(12.0 * x), np.sign(x - 2.0), x**2, np.ones(200)):
        assert figures.Seen(x, function, function, none).is_line
    for cloud in (rng.uniform(0.0, 1.0, 200), x * rng.uniform(0.5, 1.0, 200)):
        assert not figures.Seen(x, cloud, cloud, none).is_line


def test_steps_are_drawn_against_the_floor() -> None:
    with_floor = figures.steps_figure("a", np.array([0.5, 0.1, 0.03]), 0.02)
    without = figures.steps_figure("a", np.array([0.5, 0.1, 0.03]), None)
    assert with_floor.count("stroke-dasharray") == without.count("stroke-dasharray") + 1
    assert "<path" in figures.steps_figure("a", np.array([0.5]), None)
    assert "<path" in figures.certainty_figure("a", np.array([0.1, 0.2]), np.array([0.0, 0.3]))


def test_nothing_missing_is_no_earlier_calibration(made: RunFile) -> None:
    result = {**made_result(LEFT, RIGHT), "arms": {name: nothing_missing(name) for name in (LEFT, RIGHT)}}
    made.write_result("discover", json.dumps(result))
    text = Page(page_text(made, NOON)).text
    assert "calibrated again" not in text
    assert "Nothing missing: 23 um rms held out" in text


def test_a_result_of_an_older_version_is_not_shown(made: RunFile) -> None:
    result = made_result(LEFT, RIGHT)
    del result["arms"][LEFT]["steps"]
    made.write_result("discover", json.dumps(result))
    assert "an older version looked for them; run anew: cellapp discover DIR" in Page(page_text(made, NOON)).text


def test_effects_of_time_are_drawn_as_they_were_evaluated(made: RunFile, monkeypatch: pytest.MonkeyPatch) -> None:
    step = EffectTerm(
        slug="base_step",
        names=("base_step_x",),
        values=np.array([2e-3]),
        standard_errors=np.array([1e-6]),
        units=("m",),
        law=Law("onset", {"onset_s": 30.5}),
    )
    model = CellModel.load(made.folder / CALIBRATION_FILE)
    arms = {**model.arms, LEFT: replace(model.arms[LEFT], effects=(step,))}
    replace(model, arms=arms).save(made.folder / CALIBRATION_FILE)
    readings = made.readings(LEFT)
    rows = readings.in_split("validate")
    held_out = readings.take(rows)
    geometry = replace(model.arms[LEFT], network=None).predict(held_out.q)
    after = held_out.time_s > 30.5
    assert 0 < after.sum() < len(after)
    drawn: list[Any] = []
    monkeypatch.setattr(figures, "error_figure", lambda key, configurations, errors, *more: drawn.append(errors) or "")
    page_text(made, NOON)
    shown = next(errors["effects"] for errors in drawn if "effects" in errors and len(errors["effects"]) == len(rows))
    plain = np.linalg.norm(held_out.p_M - geometry, axis=1) * 1e3
    assert shown[~after] == pytest.approx(plain[~after], abs=1e-6)
    assert np.abs(shown[after] - plain[after]).min() > 0.2


def test_unconverged_calibration_is_no_good_news(single: RunFile) -> None:
    result = results_of(single)["calibrate"]
    result["arms"]["only"].update(converged=False, message="gave up after 50 iterations")
    single.write_result("calibrate", json.dumps(result))
    text = Page(page_text(single, NOON)).text
    assert "The calibration did not converge (gave up after 50 iterations): do not use it." in text
    assert "is now known to" not in text


def test_uncalibrated_run_is_refused(tmp_path: Path) -> None:
    with RunFile.create(tmp_path / "run", profile_of("only")) as run:
        fill(run)
        with pytest.raises(InputError, match="run 'cellapp calibrate' first"):
            write_page(run)
        assert not (run.folder / "report.html").exists()


def test_lost_calibration_file_is_refused(single: RunFile) -> None:
    (single.folder / CALIBRATION_FILE).unlink()
    with pytest.raises(InputError, match=r"calibration\.json.*run 'cellapp calibrate' first"):
        write_page(single)


def test_page_that_cannot_be_written(single: RunFile) -> None:
    (single.folder / "report.html").mkdir()
    with pytest.raises(InputError, match=r"report\.html: cannot be written"):
        write_page(single)
    assert not list(single.folder.glob("*.part"))


def test_errors_stand_beside_their_intervals_and_the_tracker(full: RunFile, page: Page) -> None:
    calibrate = results_of(full)["calibrate"]
    tables = detailed_tables(calibrate)
    assert len(tables) == len(calibrate["arms"]) + 1
    cells = set(page.texts)
    for table in (*tables, *transform_tables(calibrate)):
        assert table.title in cells
        for row in table.rows:
            assert {cell for cell in (*table.columns, *row) if cell} <= cells
    summary = calibrate["pair"]["effects"]["cooperative_mm"]
    low, high = summary["mean_ci95"]
    shown = {row[0]: dict(zip(tables[-1].columns, row)) for row in tables[-1].rows}["effects"]
    assert shown["95 % of mean"] == f"{low:.4f} to {high:.4f}"
    assert shown["p95"] == f"{summary['p95']:.4f}"
    assert float(shown["rms / tracker"]) == pytest.approx(summary["rms"] / (FLOOR_MM * np.sqrt(2.0 / 3.0)), abs=0.051)


def test_tracker_column_is_empty_where_no_uncertainty_is_stated(single: RunFile) -> None:
    result = results_of(single)["calibrate"]
    result["arms"]["only"]["tracker_mm"] = None
    (table,) = detailed_tables(result)
    assert {row[-1] for row in table.rows} == {""}
    single.write_result("calibrate", json.dumps(result))
    assert "The readings state no uncertainty" in page_text(single, NOON)


def test_distance_noise_is_that_of_two_points() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(0.0, 0.02, (20_000, 3)), rng.normal(0.0, 0.05, (20_000, 3))
    lengths = [float(np.sqrt(np.mean(np.sum(noise**2, axis=1)))) for noise in (first, second)]
    apart = np.array([1000.0, 0.0, 0.0])
    errors = np.linalg.norm(apart + first - second, axis=1) - 1000.0
    assert distance_mm(*lengths) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.03)
    assert distance_mm(0.1, None) is None


def test_parameters_show_how_far_they_are_from_nominal(single: RunFile) -> None:
    text = page_text(single, NOON)
    identified = results_of(single)["calibrate"]["arms"]["only"]["identified"]
    nominal = nominal_arm(single.profile.arms["only"]).rows[1, 2]
    cells = [f"{value * 1e3:.5f}" for value in (nominal, identified["a2"]["value"])]
    delta = f"{(identified['a2']['value'] - nominal) * 1e3:+.5f}"
    expected = "".join(f'<td class="number">{cell}</td>' for cell in (*cells, delta))
    assert f'<tr><th scope="row">a2</th>{expected}' in text


def test_inter_base_transform_by_either_way(full: RunFile, page: Page) -> None:
    for method in results_of(full)["calibrate"]["pair"].values():
        for entry in method["identified"].values():
            factor = 1e3 if entry["unit"] == "m" else 180.0 / np.pi
            for key in ("value", "standard_error", "by_tracker"):
                assert f"{entry[key] * factor:.5f}" in page.texts


def test_provenance_names_its_files_by_their_hashes(full: RunFile, page: Page) -> None:
    profile = hashlib.sha256(profile_to_json(full.profile).encode()).hexdigest()
    calibration = hashlib.sha256((full.folder / CALIBRATION_FILE).read_bytes()).hexdigest()
    assert profile in page.texts
    assert calibration in page.texts
    assert len([text for text in page.texts if re.fullmatch(r"[0-9a-f]{64}", text)]) == 4


def test_other_readings_have_another_hash(single: RunFile, tmp_path: Path) -> None:
    def hash_on(run: RunFile) -> str:
        texts = Page(page_text(run, NOON)).texts
        return texts[texts.index("SHA-256 of the readings of arm only") + 1]

    before = hash_on(single)
    with RunFile.create(tmp_path / "other", single.profile) as other:
        fill(other, sigma_m=21e-6)
        calibrate_run(other)
        assert re.fullmatch(r"[0-9a-f]{64}", hash_on(other))
        assert hash_on(other) != before
    assert hash_on(single) == before


def test_arrows_have_a_round_scale() -> None:
    vectors = np.array([[3.0e-4, 0.0, 0.0]] * 9 + [[0.0, 9.0e-4, 0.0]])
    assert figures.scale_length_mm(vectors) == pytest.approx(0.2)
    assert figures.scale_length_mm(np.zeros((2, 3))) > 0.0
    assert "0.2 mm" in figures.vector_figure("a", np.eye(3), vectors[:3], 0.2)


def test_arms_in_space_are_drawn_wherever_they_hang() -> None:
    for base in ([3.0, 1.0, -1.0], [0.0, 0.0, 2.0], [-2.0, 0.0, 0.0]):
        chain = np.array([base, [base[0], base[1], base[2] + 1.0]])
        svg = figures.space_figure("a", [figures.ArmInCell(chain + 0.1, chain[0], chain)])
        (box,) = re.findall(r'viewBox="([^"]*)"', svg)
        numbers = [float(number) for number in box.split()]
        assert min(numbers[2:]) > 100.0
        assert "nan" not in svg.lower()


def test_perfect_model_can_be_drawn() -> None:
    nothing = {"nominal": np.zeros(3), "geometry": np.zeros(3)}
    assert "<path" in figures.error_figure("a", np.arange(3), nothing, None)
    assert "<path" in figures.residual_figure("a", nothing, None)
    assert "<path" in figures.target_figure("a", np.zeros(1), np.zeros(1), None)
    assert "<path" in figures.error_figure("a", np.array([7]), {"nominal": np.ones(1)}, 0.01)


def test_importing_the_page_loads_no_drawing_library() -> None:
    code = "import sys, cellapp.reporting.page; print({'matplotlib', 'jinja2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "set()"
