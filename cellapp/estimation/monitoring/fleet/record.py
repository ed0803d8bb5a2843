"""What a comparison of many runs needs to know of one run: a small part of what the run file has."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.estimation.discovery.records import Place
from cellapp.estimation.monitoring.fleet.records import CheckPoint, DatedValue, Figure, IdentityBasis, IsoPoint
from cellapp.ground.results import Estimate, Method, Record, StageName


class GeometryRecord(Record):
    """Geometric parameters of the model in force.

    Attributes
    ----------
    values, nominal : mapping
        Estimated parameter -> value [m, rad], in the order of ``covariance``.
    covariance : tuple
        Lower triangle, row by row.
    merged : mapping
        Parameter that the data do not determine -> those that take its place, and their shares.
    determined : tuple of str
        Parameters that the data determine.
    levers : mapping
        Rms displacement of the SMR [m] by one unit of a parameter.
    degrees_of_freedom : int
    """

    values: Mapping[str, float]
    nominal: Mapping[str, float]
    covariance: tuple[float, ...]
    merged: Mapping[str, Mapping[str, float]]
    determined: tuple[str, ...]
    levers: Mapping[str, float]
    degrees_of_freedom: int


class EffectRecord(Record):
    """An effect in the model in force.

    ``parameters`` are empty where they have no meaning from run to run: those of a free curve. ``size_mm`` is the rms
    displacement of the SMR by it over ``n`` held-out stops. ``answer_set``: effects that explain the data as well.
    """

    effect: str
    title: str
    where: Place
    parameters: Mapping[str, Estimate]
    size_mm: float | None = None
    n: int = 0
    answer_set: tuple[str, ...] = ()


class ArmRecord(Record):
    """One arm of one run.

    Attributes
    ----------
    effects : tuple or None
        None where no search that still holds was made.
    smallest : mapping
        Effect that was not found -> parameter -> smallest size that would have been found, in the parameter's unit.
    unseen : tuple of str
        Effects that the readings could not show.
    heldout_rms_mm, heldout_n
        Rms error and number of held-out stops with all effects.
    temperatures_c : mapping
        Mean temperatures over the readings: of the "air", and of "joint 1" and so on, where known.
    """

    type: str
    key: str
    known_by: IdentityBasis
    serial: str = ""
    geometry: GeometryRecord | None = None
    effects: tuple[EffectRecord, ...] | None = None
    smallest: Mapping[str, Mapping[str, float]] = {}
    unseen: tuple[str, ...] = ()
    heldout_rms_mm: float | None = None
    heldout_n: int = 0
    temperatures_c: Mapping[str, float] = {}
    figures: Mapping[Figure, tuple[DatedValue, ...]] = {}
    checks: tuple[CheckPoint, ...] = ()
    iso9283: tuple[IsoPoint, ...] = ()


class RunRecord(Record):
    """One run; ``arms`` is empty where there is a ``problem``, a sentence.

    ``transforms`` has the inter-base transform of the first two arms by method. ``alone``: the record depends on
    nothing but the run's own file.
    """

    run: str
    problem: str = ""
    profile: str = ""
    began: str = ""
    stage: StageName | None = None
    arms: Mapping[str, ArmRecord] = {}
    transforms: Mapping[Method, Mapping[str, Estimate]] = {}
    tolerance_mm: float | None = None
    alone: bool = True
    notes: tuple[str, ...] = ()
