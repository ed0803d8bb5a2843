"""Paths: compute from poses with speeds a joint path along which the true SMR stays within a tolerance.

Mathematics only: ``cell.targets.path_file`` reads paths, ``cell.driving.following`` drives what is computed here.
"""
