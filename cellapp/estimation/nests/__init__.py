"""Several SMRs on one flange, measured one after another at a stop; together they give the flange's orientation."""

from cellapp.estimation.nests.by_stop import NestStops, by_stop, poses
from cellapp.estimation.nests.shape import NestShape, fit_shape
from cellapp.estimation.nests.stop_groups import StopGroups

__all__ = ["NestShape", "NestStops", "StopGroups", "by_stop", "fit_shape", "poses"]
