"""Paths: compute from poses with speeds a joint path along which the true SMR stays within a tolerance.

Mathematics only: ``cell.targets.path`` reads paths, ``commands.compensate`` writes what is computed here.
"""
