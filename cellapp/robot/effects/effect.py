"""Base class of all effects: their declarations and columns.

An effect is one subclass of ``Effect`` in one file, and one line in ``registry``. It declares its words, the variables
it depends on, its look-alikes and the forms of its law; it computes columns that are linear in its parameters.
Joint offsets enter the chain exactly; all other channels move the SMR by less than a millimetre and enter linearly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

from cellapp.robot.effects.column import EffectColumn
from cellapp.robot.effects.context import EffectContext
from cellapp.robot.effects.law import DriverVariable, Law, LawForm
from cellapp.robot.effects.meaning import Meaning
from cellapp.robot.effects.modulation import FreeDriver
from cellapp.robot.effects.smooth import SmoothLaw


@dataclass(frozen=True)
class ImpossibleValues:
    """Texts for values of an effect outside their physical bounds, and what to check then.

    Attributes
    ----------
    sign : str
        What the opposite sign looks like; if empty, the effect's title "of the opposite sign".
    sign_check, size_check : str
        What to check.
    limit : str
        Name of the limit of which values beyond the bound are stated as multiples.
    limit_size : float
        That limit in the parameter's unit; 0 for the bound itself.
    """

    sign: str = ""
    sign_check: str = "check signs and units of the readings and of the profile"
    limit: str = "what is physically possible"
    limit_size: float = 0.0
    size_check: str = "check units of the readings and of the profile"


class Effect(ABC):
    """A physical effect."""

    slug: ClassVar[str]
    """Identifier in JSON and results."""
    title: ClassVar[str]
    """Name in reports."""
    meaning: ClassVar[Meaning]
    """Cause, usual size, what to check and what would settle it."""
    look_alikes: ClassVar[tuple[str, ...]] = ()
    """Slugs of effects that data may not distinguish from it."""
    variables: ClassVar[frozenset[DriverVariable]]
    """What it depends on."""
    forms: ClassVar[tuple[LawForm, ...]]
    """All forms of its law, the simplest first."""
    free_drivers: ClassVar[tuple[FreeDriver, ...]] = ()
    """Drivers on which it may depend in ways that the law does not describe; if empty, the law is taken as exact."""

    arm_bound: ClassVar[bool] = False
    """Whether it belongs to the arm itself: its parameters then remain valid with another base or tool."""

    of_reading: ClassVar[bool] = False
    """Whether it moves the reading or the reflector instead of the flange."""
    wears: ClassVar[bool] = False
    """Whether it is caused by wear: a check looks for it at every joint, even if the calibration did not find it."""
    lengthens: ClassVar[bool] = False
    """Whether it lengthens links."""
    shifts_zero: ClassVar[bool] = False
    """Whether it shifts the zero positions of joints."""

    impossible: ClassVar[ImpossibleValues] = ImpossibleValues()
    """Words for values outside the bounds of its columns."""

    def missing_data(self, context: EffectContext) -> str:
        """Return why the data cannot show the effect at all ("no approach signs"); empty if they can."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """Return the laws to try on these data, the simplest first."""
        return [form.law() for form in self.forms]

    def refinements(self, context: EffectContext, law: Law, names: Collection[str]) -> list[Law]:
        """Return further laws to try if ``law`` with the columns ``names`` was found."""
        return []

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """Return the smooth laws that the structured process adds for the residuals of the other laws."""
        return []

    @abstractmethod
    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Compute the columns of a law, the same set for any data; ``names`` requests columns made only on request."""

    def meaning_of(self, law: Law) -> Meaning:
        """Return the meaning of this law; the same for all laws unless an effect overrides it."""
        return self.meaning

    def form(self, name: str) -> LawForm:
        """Return the form ``name``, the simplest one if empty; raise ``ValueError`` if there is none."""
        for form in self.forms:
            if name in ("", form.name):
                return form
        raise ValueError(f"effect {self.slug} has no law '{name}' in this version of the program")

    def law(self, name: str = "", constants: Mapping[str, float] | None = None, tried: int = 1) -> Law:
        """Return a law by the name of its form."""
        return self.form(name).law(constants, tried)
