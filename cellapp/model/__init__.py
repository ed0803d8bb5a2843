"""The calibrated cell: ``CellModel.load(path).predict(arm, q)`` works in any process, without a run."""

from cellapp.model.model import ArmModel, CellModel
from cellapp.model.network import ResidualNetwork

__all__ = ["ArmModel", "CellModel", "ResidualNetwork"]
