"""Instruments whose calibration was not in force when they were used, and data that nobody gave."""

from __future__ import annotations

from datetime import date

import pytest

from cellapp.commands.certificate.statement import used_instruments
from cellapp.ground.profile.sections import Instrument
from tests.estimation.uncertainty.cases import profile_with

pytestmark = pytest.mark.fast

MEASURED = ("2026-03-02T23:59:59.000+00:00", "2026-03-04T08:00:00.000+00:00")


@pytest.mark.parametrize(
    ("calibrated", "due", "note"),
    [
        (date(2025, 3, 4), date(2026, 3, 4), ""),
        (date(2025, 3, 4), date(2026, 3, 3), "its calibration was overdue: due on 2026-03-03, used on 2026-03-04"),
        (date(2026, 3, 2), None, ""),
        (date(2026, 3, 3), None, "it was calibrated on 2026-03-03, after it was used on 2026-03-02"),
        (None, None, ""),
    ],
    ids=["last day", "overdue", "first day", "later", "not given"],
)
def test_a_calibration_must_be_in_force_on_every_day(calibrated: date | None, due: date | None, note: str) -> None:
    profile = profile_with({}, {"tracker": Instrument(serial="7", calibrated=calibrated, due=due)})
    tracker = used_instruments(profile, MEASURED)[0]
    assert (tracker.role, tracker.note) == ("laser tracker", note)
    assert tracker.due == ("" if due is None else due.isoformat())


def test_without_a_time_of_measuring_nothing_is_overdue() -> None:
    profile = profile_with({}, {"tracker": Instrument(due=date(2000, 1, 1))})
    assert used_instruments(profile, ())[0].note == ""


def test_every_smr_and_further_instrument_is_listed() -> None:
    thermometer = Instrument(model="T", serial="9")
    profile = profile_with({}, {"instruments": {"thermometer": thermometer}, "smr": {"left": Instrument(serial="L")}})
    found = {one.role: one.serial for one in used_instruments(profile, MEASURED)}
    assert found == {"laser tracker": "SIM-1", "SMR of arm left": "L", "SMR of arm right": "", "thermometer": "9"}
