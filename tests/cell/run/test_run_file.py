"""The run file: what was committed is there, whatever happens; what is no run file is refused and left alone."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.run_arms import BY_PERSON, note_at_rest, note_halt, unseen_arms
from cellapp.cell.run.sqlite_file import ReferenceRow
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Halt
from tests.cell.run.small_runs import SPOILED, files, older_reading_table, two_arms
from tests.sure import sure
from tests.twin import small_twin
from tests.waiting import WAIT_S, within


@pytest.fixture
def profile() -> Profile:
    return two_arms()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "runs" / "first"


def reading(seed: int, joints: int = 2) -> Readings:
    rng = np.random.default_rng(seed)
    return Readings.one(q=rng.normal(size=joints), p_M=rng.normal(size=3), time_s=float(seed))


def test_a_run_keeps_its_profile_and_is_one_file_when_closed(profile: Profile, folder: Path) -> None:
    with RunFile.create(folder, profile) as run:
        run.add_stop(0, {"left": reading(0), "right": reading(1, 3)})
    assert list(files(folder)) == ["run.sqlite"]
    with RunFile.open(folder) as run:
        assert run.profile == profile
        assert run.arms() == ["left", "right"]
        assert run.stops_done() == {0}
    assert list(files(folder)) == ["run.sqlite"]


def test_reading_does_not_change_the_file(profile: Profile, folder: Path) -> None:
    RunFile.create(folder, profile).close()
    before = files(folder)
    with RunFile.open(folder) as run:
        assert len(run.readings("left")) == 0
        assert run.readings("left").q.shape == (0, 2)
        assert run.readings("right").approach.shape == (0, 3)
        assert run.read_plan() == {}
        assert run.events() == []
        assert run.read_document("calibration") is None
        for write in (
            lambda: run.add_stop(0, {"left": reading(0)}),
            lambda: run.log("info", "no"),
            lambda: run.write_plan({"left": np.zeros((1, 2))}),
            lambda: run.write_document("a", "b"),
            lambda: run.assign_splits("left", []),
        ):
            with pytest.raises(InputError, match="open for reading only"):
                write()
    assert files(folder) == before


def test_a_stop_is_stored_for_all_arms_or_for_none(profile: Profile, folder: Path) -> None:
    with RunFile.create(folder, profile) as run:
        run.add_stop(0, {"right": reading(0, 3)})
        with pytest.raises(InputError, match="a reading of arm right at one of these stops \\(0\\) is stored already"):
            run.add_stop(0, {"left": reading(1), "right": reading(2, 3)})
        assert run.arms() == ["right"]
        assert run.readings("right").time_s[0] == 0.0


@pytest.mark.parametrize(
    ("arm", "wrong", "says"),
    [
        ("middle", {}, "arm 'middle' not found; arms are left, right"),
        ("left", {"q": np.zeros(3)}, "3 joint positions for the 2 joints of arm left"),
        ("left", {"q": np.array([0.0, np.nan])}, "not finite"),
        ("left", {"p_M": np.array([0.0, np.inf, 0.0])}, "not finite"),
        ("left", {"p_M": np.zeros(2)}, "expected p_M"),
        ("left", {"split": "test"}, "'test' is not a split"),
        ("left", {"approach": np.array([2, 0], np.int8)}, r"is not -1, 0 \(unknown\) or 1"),
    ],
)
def test_values_that_are_no_reading(profile: Profile, folder: Path, arm: str, wrong: dict[str, Any], says: str) -> None:
    with RunFile.create(folder, profile) as run:
        with pytest.raises((InputError, ValueError), match=says):
            run.add_stop(0, {arm: Readings.one(**{"q": np.zeros(2), "p_M": np.zeros(3), **wrong})})
        assert run.stops_done() == set()


def test_a_plan_does_not_change_under_measured_stops(profile: Profile, folder: Path) -> None:
    plan = {"left": np.arange(8.0).reshape(4, 2)}
    with RunFile.create(folder, profile) as run:
        run.write_plan(plan)
        run.add_stop(1, {"left": reading(0)})
        longer = {"left": np.vstack([plan["left"], [[9.0, 9.0]]])}
        run.write_plan(longer)
        other = {"left": longer["left"] + 1e-12}
        with pytest.raises(InputError, match="stop 1 is measured already"):
            run.write_plan(other)
        np.testing.assert_array_equal(run.read_plan()["left"], longer["left"])


@pytest.mark.parametrize(
    "plan",
    [
        {"left": np.zeros((2, 3))},
        {"left": np.zeros(2)},
        {"left": np.full((2, 2), np.nan)},
        {"left": np.zeros((2, 2)), "right": np.zeros((3, 3))},
    ],
)
def test_a_plan_that_does_not_fit(profile: Profile, folder: Path, plan: dict[str, np.ndarray]) -> None:
    with RunFile.create(folder, profile) as run:
        with pytest.raises(ValueError, match=r"stops|expected finite joint positions"):
            run.write_plan(plan)
        assert run.read_plan() == {}


def test_wrong_splits(profile: Profile, folder: Path) -> None:
    with RunFile.create(folder, profile) as run:
        run.add_stop(0, {"left": reading(0)})
        with pytest.raises(ValueError, match="'test' is not a split"):
            run.assign_splits("left", ["test"])
        with pytest.raises(ValueError, match="2 splits for the 1 reading"):
            run.assign_splits("left", ["train", "train"])
        assert run.readings("left").split is None


def test_a_full_disk_is_a_sentence_and_costs_only_that_stop(profile: Profile, folder: Path) -> None:
    with RunFile.create(folder, profile) as run:
        run.add_stop(0, {"left": reading(0)})
        run._connection.execute("PRAGMA max_page_count=1").fetchall()  # as many as there are
        with pytest.raises(InputError, match="full; check that the disk"):
            run.write_document("big", "x" * 100_000)
        run._connection.execute("PRAGMA max_page_count=1000000").fetchall()
        run.add_stop(1, {"left": reading(1)})
    with RunFile.open(folder) as run:
        assert run.stops_done() == {0, 1}
        assert run.read_document("big") is None


# -- folders that hold something else ---------------------------------------------------------------------------------


def test_a_folder_with_a_run_is_not_used_again(profile: Profile, folder: Path) -> None:
    RunFile.create(folder, profile).close()
    before = files(folder)
    with pytest.raises(InputError, match="already holds a run") as caught:
        RunFile.create(folder, profile)
    assert str(folder) in str(caught.value)
    assert "choose a new folder" in str(caught.value)
    assert files(folder) == before


def test_a_file_is_no_folder(profile: Profile, tmp_path: Path) -> None:
    path = tmp_path / "run"
    path.write_text("x")
    with pytest.raises(InputError, match="is a file"):
        RunFile.create(path, profile)
    with pytest.raises(InputError, match=f"{path}"):
        RunFile.create(path / "below", profile)
    with pytest.raises(InputError, match="is not a folder"):
        RunFile.open(path)
    assert path.read_text() == "x"


def test_an_empty_folder_and_one_of_a_killed_creation_are_used(profile: Profile, folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "run.sqlite.new").write_bytes(b"half")
    with RunFile.create(folder, profile) as run:
        run.log("info", "made")
    assert list(files(folder)) == ["run.sqlite"]
    (folder / "below" / "run.sqlite.new").mkdir(parents=True)
    with pytest.raises(InputError, match="is not empty"):
        RunFile.create(folder / "below", profile)


def test_a_creation_that_fails_leaves_nothing(profile: Profile, tmp_path: Path) -> None:
    def fill(run: RunFile) -> None:
        run.add_stop(0, {"left": reading(0)})
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        RunFile.create(tmp_path / "a" / "b", profile, fill)
    assert list(tmp_path.iterdir()) == []
    kept = tmp_path / "kept"
    kept.mkdir()
    with pytest.raises(KeyboardInterrupt):
        RunFile.create(kept, profile, fill)
    assert list(tmp_path.rglob("*")) == [kept]


# -- files that cannot be opened --------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", [False, True])
@pytest.mark.parametrize(("spoil", "says"), SPOILED)
def test_a_file_that_is_no_run_is_refused_and_left_alone(
    profile: Profile, folder: Path, spoil: Callable[[Path], None], says: str, write: bool
) -> None:
    with RunFile.create(folder, profile) as run:
        for stop in range(200):
            run.add_stop(stop, {"left": reading(stop)}) if stop < 3 else run.log("info", "x" * 200)
    path = folder / "run.sqlite"
    spoil(path)
    before = files(folder)
    with pytest.raises(InputError, match=says) as caught:
        RunFile.open(folder, write=write)
    assert str(path) in str(caught.value)
    assert files(folder) == before


def test_a_missing_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run folder not found"):
        RunFile.open(tmp_path / "none")
    with pytest.raises(InputError, match=r"holds no run \(run.sqlite is missing\)"):
        RunFile.open(tmp_path, write=True)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "run.sqlite").mkdir()
    with pytest.raises(InputError, match=r"run\.sqlite: .*; check the path and its permissions"):
        RunFile.open(tmp_path)


# -- kill -------------------------------------------------------------------------------------------------------------

WRITER = """
import sys
from pathlib import Path
import numpy as np
from cellapp.cell.run import RunFile
from cellapp.estimation.readings import Readings

with RunFile.open(Path(sys.argv[1]), write=True) as run:
    stop = max(run.stops_done(), default=-1)
    while True:
        stop += 1
        at = {"p_M": np.full(3, stop / 3.0), "time_s": float(stop)}
        rows = {
            name: Readings.one(q=np.full(len(arm.type.joints), stop + 0.5), **at)
            for name, arm in run.profile.arms.items()
        }
        run.add_stop(stop, rows)
        print(stop, flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_nothing_committed_is_lost_by_a_kill_at_any_moment(profile: Profile, folder: Path) -> None:
    RunFile.create(folder, profile).close()
    rng = random.Random(20)
    promised: set[int] = set()
    for _ in range(5):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[3],
        )
        assert writer.stdout is not None
        timer = threading.Timer(3 * WAIT_S, writer.kill)
        timer.start()
        # some stops for sure, then a moment that falls anywhere within the transactions that follow
        for _ in range(rng.randint(1, 30)):
            promised.add(int(within(writer.stdout.readline, "the next stop")))
        threading.Event().wait(rng.uniform(0.0, 0.02))
        writer.send_signal(signal.SIGKILL)
        promised.update(int(line) for line in writer.stdout.read().split("\n")[:-1])
        assert writer.wait(WAIT_S) == -signal.SIGKILL
        timer.cancel()
        writer.stdout.close()

        with RunFile.open(folder) as run:
            stored = run.stops_done()
            assert promised <= stored
            assert len(stored - promised) <= 5  # at most one a kill was committed and not yet printed
            assert stored == set(range(len(stored)))
            for name, joints in (("left", 2), ("right", 3)):
                rows = run.readings(name)
                np.testing.assert_array_equal(rows.configuration, sorted(stored))
                np.testing.assert_array_equal(rows.q, np.repeat(rows.configuration[:, None] + 0.5, joints, axis=1))
                np.testing.assert_array_equal(rows.p_M[:, 2], rows.configuration / 3.0)
    with RunFile.open(folder, write=True) as run:
        assert run.stops_done() == stored
    assert list(files(folder)) == ["run.sqlite"]
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def test_a_file_of_the_first_schema_is_read_and_when_written_to_gets_what_it_lacks(
    profile: Profile, folder: Path
) -> None:
    with RunFile.create(folder, profile) as run:
        run.add_stop(1, {"left": reading(1)})
    with contextlib.closing(sqlite3.connect(folder / "run.sqlite")) as connection:
        older_reading_table(connection, 1)
        for table in ("stage", "session", "request", "outcome", "reference", "recording", "stream"):
            connection.execute(f"DROP TABLE {table}")
        connection.execute("UPDATE meta SET value = '1' WHERE key = 'version'")
        connection.execute("PRAGMA user_version=1")
        connection.commit()
    before = (folder / "run.sqlite").read_bytes()
    with RunFile.open(folder) as run:
        assert run.readings("left").step is None
    assert (folder / "run.sqlite").read_bytes() == before
    with RunFile.open(folder, write=True) as run:
        run.add_stop(2, {"left": replace(reading(2), step=np.array([[0.1, -0.2]]), dwell_s=np.array([1.5]))})
    with RunFile.open(folder) as run:
        left = run.readings("left")
        np.testing.assert_array_equal(sure(left.step), [[np.nan, np.nan], [0.1, -0.2]])
        np.testing.assert_array_equal(sure(left.dwell_s), [np.nan, 1.5])


# -- Arms that were not seen at rest -----------------------------------------------------------------------------------


LOST = Halt("not seen at rest", "arm left: link lost")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    return RunFile.create(tmp_path / "run", small_twin(4))


def test_a_fault_survives_a_restart_and_other_arms(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    note_halt(run, "right", Halt("not seen at rest", "arm right: link lost"))
    note_halt(run, "right", Halt("at rest", "seen"))
    note_halt(run, "left", Halt("braking", "commanded"))
    run.close()
    with RunFile.open(run.folder) as again:
        assert {name: arm.reason for name, arm in unseen_arms(again).items()} == {"left": "arm left: link lost"}
        levels = [(event.level, event.text.split(",")[0]) for event in again.events()]
        assert ("error", "arm left: NOT SEEN AT REST") in levels
        first = overview_sentences(run_overview(RunState(again)))[0]
    assert first.startswith("arm left: NOT SEEN AT REST since 2")
    assert f"cellapp job confirm-rest {run.folder} left" in first


def test_the_first_time_is_kept(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    since = unseen_arms(run)["left"].since
    note_halt(run, "left", Halt("not seen at rest", "again"))
    assert unseen_arms(run)["left"].since == since


def test_a_person_settles_it_once(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    assert note_at_rest(run, "left", BY_PERSON)
    assert not note_at_rest(run, "left", BY_PERSON)
    assert unseen_arms(run) == {}
    assert run.events()[-1].text.startswith("arm left: at rest: a person has seen it at rest")
    with pytest.raises(InputError, match="arm 'middle' not found; arms are left, right"):
        note_at_rest(run, "middle", BY_PERSON)


def test_a_damaged_record_makes_no_arm_safe(run: RunFile) -> None:
    run.write_document("not seen at rest: left", "{}")
    assert "left" in unseen_arms(run)


def test_a_run_that_cannot_be_written_keeps_nothing_from_braking(run: RunFile) -> None:
    run.close()
    note_halt(run, "left", LOST)


# -- A run file under random sequences of what may happen to it --------------------------------------------------------


PROFILE = two_arms()
JOINTS = {"left": 2, "right": 3}
STOPS = 6
MANY_PAGES = 1_000_000
LONG_TEXT = "x" * 20_000
"""More than one page of the file, so that a full disk is noticed."""


def reading_of_machine(arm: str, seed: int) -> Readings:
    rng = np.random.default_rng(seed)
    return Readings.one(q=rng.normal(size=JOINTS[arm]), p_M=rng.normal(size=3), time_s=float(seed))


@dataclass
class Model:
    """What was committed: seeds of readings, reasons, and the rest as plain values."""

    readings: dict[tuple[int, str], int] = field(default_factory=dict)
    outcomes: dict[tuple[int, str], str] = field(default_factory=dict)
    sessions: list[list[str | None]] = field(default_factory=list)
    requests: list[tuple[int, str]] = field(default_factory=list)
    references: list[tuple[str, int]] = field(default_factory=list)
    stages: list[str] = field(default_factory=list)

    def check(self, run: RunFile) -> None:
        """Compare everything with a run file."""
        for arm in JOINTS:
            stored = run.readings(arm)
            expected = {stop: seed for (stop, name), seed in self.readings.items() if name == arm}
            assert stored.configuration.tolist() == sorted(expected)
            for row, stop in enumerate(sorted(expected)):
                assert stored.p_M[row].tobytes() == reading_of_machine(arm, expected[stop]).p_M.tobytes()
        assert run.stops_done() == {stop for stop, _ in self.readings}
        missing = {key: why for key, why in self.outcomes.items() if key not in self.readings}
        assert {(one.stop, one.arm): one.reason for one in run.outcomes()} == missing
        sessions = run.sessions()
        assert [one.outcome for one in sessions] == [outcome for (outcome,) in self.sessions]
        assert [(one.number, request.kind) for one in sessions for request in one.requests] == sorted(
            self.requests, key=lambda request: request[0]
        )
        assert [(row.name, row.stops_done) for row in run.references()] == self.references
        assert [row.text for row in run.stage_rows()] == self.stages


class RunMachine(RuleBasedStateMachine):
    """One run, written by one program that may die, and read by others."""

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(tempfile.mkdtemp())
        self.copies = 0
        self.model = Model()
        self.run = RunFile.create(self.root / "run", PROFILE)
        self.seed = 0

    def teardown(self) -> None:
        self.run.close()
        shutil.rmtree(self.root)

    # -- writing -------------------------------------------------------------------------------------------------------

    @rule(stop=st.integers(0, STOPS - 1), missed=st.sampled_from(["", "left", "right", "both"]))
    def add_stop(self, stop: int, missed: str) -> None:
        self.seed += 1
        rows = {arm: reading_of_machine(arm, self.seed) for arm in JOINTS if missed not in (arm, "both")}
        outcomes = [Outcome(stop, arm, "not measured", f"beam {self.seed}") for arm in JOINTS if arm not in rows]
        if any((stop, arm) in self.model.readings for arm in rows):
            with pytest.raises(InputError, match="stored already"):
                self.run.add_stop(stop, rows, outcomes)
            return
        self.run.add_stop(stop, rows, outcomes)
        self.model.readings |= {(stop, arm): self.seed for arm in rows}
        self.model.outcomes |= {(one.stop, one.arm): one.reason for one in outcomes}

    @rule()
    def begin_session(self) -> None:
        assert self.run.begin_session() == len(self.model.sessions) + 1
        self.model.sessions.append([None])

    @precondition(lambda self: self.model.sessions)
    @rule(kind=st.sampled_from(["pause", "resume", "stop"]))
    def record_request(self, kind: str) -> None:
        number = len(self.model.sessions)
        self.run.record_request(number, kind, "by a person")
        self.model.requests.append((number, kind))

    @precondition(lambda self: self.model.sessions)
    @rule(outcome=st.sampled_from(["complete", "stopped", "failed"]))
    def end_session(self, outcome: str) -> None:
        self.run.end_session(len(self.model.sessions), outcome, "")  # type: ignore[arg-type]
        self.model.sessions[-1][0] = outcome

    @rule(name=st.sampled_from(["arm left", "nest a"]))
    def add_reference(self, name: str) -> None:
        self.run.add_reference(ReferenceRow(name, self.seed, 0.0, np.arange(3.0), 1))
        self.model.references.append((name, self.seed))

    @rule()
    def append_stage(self) -> None:
        self.seed += 1
        self.run.append_stage("calibrate", None, f"result {self.seed}", None)
        self.model.stages.append(f"result {self.seed}")

    # -- trouble -------------------------------------------------------------------------------------------------------

    @rule()
    def reopen(self) -> None:
        self.run.close()
        self.run = RunFile.open(self.root / self.run.folder.name, write=True)

    @rule()
    def die_and_continue(self) -> None:
        """Only the files as they are at this moment survive."""
        self._continue_with(self._copied())

    @rule()
    def die_while_writing(self) -> None:
        """A death in the middle of a transaction leaves nothing of it."""
        with contextlib.suppress(KeyboardInterrupt), self.run.change() as connection:
            connection.execute("INSERT INTO event (written, level, text) VALUES ('', 'info', ?)", (LONG_TEXT,))
            connection.execute("DELETE FROM reading")
            copy = self._copied()
            raise KeyboardInterrupt
        self._continue_with(copy)

    @rule()
    def write_to_a_full_disk(self) -> None:
        connection = self.run._connection
        connection.execute("PRAGMA max_page_count=1").fetchall()  # as many as there are
        try:
            self.run.append_stage("calibrate", None, LONG_TEXT, None)
        except InputError as error:
            assert "disk" in str(error)  # noqa: PT017 - free pages of the file may still take it
        else:
            self.model.stages.append(LONG_TEXT)
        finally:
            connection.execute(f"PRAGMA max_page_count={MANY_PAGES}").fetchall()

    @rule()
    def read_only(self) -> None:
        with RunFile.open(self.run.folder) as reader:
            self.model.check(reader)
            with pytest.raises(InputError, match="reading only"):
                reader.add_stop(STOPS, {"left": reading_of_machine("left", 1)})
            with pytest.raises(InputError, match="reading only"):
                reader.begin_session()

    @invariant()
    def holds_what_was_committed(self) -> None:
        self.model.check(self.run)

    def _copied(self) -> Path:
        self.copies += 1
        copy = self.root / f"copy{self.copies}"
        copy.mkdir()
        for suffix in ("", "-wal"):
            source = Path(f"{self.run.path}{suffix}")
            if source.exists():
                shutil.copyfile(source, copy / source.name)
        return copy

    def _continue_with(self, folder: Path) -> None:
        self.run.close()
        self.run = RunFile.open(folder, write=True)


RunMachine.TestCase.settings = settings(max_examples=25, stateful_step_count=20, deadline=None, derandomize=True)
TestRunMachine = RunMachine.TestCase
