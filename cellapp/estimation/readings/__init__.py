"""Readings of one arm as arrays, and the names and units of their columns."""

from cellapp.estimation.readings.columns import SPLITS
from cellapp.estimation.readings.readings import (
    Readings,
    coordinate_uncertainty,
    covariances_of,
    joined,
    stated_uncertainty,
)

__all__ = ["SPLITS", "Readings", "coordinate_uncertainty", "covariances_of", "joined", "stated_uncertainty"]
