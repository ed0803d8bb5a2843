"""Measured errors judged against the profile's tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from cellapp.ground.results import DecisionRule, Record

ToleranceVerdict = Literal["in", "out", "not decided", ""]
"""Whether a target is within its tolerance; empty if it has none, or if there is nothing to judge."""

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


class CommonUncertainty(Record):
    """What is common to the uncertainties of all targets of one TCP, and the rest.

    Attributes
    ----------
    tcp : six numbers or None
        x, y, z [m] and rotation vector [rad] in the flange frame; None for the flange, or the SMR.
    flange_mm, flange_mrad : three numbers
        Standard uncertainties in the flange frame along, and of a rotation about, x, y and z.
    base_mm, base_mrad : float
        In the base frame: of a coordinate at the targets, and of the rotation.
    own_mm : float
        Median of the targets' own standard uncertainty of a coordinate, without what is common.
    significant : bool or None
        Whether what the corrections have in common is significant against it; None without corrections.
    """

    tcp: Six | None
    flange_mm: Three
    flange_mrad: Three
    base_mm: float
    base_mrad: float
    own_mm: float
    significant: bool | None = None
    omitted_when_none = frozenset({"significant"})

    @property
    def sentence(self) -> str:
        """What is common, and what would determine it."""
        shift, mrad = (", ".join(f"{value:.3f}" for value in its) for its in (self.flange_mm, self.flange_mrad))
        return (
            f"in the flange frame x, y, z {shift} mm and about them {mrad} mrad, which a TCP taught with the calibrated"
            f" arm, a probe or three SMRs would determine; in the base frame {self.base_mm:.3f} mm a coordinate and"
            f" {self.base_mrad:.3f} mrad, which a surveyed base would determine"
        )


Conformity = Literal["conforms", "does not conform", "not decided"]
Characteristic = Literal[
    "position",
    "orientation",
    "distance",
    "cooperative",
    "cooperative_orientation",
    "pose_accuracy",
    "pose_repeatability",
    "multidirectional",
    "distance_accuracy",
    "distance_repeatability",
    "drift",
    "path_accuracy",
    "path_repeatability",
]
"""Keys of the profile's section ``tolerances``."""


class Judgement(Record):
    """One characteristic of one arm, or of a pair of arms, against its tolerance [mm]; of an orientation [mrad].

    ``value_mm`` is the measured error and ``expanded_mm`` its expanded uncertainty (coverage factor 2); None where it
    was not measured, or its uncertainty is not known. ``source`` says what was measured, as "verification, 40 targets".
    Of an orientation those in mm are None, and those in mrad stand instead.
    """

    characteristic: Characteristic
    where: str
    value_mm: float | None
    expanded_mm: float | None
    tolerance_mm: float | None
    rule: DecisionRule
    conformity: Conformity
    source: str
    n: int = 0
    value_mrad: float | None = None
    expanded_mrad: float | None = None
    tolerance_mrad: float | None = None
    omitted_when_none = frozenset({"value_mrad", "expanded_mrad", "tolerance_mrad"})

    @property
    def unit(self) -> Literal["mm", "mrad"]:
        """Of ``value``, ``expanded`` and ``tolerance``."""
        return "mm" if self.tolerance_mrad is None else "mrad"

    @property
    def value(self) -> float | None:
        """The measured error."""
        return self.value_mm if self.unit == "mm" else self.value_mrad

    @property
    def expanded(self) -> float | None:
        """Its expanded uncertainty."""
        return self.expanded_mm if self.unit == "mm" else self.expanded_mrad

    @property
    def tolerance(self) -> float:
        """The largest permissible error."""
        return self.tolerance_mm or self.tolerance_mrad or 0.0


def overall(judgements: Sequence[Judgement]) -> Conformity | None:
    """Return the worst of all judgements; None if nothing is judged."""
    found = {one.conformity for one in judgements}
    order: tuple[Conformity, ...] = ("does not conform", "not decided", "conforms")
    return next((one for one in order if one in found), None)


class UncertaintyParts(Record):
    """Standard uncertainty of a measured coordinate of the SMR at a command by its sources [mm]; squares add.

    ``extrapolation`` is what the command's distance from the measured joint ranges and payloads adds; ``noise`` is the
    scatter of the readings about the model: tracker and repeatability; ``conditions`` is what working conditions add
    that nobody stated.
    """

    parameters: float
    effects: float
    network: float
    extrapolation: float
    noise: float
    conditions: float


class UncertaintyContribution(Record):
    """One line of the uncertainty budget: standard uncertainty of a position [mm]; None where it was not given.

    ``where`` is the arm whose position error the line is of.
    """

    source: str
    standard_mm: float | None
    evaluation: Literal["A", "B"]
    basis: str
    where: str = ""


class AngleContribution(Record):
    """One line of the uncertainty budget of an orientation: standard uncertainty of a component [mrad].

    As ``UncertaintyContribution``.
    """

    source: str
    standard_mrad: float | None
    evaluation: Literal["A", "B"]
    basis: str
    where: str = ""
