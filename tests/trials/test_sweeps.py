"""What the trials of sweeps are made of: hidden effects that a cell takes, and how what was found is compared."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from cellapp.cell.driving.cell import build_plant
from cellapp.commands.trials.blind import with_hidden
from cellapp.estimation.motion.records import ClockFit, ClockSegment
from drivers.plant.sweep import recorder_of
from tests.trials.sweep_effects import clock_errors, hidden_effects, lines_against
from tests.trials.sweeps import SHOWN_BY_BOTH, app
from tests.trials.sweeps import hidden_effects as drawn_effects
from tests.twin import whole_twin


@pytest.mark.fast
def test_cells_take_the_hidden_effects_and_each_seed_has_others():
    first, second = hidden_effects(1), hidden_effects(2)
    assert first != second
    plant = build_plant(with_hidden(whole_twin(), first, 1))
    assert set(plant.names) == {"left", "right"}
    for laws in ("other", "same"):
        drawn = drawn_effects(3, laws)
        assert {slug for its in drawn.values() for slug in its} <= set(SHOWN_BY_BOTH)
        build_plant(with_hidden(whole_twin(), drawn, 3))
    assert CliRunner().invoke(app, ["--laws", "no-such-law"]).exit_code == 2


@pytest.mark.fast
def test_clocks_are_compared_where_their_offset_is_stated():
    recorder = recorder_of(build_plant(with_hidden(whole_twin(), {}, 1)))
    rate, middle_s = 1e-6 * recorder.rate_ppm, 1200.0
    true_s = middle_s - (middle_s - recorder.offset_s) / (1.0 + rate)  # when the tracker's clock shows the middle
    interval = (true_s - 1e-4, true_s + 1e-4)
    clock = ClockFit(
        offset_s=true_s + 5e-5,
        offset_standard_error_s=5e-5,
        offset_interval_s=interval,
        rate_ppm=1e6 * rate + 1.0,
        rate_standard_error_ppm=0.1,
        rate_interval_ppm=(1e6 * rate + 0.8, 1e6 * rate + 1.2),
        middle_s=middle_s,
        segments=(ClockSegment(true_s, 5e-5, interval, 0.0, 2.0 * middle_s),),
        steps_of_joints=(),
        steps_of_points=(),
        regular_joints=False,
        regular_points=False,
        correlation=1.0,
    )
    delay_ms, rate_ppm, delay_holds, rate_holds = clock_errors(clock, recorder)
    assert delay_ms == pytest.approx(0.05, abs=1e-6)
    assert rate_ppm == pytest.approx(1.0, abs=1e-3)
    assert delay_holds
    assert not rate_holds


@pytest.mark.fast
def test_lines_are_compared_by_amplitude_and_phase():
    hidden = {"line": [20e-6, 30e-6, 40e-6], "line_phase": [0.3, 2.0, 5.0]}
    found = {"sin40q1": 22e-6 * np.cos(0.4), "cos40q1": 22e-6 * np.sin(0.4), "sin40q2": 30e-6 * np.cos(2.0)}
    found["cos40q2"] = 30e-6 * np.sin(2.0)
    first, second, third = lines_against(found, hidden)
    assert first == pytest.approx((0.1, 0.1))
    assert second == pytest.approx((0.0, 0.0), abs=1e-9)
    assert third[0] == -1.0
    assert np.isnan(third[1])
