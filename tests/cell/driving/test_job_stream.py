"""Lines of a job: every kind of event comes back exactly as it was."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.cell.driving.requests.job_stream import Answer, Ending, Heartbeat, Line, decode, encode, ending_of
from cellapp.ground.control import Aborted, Stopped
from cellapp.ground.errors import CheckFailed
from cellapp.ground.progress import CellLive, Detail, PointMissed, Progress, StopReport

pytestmark = pytest.mark.fast

DETAILS: tuple[type, ...] = get_args(Detail)
LINES: tuple[type, ...] = (Heartbeat, Answer, Ending)
st.register_type_strategy(float, st.floats(allow_nan=False))  # NaN equals nothing; see below


@pytest.mark.slow
@given(st.one_of(*map(st.from_type, DETAILS)), st.from_type(Progress))
def test_every_detail_comes_back_as_it_was(detail: Detail, event: Progress) -> None:
    told = Progress(event.job, event.done, event.total, event.note, event.eta_s, detail)
    assert decode(encode(told)) == told
    assert type(decode(encode(told)).detail) is type(detail)  # type: ignore[union-attr]  # it is a Progress


@given(st.one_of(*map(st.from_type, LINES)))
def test_every_other_line_comes_back_as_it_was(line: Line) -> None:
    assert decode(encode(line)) == line
    assert encode(line).count(b"\n") == 1


def test_no_field_has_the_name_of_the_type() -> None:
    for kind in (*DETAILS, *LINES, Progress, CellLive):
        assert "type" not in {field.name for field in fields(kind)}


def test_numbers_that_json_lacks_and_those_of_numpy_are_kept() -> None:
    report = StopReport(np.int64(4), "left", math.nan, math.inf, {"a": np.float64(0.1)})  # type: ignore[arg-type]
    told = decode(encode(Progress("collect", 4, 30, detail=report)))
    assert isinstance(told, Progress)
    assert isinstance(told.detail, StopReport)
    assert math.isnan(told.detail.residual_mm)
    assert (told.detail.stop, told.detail.standard_error_mm) == (4, math.inf)
    assert told.detail.parameter_errors == {"a": 0.1}


@pytest.mark.parametrize(
    "text", ["", "[]", "3", "{}", '{"type": "CellLive"}', '{"type": "PointMissed"}', '{"type": "nothing"}', "{", '"a"']
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        decode(text.encode())
    with pytest.raises(ValueError, match="no line of a job"):
        decode(json.dumps({"type": "PointMissed", **vars(PointMissed(1, "left", "covered"))}).encode())


def test_the_end_says_how_the_job_ended() -> None:
    assert ending_of(None) == Ending("done")
    assert ending_of(Stopped("on request")).how == "stopped"
    assert ending_of(Aborted("on request")).how == "aborted"
    assert ending_of(CheckFailed("too far")) == Ending("failed", "too far", 1)
    assert ending_of(KeyError("x")) == Ending("failed", "unexpected KeyError: 'x'", 3)
