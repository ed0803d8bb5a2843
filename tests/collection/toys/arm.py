"""The kind ``toy`` of arms: it is at its target at once."""

from __future__ import annotations

import time
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.arms.protocol import ArmIdentity, ArmState, DoubtListener, JointLimits, Tool
from drivers.arms.settings import ArmContext, ArmSettings
from drivers.findings import Finding
from drivers.quantities import Turn


class ToyArmSettings(ArmSettings):
    """An arm without inertia that starts at ``start``."""

    kind: Literal["toy"] = "toy"
    start: tuple[Turn, ...]

    @property
    def moves_hardware(self) -> bool:
        """A toy moves nothing."""
        return False

    def open(self, arm: ArmContext) -> ToyArm:
        """Return the driver."""
        return ToyArm(arm, np.array(self.start))

    def probe(self, arm: ArmContext, patience_s: float) -> list[Finding]:
        """Report the model."""
        return [Finding("weight", "ok", f"a {arm.model} of {arm.joints} joints weighs nothing")]


class ToyArm:
    """Jumps."""

    def __init__(self, arm: ArmContext, q: NDArray[np.float64]) -> None:
        self._arm, self._q = arm, q

    @property
    def name(self) -> str:
        return self._arm.name

    def connect(self) -> None: ...

    def disconnect(self) -> None: ...

    def brake(self) -> None: ...

    def stop(self) -> None: ...

    def watch(self, listener: DoubtListener) -> None: ...

    def refused_by_controller(self, q: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.zeros(len(q), dtype=np.bool_)

    def identify(self) -> ArmIdentity:
        return ArmIdentity("toy", f"TOY-{self.name}", "none")

    def limits(self) -> JointLimits:
        return self._arm.limits

    def tool(self) -> Tool:
        return Tool(None, None, None)

    def warnings(self) -> tuple[str, ...]:
        return ()

    def state(self) -> ArmState:
        return ArmState(self._q, time.monotonic(), False, True, "", None, None)

    def start_move(self, q: NDArray[np.float64], speed: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        self._q = q

    def wait_settled(self, timeout_s: float) -> ArmState:
        return self.state()
