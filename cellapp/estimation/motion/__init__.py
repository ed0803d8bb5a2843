"""Calibration in motion: recordings of joints and of points, each with a clock of its own. Arrays in, arrays out.

``streams`` has what is recorded, ``identify`` the fit, ``effects`` the search for effects. Nothing is loaded from here:
collecting needs the streams alone.
"""
