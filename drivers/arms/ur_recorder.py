"""Recorder of every state that a UR controller sends, over a separate RTDE connection; pulses of a digital output.

The RTDE client that moves the arm keeps only the newest of several states that arrive together. Here a thread keeps
all. Lost states are counted by the controller's own clock. The connection claims only the digital output.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import LinkLost
from drivers.arms.recording import JointRecord, counts_so_far
from drivers.arms.ur_links import RTDE_PORT, Connection, cause
from drivers.arms.ur_rtde_reader import Outputs
from drivers.patience import Patience

_OPENS_WITHIN_S = 3.0
_SILENT_S = 2.0
"""A controller that sends nothing for this long has ended the recording."""
_ENDS_WITHIN_S = 1.0
_PULSE_S = 0.02
_REQUIRED = ("timestamp", "actual_q", "actual_qd")
_OPTIONAL = ("joint_temperatures", "actual_digital_output_bits")
_INPUTS = ("standard_digital_output_mask", "standard_digital_output")

Values = dict[str, tuple[float, ...]]


class UrRecorder:
    """Recorder from construction, which waits for the first state, until ``end``."""

    def __init__(
        self, name: str, host: str, period_s: float, trigger_output: int | None = None, *, port: int = RTDE_PORT
    ) -> None:
        """Connect. Raises ``LinkLost``."""
        self._name, self._period_s, self._output = name, period_s, trigger_output
        self._states: list[Values] = []
        self._problem: LinkLost | None = None
        self._ending = threading.Event()
        self._first = threading.Event()
        patience = Patience(_OPENS_WITHIN_S)
        try:
            self._link = Connection.to(host, port, patience)
            try:
                self._outputs = Outputs(self._link, patience, _REQUIRED, _OPTIONAL, 1.0 / period_s)
                self._pulses = self._outputs.claim(_INPUTS) if trigger_output is not None else None
            except BaseException:
                self._link.close()
                raise
        except LinkLost as error:
            raise LinkLost(f"arm {name}: its joints are not recorded: {cause(error)}") from error
        self._thread = threading.Thread(target=self._record, name=f"recorder of {name}", daemon=True)
        self._thread.start()
        if not self._first.wait(_OPENS_WITHIN_S) or self._problem is not None:
            self.close()
            why = "no state came" if self._problem is None else cause(self._problem)
            raise LinkLost(f"arm {name}: its joints are not recorded: {why}")

    def pulse(self) -> bool:
        """Switch the digital output on for a moment; return False if there is none. Raises ``LinkLost``."""
        if self._pulses is None or self._output is None:
            return False
        bit = 1 << self._output
        self._pulses((bit, bit))
        time.sleep(_PULSE_S)
        self._pulses((bit, 0))
        return True

    def so_far(self) -> tuple[int, int]:
        """Return the numbers of received and lost states; from any thread."""
        count = len(self._states)
        first_s, latest_s = (self._states[row]["timestamp"][0] for row in (0, count - 1))
        return counts_so_far(count, first_s, latest_s, self._period_s)

    def end(self) -> JointRecord:
        """Close the connection and return all samples. Raises ``LinkLost`` if the connection ended before."""
        problem = self._problem
        self.close()
        if problem is not None:
            raise LinkLost(f"arm {self._name}: the recording of its joints ended early: {cause(problem)}") from problem
        states = self._states
        output = self._output
        bits = [int(state.get("actual_digital_output_bits", (0,))[0]) for state in states]
        level = np.array([0 if output is None else (value >> output) & 1 for value in bits], dtype=np.int8)
        time_s = _table(states, "timestamp")[:, 0]
        temperature = _table(states, "joint_temperatures")
        return JointRecord(
            time_s=time_s,
            q=_table(states, "actual_q"),
            qd=_table(states, "actual_qd"),
            period_s=self._period_s,
            temperature_c=temperature if temperature.any() else None,
            triggers_s=time_s[1:][np.diff(level) > 0],
        )

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._ending.set()
        self._link.shut_down()
        self._thread.join(_ENDS_WITHIN_S)
        self._link.close()

    def _record(self) -> None:
        """Store states until the connection is closed."""
        try:
            for values in self._outputs.states(lambda: Patience(_SILENT_S)):
                if not math.isfinite(sum(values["actual_q"])):
                    raise LinkLost("its state holds a value that is not a finite number")
                self._states.append(values)
                self._first.set()
        except LinkLost as error:
            if not self._ending.is_set():
                self._problem = error
            self._first.set()


def _table(states: Sequence[Values], name: str) -> NDArray[np.float64]:
    """Return an output of all states, (n, k); (n, 0) if it was not sent."""
    return np.array([state.get(name, ()) for state in states], dtype=np.float64).reshape(len(states), -1)
