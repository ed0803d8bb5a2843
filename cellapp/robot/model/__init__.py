"""Models of the arms and of the cell. ``CellModel.load(path).predict(arm, q)`` needs only a calibration file."""

from cellapp.robot.model.model import ArmModel, CellModel, ResidualNetwork

__all__ = ["ArmModel", "CellModel", "ResidualNetwork"]
