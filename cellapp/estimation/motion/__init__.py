"""Calibration in motion: recordings of joints and of points, each with its own clock. Arrays in, arrays out.

``streams`` has the recorded data, ``identify`` the fit, ``effects`` the search for effects. This package imports none
of them: collecting needs the streams alone.
"""
