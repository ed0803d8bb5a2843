"""The run file under random sequences of writes, failures and deaths of the program: what was committed is there."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.sqlite_file import ReferenceRow
from cellapp.estimation.readings import Reading
from cellapp.ground.errors import InputError
from tests.cell.run.two_arm_cell import two_arms

PROFILE = two_arms()
JOINTS = {"left": 2, "right": 3}
STOPS = 6
MANY_PAGES = 1_000_000
LONG_TEXT = "x" * 20_000
"""More than one page of the file, so that a full disk is noticed."""


def reading(arm: str, seed: int) -> Reading:
    rng = np.random.default_rng(seed)
    return Reading(q=rng.normal(size=JOINTS[arm]), p_M=rng.normal(size=3), time_s=float(seed))


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
                assert stored.p_M[row].tobytes() == reading(arm, expected[stop]).p_M.tobytes()
        assert run.stops_done() == {stop for stop, _ in self.readings}
        missing = {key: why for key, why in self.outcomes.items() if key not in self.readings}
        assert {(one.stop, one.arm): one.reason for one in run.outcomes()} == missing
        sessions = run.sessions()
        assert [one.outcome for one in sessions] == [outcome for (outcome,) in self.sessions]
        assert [(one.number, kind) for one in sessions for _, kind, _ in one.requests] == sorted(
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
        rows = {arm: reading(arm, self.seed) for arm in JOINTS if missed not in (arm, "both")}
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
                reader.add_stop(STOPS, {"left": reading("left", 1)})
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
