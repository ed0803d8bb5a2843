"""Paths: a list of poses with speeds becomes a joint path along which the true SMR stays within a tolerance.

Mathematics only: ``compensation.path_file`` reads paths, ``compensation.following`` drives what is computed here.
"""
