"""``trials power``: from which size on effects would be named."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.run import RunFile
from cellapp.estimation.discovery.records import SmallestSize
from cellapp.ground.results import Record, Result

POWER_RESULT = "plan-power"
"""Name of the document in a run with the result."""
SHARE = 0.95
"""Share of the trials in which an effect must be named."""


class NamingTrial(Record):
    """One blind trial: an effect hidden in an arm, its rms displacement of the SMR, and what was accepted.

    ``visible`` is the share of the displacement that the geometry cannot follow. ``named`` is the largest value of the
    effect where it was named.
    """

    arm: str
    effect: str
    size_mm: float
    seed: int
    visible: float = 0.0
    accepted: tuple[str, ...] = ()
    named: SmallestSize | None = None


class NamedSize(Record):
    """Rms displacement of the SMR [mm] from which an effect is named in ``SHARE`` of the trials: median of the belief,
    and the limits of 90 %; ``high_mm`` is None where the trials set none. ``size`` is the effect's largest value."""

    value_mm: float
    low_mm: float
    high_mm: float | None
    size: SmallestSize | None


class EffectPower(Record):
    """What the trials say of one effect in one arm.

    Attributes
    ----------
    named_from : NamedSize or None
        None: the trials do not show that it would be named in ``SHARE`` of the runs, whatever its size.
    not_up_to_mm : float or None
        Then the largest rms displacement that was tried [mm]; None where no trial was made.
    visible_share : float or None
        Median share of its displacement that geometry cannot follow at these stops.
    trials, named, with_others : int
        Trials, those in which its name was accepted, and those of them in which another name was, too.
    limit : str
        What limits it.
    """

    effect: str
    title: str
    named_from: NamedSize | None = None
    not_up_to_mm: float | None = None
    visible_share: float | None = None
    trials: int = 0
    named: int = 0
    with_others: int = 0
    limit: str = ""


class ArmPower(Record):
    """One arm: stops, rms length of the tracker's noise [mm], and every effect of the library that it can have."""

    stops: int
    noise_rms_mm: float
    effects: tuple[EffectPower, ...]


class PowerResult(Result, schema="cellapp-plan-power"):
    """``trials power``: arms, every trial, what failed, and whether the time ended it before all trials were made."""

    date: str
    program: str
    profile: str
    trials_of_each: int
    seed: int
    share: float
    arms: Mapping[str, ArmPower]
    trials: tuple[NamingTrial, ...]
    failed: tuple[str, ...] = ()
    ended_by_time: bool = False


def stored_power(run: RunFile) -> PowerResult | None:
    """Return the stored result of a run; None if its plan was not tried."""
    text = run.read_result(POWER_RESULT)
    return None if text is None else PowerResult.from_json(text, str(run.folder))
