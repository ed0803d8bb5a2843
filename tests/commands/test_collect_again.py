"""``collect --again``: what rests on old readings is out of date, the run stands as it did, bad lists are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.measured_again import replace_stop
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.confirm import MotionNotConfirmed, asked_once, confirmation, first_path_words, require_permission
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState, complaints_in
from cellapp.commands.show.overview import run_overview
from cellapp.commands.stages import CERTIFICATE_FILE, append_stage, basis_of, counted_basis, read_stages
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import CheckFailed
from cellapp.ground.profile import Profile
from cellapp.ground.results import VERIFY
from cellapp.interfaces.page.page import write_page
from drivers.findings import Finding
from tests.cell.run.small_runs import collected_run
from tests.sure import sure
from tests.twin import PROFILES
from tests.verbs import report_run


def measure_again(run: RunFile, stop: int) -> None:
    """As the session does it."""
    session = run.begin_session(str(stop + 1))
    rows = {
        name: Readings.one(q=np.full(len(arm.type.joints), float(stop)), p_M=np.ones(3), time_s=9.0)
        for name, arm in run.profile.arms.items()
    }
    replace_stop(run, stop, rows)
    run.end_session(session, "complete", "")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    return RunFile.open(collected_run(tmp_path / "run", "accurate enough"), write=True)


@pytest.mark.parametrize("basis_now", [basis_of, counted_basis])
def test_what_rests_on_readings_that_were_replaced_is_out_of_date(run: RunFile, basis_now: object) -> None:
    run.append_stage("calibrate", basis_of(run).model_dump_json(), "{}", None)
    assert read_stages(run, basis_now).out_of_date == {}  # type: ignore[arg-type]
    measure_again(run, 1)
    found = read_stages(run, basis_now).out_of_date  # type: ignore[arg-type]
    assert found == {"calibrate": "2 readings were measured again since"}


# -- What is out of date is said, and is an error where that is asked for ----------------------------------------------


def test_a_page_is_out_of_date_as_soon_as_the_run_holds_something_newer(
    finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cellapp.commands.next_step._missing_tests", lambda profile, results, driven: ())
    with RunFile.open(finished_copy, write=True) as run:
        assert RunState(run).complaints == []
        report_run(run, write_page)
        assert RunState(run).complaints == []
        verify = sure(read_results(run).verify)
        append_stage(run, VERIFY, verify.model_copy(update={"stopped": "by hand"}), basis_of(run))
        (complaint,) = RunState(run).complaints
        assert complaint.startswith(f"{REPORT_FILE} is out of date (the run has changed since)")
        overview = run_overview(RunState(run))
        assert overview.complaints == (complaint,)
        assert (overview.next_verb, overview.next_step) == ("report", f"cellapp report {finished_copy}")
    assert complaints_in(finished_copy) == [complaint]


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"<html>an older page</html>"], ids=["empty", "bytes", "older"])
def test_a_page_that_does_not_say_what_it_shows_is_out_of_date(finished_copy: Path, content: bytes) -> None:
    (finished_copy / REPORT_FILE).write_bytes(content)
    with RunFile.open(finished_copy) as run:
        (complaint,) = RunState(run).complaints
    assert "an older version wrote it" in complaint


def test_a_certificate_that_the_run_does_not_store_is_named(finished_copy: Path) -> None:
    (finished_copy / CERTIFICATE_FILE).write_text("{}")
    with RunFile.open(finished_copy) as run:
        assert RunState(run).complaints == [f"{CERTIFICATE_FILE} is not of this run: it stores no certificate"]


# -- Real arms move only after a green doctor and a person's permission; simulated ones never ask ----------------------


@pytest.fixture
def real() -> Profile:
    return load_profile(PROFILES / "ur10-ur5.yaml")


@pytest.fixture
def findings(monkeypatch: pytest.MonkeyPatch) -> list[Finding]:
    """What the doctor finds."""
    found: list[Finding] = [Finding("python", "ok", "Python 3.11"), Finding("arm left: tool", "warning", "unusual")]
    monkeypatch.setattr("cellapp.commands.confirm.examine", lambda profile: found)
    return found


@pytest.mark.parametrize("name", ["twin", "twin-wire", "twin-rtde", "twin-paper"])
def test_simulated_and_emulated_cells_never_ask(name: str, findings: list[Finding]) -> None:
    profile = load_profile(PROFILES / f"{name}.yaml")
    findings.append(Finding("arm left", "failed", "nobody looks"))
    assert not profile.moves_hardware
    assert confirmation(profile, None) is None
    assert confirmation(profile, lambda words: pytest.fail(words)) is None


def test_without_anybody_to_ask_nothing_moves(real: Profile, findings: list[Finding]) -> None:
    for refuse in (require_permission, confirmation):
        with pytest.raises(MotionNotConfirmed, match="--allow-motion") as caught:
            refuse(real, None)
        assert caught.value.exit_code == 2
    require_permission(real, lambda words: False)


def test_a_doctor_that_is_not_green_now_refuses(real: Profile, findings: list[Finding]) -> None:
    findings.append(Finding("arm left: link", "failed", "192.168.0.10 does not answer"))
    with pytest.raises(CheckFailed, match=r"arm left: link: 192\.168\.0\.10 does not answer") as caught:
        confirmation(real, lambda words: True)
    assert caught.value.exit_code == 1


def test_the_person_is_shown_the_first_path_and_decides(real: Profile, findings: list[Finding]) -> None:
    shown: list[str] = []
    answers = [False, True]

    def ask(words: str) -> bool:
        shown.append(words)
        return answers.pop(0)

    start = home_positions(real)
    confirm = sure(confirmation(real, asked_once(ask)))
    assert [confirm(start, start) for _ in range(4)] == [False, True, True, True]
    assert len(shown) == 2, "once allowed, nobody is asked again"


def test_the_first_path_in_words(real: Profile) -> None:
    start = home_positions(real)
    target = start["left"] + np.radians([10.0, 0.0, -45.0, 0.0, 0.0, 0.0])
    title, left, right, speed = first_path_words(real, start, {"left": target}).splitlines()
    assert title.startswith("First motion")
    assert "arm left: from (" in left
    assert "joint 3 rotates farthest, by 45.0 deg" in left
    assert "m in the cell" in left
    assert "arm right: stays at (" in right
    assert "20% of the profile's speed" in speed
