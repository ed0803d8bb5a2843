"""Calibration of a dual-arm robot cell with a laser tracker.

Arrays carry n configurations at once, float64, in SI units. ``T_M_B`` maps coordinates of frame B into frame M:
M is the tracker, B a robot base, F a flange, S the centre of the retroreflector (SMR), C the cell floor.
"""

__version__ = "0.1.0"
