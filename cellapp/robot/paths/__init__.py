"""Paths: a list of poses with speeds becomes a joint path along which the true SMR stays within a tolerance.

Mathematics only: ``cell.targets.path_file`` reads paths, ``cell.driving.following`` drives what is computed here.
"""
