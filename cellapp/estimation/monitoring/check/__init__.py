"""Mathematics of the ten-minute check: predictions of a calibration, choice of stops, a sequential test."""

from cellapp.estimation.monitoring.check.belief import (
    LENGTH_M,
    TURN_RAD,
    CheckBelief,
    SequentialState,
    check_belief,
)
from cellapp.estimation.monitoring.check.sequential import SequentialTest, choose_stops, design_of

__all__ = [
    "LENGTH_M",
    "TURN_RAD",
    "CheckBelief",
    "SequentialState",
    "SequentialTest",
    "check_belief",
    "choose_stops",
    "design_of",
]
