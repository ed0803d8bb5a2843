"""Registration of several tracker stations in one frame, by reference nests that more than one of them measured."""

from cellapp.estimation.stations.tie import NestPoint, StationTie, TooFewNests, tie_stations

__all__ = ["NestPoint", "StationTie", "TooFewNests", "tie_stations"]
