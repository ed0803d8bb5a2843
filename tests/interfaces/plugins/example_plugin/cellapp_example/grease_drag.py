"""The effect ``grease_drag``: stiff grease holds a joint back while it turns. It shows in recordings of motion."""

import numpy as np

from cellapp.robot.effects import Linear, Tuned, own_law

DRAG = Linear("rad", most=2e-3, least=0.0)
KNEE = Tuned("rad/s", 0.05, 0.2, 0.8, words="from {} rad/s on")


@own_law("drag of stiff grease", size="20 to 200 µrad", drag=DRAG, knee=KNEE)
def grease_drag(qd, drag, knee):
    """Stiff grease at {place} holds the joint back while it turns, hardly more at high speed."""
    return -drag * np.tanh(qd / knee)
