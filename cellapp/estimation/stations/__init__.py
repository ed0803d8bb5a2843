"""Several stations of a tracker in one frame: reference nests that more than one of them measured tie them."""

from cellapp.estimation.stations.tie import NestPoint, StationTie, TooFewNests, tie_stations

__all__ = ["NestPoint", "StationTie", "TooFewNests", "tie_stations"]
