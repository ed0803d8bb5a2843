"""Paths: a list of poses with speeds becomes a joint path along which the true SMR stays within a tolerance.

Pure mathematics on arrays, but for the reading of path files. ``following`` drives what is computed here.
"""
