"""Result of ``certificate``."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import IsoLine
from cellapp.estimation.uncertainty.budget import Range
from cellapp.estimation.uncertainty.records import AngleContribution, Characteristic, Judgement, UncertaintyContribution
from cellapp.ground.results import ErrorSummary, Record, Result


class CertifiedErrors(Record):
    """Errors before and after compensation [mm]; None where they were not measured.

    ``found`` and ``left`` were measured at the verified targets: with commands of the published geometry, and with
    those that are kept. ``predicted_found`` and ``predicted_left`` are errors of the nominal and of the calibrated
    model at stops that the calibration did not use: predictions, not measurements of a compensated arm. Those in mrad
    are the same of the flange's rotation, where a probe measured it.
    """

    found: ErrorSummary | None = None
    left: ErrorSummary | None = None
    predicted_found: ErrorSummary | None = None
    predicted_left: ErrorSummary | None = None
    found_mrad: ErrorSummary | None = None
    left_mrad: ErrorSummary | None = None
    predicted_found_mrad: ErrorSummary | None = None
    predicted_left_mrad: ErrorSummary | None = None
    omitted_when_none = frozenset({"found_mrad", "left_mrad", "predicted_found_mrad", "predicted_left_mrad"})

    @property
    def positions(self) -> tuple[tuple[ErrorSummary | None, ErrorSummary | None], ...]:
        """As found and as left [mm]: measured, then predicted."""
        return (self.found, self.left), (self.predicted_found, self.predicted_left)

    @property
    def orientations(self) -> tuple[tuple[ErrorSummary | None, ErrorSummary | None], ...]:
        """The same [mrad]."""
        return (self.found_mrad, self.left_mrad), (self.predicted_found_mrad, self.predicted_left_mrad)


class CertifiedArm(Record):
    """One arm: what identifies it, what it was measured under, its errors.

    Empty texts and None were not given. Ranges are those of the readings; ``expanded_mm`` is the expanded uncertainty
    (k = 2) of a position error, None where a contribution was not given; ``expanded_mrad`` that of an orientation.
    """

    type: str
    serial: str = ""
    asset: str = ""
    controller_model: str = ""
    controller_serial: str = ""
    controller_software: str = ""
    readings: int
    errors: CertifiedErrors
    expanded_mm: float | None = None
    payload_kg: Range | None = None
    air_c: Range | None = None
    joints_c: Range | None = None
    distance_m: Range | None = None
    expanded_mrad: float | None = None
    omitted_when_none = frozenset({"expanded_mrad"})


class CertifiedInstrument(Record):
    """An instrument or standard; empty texts were not given. ``note`` says why it was not in order when it was used."""

    role: str
    model: str = ""
    serial: str = ""
    calibrated: str = ""
    due: str = ""
    certificate: str = ""
    note: str = ""


class CertifiedCharacteristic(Record):
    """A characteristic of ISO 9283 of one arm, at the pose, distance or path where its size is largest [mm].

    ``commands`` "nominal" are as found, "calibrated" as left; ``n`` is the number of cycles.
    """

    where: str
    characteristic: Characteristic
    commands: IsoCommands
    value_mm: float
    expanded_mm: float | None
    n: int


class CertifiedTests(Record):
    """What the tests by ISO 9283 found, and under which conditions; ``missing`` is what could not be measured.

    ``cycles`` and ``speed_share`` (of the profile's speed) are None where that was not recorded. ``coverage`` lists
    what the norm asks for, done or not and why.
    """

    characteristics: tuple[CertifiedCharacteristic, ...]
    cycles: int | None = None
    speed_share: float | None = None
    payload_kg: Mapping[str, float] = {}
    missing: tuple[str, ...] = ()
    coverage: tuple[IsoLine, ...] = ()


class CertifiedTarget(Record):
    """A verified target of one arm: position in the tracker frame [m]; its errors [mm], None where not measured.

    ``found_mm`` is with the command of the published geometry, ``left_mm`` with the one that is kept; ``found_mrad``
    and ``left_mrad`` are of the flange's rotation, where it was measured.
    """

    name: str
    arm: str
    wanted_M: tuple[float, float, float] | None = None
    found_mm: float | None = None
    left_mm: float | None = None
    found_mrad: float | None = None
    left_mrad: float | None = None
    omitted_when_none = frozenset({"found_mrad", "left_mrad"})

    @property
    def wanted_M_mm(self) -> tuple[float, ...]:
        """The position [mm]; empty where it is not known."""
        return () if self.wanted_M is None else tuple(1e3 * value for value in self.wanted_M)


SIMULATED = "simulated cell"
"""Begin of the warning that a cell is simulated: its certificate must not pass for that of a real one."""


class CertificateResult(Result, schema="cellapp-certificate"):
    """``certificate``: what was found and left, measured with what, judged how.

    Attributes
    ----------
    measured : tuple
        First and last time of measuring (ISO 8601, UTC); empty where it was not recorded.
    limits : tuple
        What the figures hold for, and what they do not cover.
    missing : tuple
        Data that a reader would expect and that nobody gave.
    warnings : tuple
        What a reader must know first: a simulated cell, no verification, an instrument whose calibration was overdue.
    out_of_date : tuple
        Results that no longer hold, with the reason.
    files : tuple
        Names of the files that were written for people.
    rests_on : mapping
        Name of each file with what the certificate rests on, in the folder of the certificate -> its SHA-256.
    method : str
        How positions were measured and errors computed, with the version of the program.
    procedure : str
        The written procedure of the organisation.
    air_pressure_hpa, relative_humidity_percent : (float, float) or None
        Smallest and largest while measuring, as stated.
    targets : tuple
        Those that were verified.
    orientation_contributions : tuple, optional
        To the uncertainty of an error of orientation, where readings had orientations.
    """

    number: str
    run: str
    profile: str = ""
    issued: str = ""
    measured: tuple[str, ...] = ()
    program: str = ""
    organisation: str = ""
    location: str = ""
    operator: str = ""
    client: str = ""
    method: str = ""
    procedure: str = ""
    air_pressure_hpa: Range | None = None
    relative_humidity_percent: Range | None = None
    arms: Mapping[str, CertifiedArm] = {}
    pair: CertifiedErrors = CertifiedErrors()
    instruments: tuple[CertifiedInstrument, ...] = ()
    judgements: tuple[Judgement, ...] = ()
    contributions: tuple[UncertaintyContribution, ...] = ()
    targets: tuple[CertifiedTarget, ...] = ()
    iso9283: CertifiedTests | None = None
    limits: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    out_of_date: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    rests_on: Mapping[str, str] = {}
    orientation_contributions: tuple[AngleContribution, ...] | None = None
    omitted_when_none = frozenset({"iso9283", "orientation_contributions"})

    @property
    def is_simulated(self) -> bool:
        """Whether nothing real was measured."""
        return any(one.startswith(SIMULATED) for one in self.warnings)

    def complaints(self) -> list[str]:
        """Say why the certificate does not confirm conformity; empty if it does or nothing is judged."""
        unjudged = [
            f"{one.characteristic.replace('_', ' ')} of {one.where}: {one.conformity}"
            for one in self.judgements
            if one.conformity != "conforms"
        ]
        return [*self.warnings, *self.out_of_date, *unjudged]
