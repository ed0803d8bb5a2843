"""Interface of every kind of arm: settings, how it is opened and probed, and what generic code may ask about it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from drivers.arms.protocol import Arm, JointLimits
from drivers.findings import Finding
from drivers.settings import Section

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from drivers.plant import Plant


@dataclass(frozen=True, eq=False)
class ArmContext:
    """What a cell specifies for one arm, independent of its kind.

    Attributes
    ----------
    name : str
        Name of the arm in the profile.
    model : str
        Model name as sold: "UR10", "UR5e".
    joints : int
        Number of joints N of that model.
    limits : JointLimits
        Position ranges of this cell, and the highest speeds and accelerations that will be commanded.
    payload_kg, payload_center_m : float, array of shape (3,)
        Load on the flange, centre of mass in the flange frame [m].
    plant : Plant or None
        The simulated cell; None if no device of the cell is simulated.
    simulation : bool
        Whether the arm's controller must be in its simulation mode, in which no arm moves.
    user : str
        Who drives it, for other computers: the run of a job.
    """

    name: str
    model: str
    joints: int
    limits: JointLimits
    payload_kg: float
    payload_center_m: NDArray[np.float64]
    plant: Plant | None = None
    simulation: bool = False
    user: str = ""


@dataclass(frozen=True)
class Package:
    """A Python package that a kind needs: its name for pip, its modules, and the devices that need it, in words."""

    name: str
    modules: tuple[str, ...]
    needed_by: str


@dataclass(frozen=True)
class EmulatedController:
    """How an emulated UR controller may replace an arm's own.

    ``host`` is its loopback address, None for any free one; ``serial`` is the serial number it reports, None for any.
    """

    host: str | None = None
    serial: str | None = None


class ArmSettings(Section):
    """Base of the settings of every kind of arm. Defaults are those of a real arm that needs no extra package."""

    kind: str
    needs_plant: ClassVar[bool] = False
    """Whether the arm belongs to the simulated cell."""
    has_device: ClassVar[bool] = True
    """Whether there is an arm to move; if not, readings come from a file."""
    packages: ClassVar[tuple[Package, ...]] = ()

    @property
    def controller_address(self) -> str:
        """Network address of the controller, unique among the arms; empty if there is none."""
        return ""

    def emulated_controller(self) -> EmulatedController | None:
        """Return how ``cellapp emulate`` can replace the controller; None if it must not."""
        return None

    @property
    def moves_hardware(self) -> bool:
        """Whether a motion moves a real arm: a device that is neither simulated nor an emulator on this computer."""
        return self.has_device and self.emulated_controller() is None

    @abstractmethod
    def open(self, arm: ArmContext) -> Arm:
        """Create the driver, not connected yet. Raises ``SettingError``."""

    @abstractmethod
    def probe(self, arm: ArmContext, patience_s: float) -> Sequence[Finding]:
        """Check the arm without moving it; a controller that is silent for ``patience_s`` [s] counts as dead."""

    def link(self, arm: ArmContext, look: Callable[[], None]) -> Sequence[Finding]:
        """Measure for some seconds whether the link to the controller is fast enough; empty for other kinds.

        ``look`` is called meanwhile and may raise.
        """
        return ()

    def left_program(self) -> str:
        """Return who started the program that runs on the controller, if a driver of this kind did; else empty."""
        return ""

    def end_program(self) -> None:
        """End the program that runs on the controller, whoever started it. Raises ``LinkLost``."""

    def excerpt(self, patience_s: float) -> Sequence[Mapping[str, object]]:
        """Return some states of the arm as its controller sends them, for a fault report; empty for other kinds."""
        return ()
