"""The effect ``hose_pull``: a hose package that becomes taut pulls joints back."""

import numpy as np

from cellapp.robot.effects import Linear, Tuned, own_law

PULL = Linear("rad/rad", most=1e-2, least=0.0)
SLACK = Tuned("rad", 0.6, 1.0, 1.6, words="taut beyond {} deg", factor=180.0 / np.pi)


@own_law("pull of the hose package", size="0.1 to 0.5 mrad for each radian beyond", pull=PULL, slack=SLACK)
def hose_pull(q, pull, slack):
    """The hose package at {place} is too short: it becomes taut and pulls the joint back."""
    return -pull * np.sign(q) * np.maximum(np.abs(q) - slack, 0.0)
