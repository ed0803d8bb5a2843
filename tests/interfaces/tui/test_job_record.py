"""The record of a job: what events leave behind, without any screen."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cellapp.interfaces.tui.job_record import MOST_LINES, JobRecord

Q0, Q1 = (0.0, 0.1), (1.0, 1.1)


@given(steps=st.lists(st.integers(0, 40), max_size=20))
def test_newest_lines_are_each_heard_once(steps: list[int]) -> None:
    record, heard, written = JobRecord(), [], 0
    for count in steps:
        for _ in range(count):
            record.note(f"line {record.log_written}")
        heard += record.newest_lines(written)
        written = record.log_written
    assert [row.text for row in heard] == [f"line {number}" for number in range(sum(steps))]


def test_lines_that_are_kept_no_more_are_not_heard() -> None:
    record = JobRecord()
    for number in range(MOST_LINES + 10):
        record.note(f"line {number}")
    newest = record.newest_lines(0)
    assert len(newest) == MOST_LINES
    assert newest[0].text == "line 10"
