"""Python access to a cell: its profile, readings that are checked against it, and the calibration with both.

Readings of a cell from files, data frames or arrays, all with the same checks as files of readings.

Results of calibration and discovery: a model of the cell with predictions, tables, charts and compensation.

Conditions for the predictions of a model, with the same names as in readings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from cellapp.cell.profile import load_profile, profile_from_dict
from cellapp.cell.run.csv_export import table_of_arrays
from cellapp.cell.run.csv_import import readings_of_table
from cellapp.cell.run.csv_text import CsvTable, is_frame, read_csv_table, table_of_frame
from cellapp.cell.run.stations import require_ties
from cellapp.cell.targets.records import CompensateResult, TargetCommand
from cellapp.cell.targets.targets import Target, load_targets, targets_in_memory
from cellapp.commands.calibrate.charts import pair_stop_chart, stop_error_chart
from cellapp.commands.calibrate.held_out import HeldOutArm
from cellapp.commands.calibrate.result import calibrate_result
from cellapp.commands.calibrate.view import parameters_view
from cellapp.commands.calibrate.view import view as calibration_view
from cellapp.commands.compensate.run import compensate_targets
from cellapp.commands.compensate.view import view as compensation_view
from cellapp.commands.compensate.words import compensate_summary
from cellapp.commands.discover.run import discover_effects
from cellapp.commands.discover.view import gap_chart, picture_chart
from cellapp.commands.discover.view import view as discovery_view
from cellapp.commands.doctor.view import profile_tables
from cellapp.commands.stored_model import values_in_force
from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.table import table_of_cells
from cellapp.estimation.calibration.calibrate import calibrate_readings, missing_splits
from cellapp.estimation.calibration.quantities import conditions_of_arms, measured_minus_computed
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.records import DiscoverResult
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.counting import counted, did_you_mean
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.threads import one_blas_thread
from cellapp.interfaces.python.printed import Charted, Printed
from cellapp.robot.effects import MeasurementConditions, TemperatureRecord
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.arguments import configurations, of_arm, require_radians, too_heavy

if TYPE_CHECKING:
    import pandas as pd


ReadingsLike: TypeAlias = "str | Path | pd.DataFrame | Mapping[str, Mapping[str, Any]] | Mapping[str, Readings]"
"""A CSV file, a data frame with its columns, or arrays by arm; see ``Cell.readings``."""


@dataclass(frozen=True, eq=False, repr=False)
class CellReadings(Printed, Mapping[str, Readings]):
    """Checked readings of a cell: a mapping of each arm of the profile to its ``Readings``.

    Attributes
    ----------
    profile : Profile
    arms : mapping
        Arm -> Readings.
    notes : tuple of str
        Remarks: unknown columns, and what was derived from the order of the rows.
    """

    profile: Profile
    arms: Mapping[str, Readings]
    notes: tuple[str, ...] = ()

    def __getitem__(self, arm: str) -> Readings:
        return self.arms[arm]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arms)

    def __len__(self) -> int:
        return len(self.arms)

    def summary(self) -> str:
        """Return the number of readings of each arm."""
        return ", ".join(
            f"{name}: {counted(len(arm), 'reading')} of {arm.joints} joints" for name, arm in self.arms.items()
        )

    def view(self) -> Parts:
        """Return the content of each arm's readings, and the notes."""
        rows = ((name, len(arm), arm.joints, ", ".join(_given(arm))) for name, arm in self.arms.items())
        columns = "arm", ("readings", "d"), ("joints", "d"), "given"
        return [table_of_cells(f"Readings of {self.profile.name}", rows, *columns), *self.notes]

    def frame(self) -> pd.DataFrame:
        """Return one row for each arm and stop, with the columns of a CSV file of readings. Needs pandas."""
        from cellapp.interfaces.python.frames import readings_frame

        return readings_frame(self.arms)

    def with_splits(self) -> tuple[dict[str, Readings], tuple[str, ...]]:
        """Return the readings with a split each, drawn by the profile's seed where missing; and notes on the draw."""
        drawn, notes = missing_splits(self.profile, self.arms)
        return {name: replace(arm, split=drawn.get(name, arm.split)) for name, arm in self.arms.items()}, notes


def checked_readings(profile: Profile, source: ReadingsLike, *, in_order: bool = False) -> CellReadings:
    """Check readings; parameters and errors are those of ``Cell.readings``."""
    if isinstance(source, CellReadings) and not in_order:
        if source.profile == profile:
            return source
        source = source.arms
    readings, _, notes = readings_of_table(profile, _table(profile, source), in_order=in_order)
    require_ties(Path("readings"), readings)
    return CellReadings(profile, readings, tuple(notes))


def _table(profile: Profile, source: object) -> CsvTable:
    if isinstance(source, str | Path):
        return read_csv_table(Path(source))
    if is_frame(source):
        return table_of_frame(source)
    if isinstance(source, Mapping):
        return table_of_arrays(profile, {name: _arrays(arm) for name, arm in source.items()})
    raise InputError(
        "readings: expected the path of a CSV file, a data frame, or arrays by arm as {'left': {'q': q, 'p_M': p_M}},"
        f" got {type(source).__name__}"
    )


def _arrays(arm: Any) -> Any:
    """Return the quantities of one arm by name."""
    return {column.name: getattr(arm, column.name) for column in COLUMNS} if isinstance(arm, Readings) else arm


def _given(arm: Readings) -> list[str]:
    return [column.name for column in COLUMNS if column.is_given(getattr(arm, column.name))]


_FIELDS = {
    "approach": ("approach", True),
    "step": ("step", True),
    "payload_kg": ("payload_kg", False),
    "dwell_s": ("dwell_s", False),
    "time_s": ("time_s", False),
    "temperature_c": ("air_c", False),
    "joint_temperature_c": ("joints_c", True),
}
"""Name -> field of ``MeasurementConditions``, and whether it has a value for each joint."""
_OTHER = "other_q"


def stated_conditions(
    q: Array, given: Mapping[str, Any], arm: str, other: ArmModel | None, record: TemperatureRecord | None
) -> MeasurementConditions | None:
    """Return the conditions at configurations ``q`` (n, N) [rad]; None if none are given, so that all are unknown.

    Parameters
    ----------
    given : mapping
        ``approach``, ``step`` [rad], ``joint_temperature_c`` (n, N); ``payload_kg``, ``dwell_s``, ``time_s``,
        ``temperature_c`` (n,); ``other_q`` (n, K) [rad], the configurations of the other arm. Values are broadcast.
    other : ArmModel or None
        The other arm of a cell of two.
    record : TemperatureRecord or None
        Temperatures of the readings, to which ``time_s`` refers.

    Raises
    ------
    InputError
        If a condition has another name, or another shape.
    """
    if not given:
        return None
    fields: dict[str, Array] = {}
    for name, value in given.items():
        if name == _OTHER:
            continue
        if name not in _FIELDS:
            known = (*_FIELDS, _OTHER)
            hint = did_you_mean(name, known, cutoff=0.5)
            raise InputError(f"arm {arm}: no condition is called '{name}'; known are {', '.join(known)}{hint}")
        field, of_joints = _FIELDS[name]
        fields[field] = _values(f"arm {arm}: {name}", value, q.shape if of_joints else q.shape[:1])
        _check_as_readings(f"arm {arm}: {name}", name, fields[field])
    conditions = MeasurementConditions(**fields, record=record if "time_s" in given else None)
    if _OTHER not in given:
        return conditions
    if other is None:
        raise InputError(f"arm {arm}: {_OTHER} needs a cell of two arms")
    other_q = np.atleast_2d(_values(f"arm {arm}: {_OTHER}", given[_OTHER], None))
    at = configurations(other_q, other.geometry.joints, f"beside {arm}")
    return other.beside(conditions, np.broadcast_to(at, (len(q), at.shape[1])))


def _check_as_readings(where: str, name: str, values: Array) -> None:
    """Refuse what an import of readings refuses, with its words."""
    column = next(one for one in COLUMNS if one.name == name)
    matrix = column.matrix(values)
    wrong = matrix[~np.isnan(matrix) & ~np.isin(matrix, column.allowed)] if column.allowed else matrix[:0, 0]
    if len(wrong):
        raise InputError(f"{where}: expected {column.expected}, got {wrong[0]:g}")
    if column.check is not None and (fault := column.check(matrix)) is not None:
        raise InputError(f"{where}: {fault.text}")


def _values(where: str, value: Any, shape: tuple[int, ...] | None) -> Array:
    """Return numbers broadcast to ``shape``, or in their own shape if it is None."""
    try:
        array = np.asarray(value, dtype=np.float64)
        return array if shape is None else np.array(np.broadcast_to(array, shape))
    except (TypeError, ValueError):
        words = "numbers" if shape is None else f"shape {shape} or one number for all"
        raise InputError(f"{where}: expected {words}, got {value!r:.60}") from None


@dataclass(frozen=True, eq=False, repr=False)
class Fitted(Charted):
    """A model of the cell with the readings that it was fitted to.

    Attributes
    ----------
    profile : Profile
    readings : mapping
        Arm -> Readings, with the split of each.
    model : CellModel
        Has further methods; it also saves itself: ``model.save(Path("calibration.json"))``.
    """

    profile: Profile
    readings: Mapping[str, Readings]
    model: CellModel

    def predict(self, arm: str, q: ArrayLike, **conditions: ArrayLike) -> Array:
        """Predict SMR positions (n, 3) in the tracker frame [m] at controller readings ``q`` (n, N) [rad] of an arm.

        Parameters
        ----------
        conditions
            Inputs of effects, unknown if not given: ``approach``, ``step`` [rad], ``joint_temperature_c`` (n, N);
            ``payload_kg``, ``dwell_s``, ``time_s``, ``temperature_c`` (n,); ``other_q`` (n, K) [rad], the joints of the
            other arm. One number, or one row, stands for all.

        Raises
        ------
        InputError
            If there is no such arm or condition, or something has another shape or seems to be in degrees.
        """
        model, at, stated = self._asked(arm, q, conditions)
        return model.predict(at, conditions=stated)

    def uncertainty(self, arm: str, q: ArrayLike, **conditions: ArrayLike) -> Array:
        """Return the standard deviation (n,) [m] of a coordinate as ``predict`` gives it, without measurement noise."""
        model, at, stated = self._asked(arm, q, conditions)
        return model.uncertainty(at, stated)

    def _asked(
        self, arm: str, q: ArrayLike, given: Mapping[str, ArrayLike]
    ) -> tuple[ArmModel, Array, MeasurementConditions | None]:
        model = of_arm(self.model.arms, arm, "this cell")
        at = configurations(q, model.geometry.joints, arm)
        require_radians(at, arm)
        record = self._conditions[arm].record
        if (row := too_heavy(np.atleast_1d(given.get("payload_kg", 0.0)), model.bodies.masses)) is not None:
            raise InputError(
                f"arm {arm}: payload_kg: expected at most the arm's own mass, {model.bodies.masses.sum():.3g} kg, got"
                f" {np.atleast_1d(given['payload_kg'])[row]:g}"
            )
        return model, at, stated_conditions(at, given, arm, self.model.other(arm), record)

    @cached_property
    def _conditions(self) -> Mapping[str, MeasurementConditions]:
        return conditions_of_arms(self.model.arms, self.readings)

    @cached_property
    def residuals_M(self) -> Mapping[str, Array]:
        """Arm -> measured minus computed SMR positions (n, 3) in the tracker frame [m] of all its readings."""
        return measured_minus_computed(self.model, self.readings)

    def residuals(self) -> pd.DataFrame:
        """Return ``residuals_M`` as a table with one row per reading [mm]. Needs pandas."""
        from cellapp.interfaces.python.frames import residuals_frame

        return residuals_frame(self.readings, self.residuals_M)

    def parameters(self) -> pd.DataFrame:
        """Return every parameter of every arm, effects included: nominal, identified, standard error. Needs pandas."""
        from cellapp.interfaces.python.frames import parameters_frame

        return parameters_frame(self.model)

    def compensate(self, targets: str | Path | Sequence[Any] | Mapping[str, Any] | pd.DataFrame) -> Compensation:
        """Compute joint positions that bring the real arms to Cartesian targets.

        Parameters
        ----------
        targets
            The path of a list of targets (YAML or CSV); or a list of mappings with the keys that a target has in such a
            file, as ``{"name": "A1", "arm": "left", "position": [0.6, 0.1, 0.4]}`` [m]; or a data frame with the
            columns of a CSV file of targets.

        Raises
        ------
        InputError
            If a target does not fit the cell, or the profile does not give the poses of arms and tracker.
        """
        if isinstance(targets, str | Path):
            wanted = load_targets(Path(targets), self.profile)
        else:
            wanted = targets_in_memory(targets, self.profile)
        return Compensation(wanted, compensate_targets(self.profile, self.readings, self.model, wanted)[1])


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Fitted):
    """A calibrated cell. ``result`` is the same object that ``cellapp calibrate`` stores: ``result.to_json()``."""

    result: CalibrateResult

    def discover(self, job: JobToken = UNATTENDED) -> Discovery:
        """Search every arm for physical effects that this model lacks.

        Raises
        ------
        Cancelled
            If ``job`` is cancelled.
        """
        result, found = discover_effects(self.profile, self.model, self.readings, job)
        return Discovery(self.profile, self.readings, found.model, result, self)

    def summary(self) -> str:
        """Return the held-out error of each arm."""
        errors = {name: arm.validate_[arm.best_stage].position_mm for name, arm in self.result.arms.items()}
        return "held out: " + ", ".join(f"{name} {one.mean:.4f} mm (n = {one.n})" for name, one in errors.items())

    def view(self) -> Parts:
        """Return held-out errors, notes and identified parameters, as ``cellapp show`` prints them."""
        return [*calibration_view(self.result).parts, "", *parameters_view(self.result).parts]

    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return charts of the held-out errors by configuration, of each arm and of the pair."""
        return {
            "errors": lambda: _error_charts(self, self),
            "pair": lambda: [pair_stop_chart(self.result)] if self.result.pair else [],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Discovery(Fitted):
    """A calibrated cell with the effects that were found; ``result`` is the object that ``cellapp discover`` stores.

    ``calibration`` is the calibration that was searched.
    """

    result: DiscoverResult
    calibration: Calibration

    @property
    def effects(self) -> dict[str, tuple[str, ...]]:
        """Arm -> accepted effects, with the names of the handbook's chapter on effects."""
        return {name: tuple(one.effect for one in arm.accepted) for name, arm in self.result.arms.items()}

    def summary(self) -> str:
        """Return the effects and the held-out rms error of each arm, before and after."""
        return "; ".join(
            f"{name}: {', '.join(dict.fromkeys(self.effects[name])) or arm.verdict},"
            f" {arm.heldout_mm.before:.4f} -> {arm.heldout_mm.after:.4f} mm"
            for name, arm in self.result.arms.items()
        )

    def view(self) -> Parts:
        """Return the findings, the values of the effects and their meaning, and the parameters beside them, as
        ``cellapp show`` prints them."""
        parameters = parameters_view(values_in_force(self.calibration.result, self.model))
        return [*discovery_view(self.result).parts, "", *parameters.parts]

    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return charts: error after each step, held-out errors by configuration, pictures of the effects."""
        arms = self.result.arms
        return {
            "steps": lambda: [gap_chart(name, arm) for name, arm in arms.items()],
            "errors": lambda: _error_charts(self, self.calibration),
            "effects": lambda: [picture_chart(name, one) for name, arm in arms.items() for one in arm.pictures],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(Printed):
    """Commands for targets; ``result`` is the object that ``cellapp compensate`` stores.

    Attributes
    ----------
    targets : tuple of Target
    result : CompensateResult
        ``result.targets`` has a record for each target and arm.
    """

    targets: tuple[Target, ...]
    result: CompensateResult

    def q(self, arm: str) -> Array:
        """Return compensated joint positions (n, N) [rad] of an arm at its n targets, in their order; NaN if refused.

        Raises
        ------
        InputError
            If the arm has no target.
        """
        commands = of_arm(self._by_arm, arm, "these targets")
        joints = max((len(one.q_compensated) for one in commands if one.q_compensated is not None), default=0)
        return np.array([one.q_compensated or (np.nan,) * joints for one in commands], dtype=np.float64)

    @cached_property
    def _by_arm(self) -> dict[str, list[TargetCommand]]:
        arms = dict.fromkeys(one.arm for one in self.result.targets)
        return {arm: [one for one in self.result.targets if one.arm == arm] for arm in arms}

    def frame(self) -> pd.DataFrame:
        """Return one row for each target and arm: target, command, predicted uncertainty, refusal. Needs pandas."""
        from cellapp.interfaces.python.frames import targets_frame

        return targets_frame(self.result.targets)

    def summary(self) -> str:
        """Return how many targets can be commanded."""
        return compensate_summary(self.result)[0]

    def view(self) -> Parts:
        """Return commands, uncertainties and notes, as ``cellapp show`` prints them."""
        return compensation_view(self.result).parts


def _error_charts(newest: Fitted, calibration: Calibration) -> list[Chart]:
    """Return charts of the errors of each arm's held-out readings with every model up to ``newest``."""
    arms = calibration.result.arms

    def held_out(name: str) -> HeldOutArm:
        discovered = None if newest is calibration else newest.model.arms[name]
        conditions = newest._conditions[name]
        return HeldOutArm.of(newest.readings[name], conditions, arms[name], calibration.model.arms[name], discovered)

    return [stop_error_chart(name, held_out(name), arm.tracker_mm) for name, arm in arms.items()]


@dataclass(frozen=True, repr=False)
class Cell(Printed):
    """A robot cell as its profile describes it: one or more arms and a laser tracker.

    None of its methods moves an arm or writes a file.
    """

    profile: Profile

    @classmethod
    def load(cls, path: Path | str) -> Cell:
        """Load the cell of a YAML profile. Raises ``InputError`` with file, line and key of what is wrong."""
        return cls(load_profile(Path(path)))

    @classmethod
    def from_dict(cls, profile: Mapping[str, Any], folder: Path | str = ".") -> Cell:
        """Create the cell of a profile given as a mapping; paths in it are relative to ``folder``.

        Raises ``InputError`` with the key of what is wrong.
        """
        return cls(profile_from_dict(profile, Path(folder)))

    def readings(self, source: ReadingsLike, *, in_order: bool = False) -> CellReadings:
        """Check readings of this cell.

        Parameters
        ----------
        source
            The path of a CSV file; a data frame with its columns (``configuration``, ``arm``, ``q1`` ... [rad],
            ``x_m``, ``y_m``, ``z_m``, and optional ones); or for each arm its quantities as arrays, with the names,
            shapes and units of ``Readings``: ``{"left": {"q": (n, N) [rad], "p_M": (n, 3) [m], "sigma_m": 5e-6}}``. A
            single number stands for n equal ones. Without ``configuration`` (n,), row k of every arm is stop k.
        in_order : bool
            Whether the rows of an arm are in the order of measurement: missing approach and step are then derived from
            the previous row.

        Raises
        ------
        InputError
            Names the row and the quantity that is missing, not a number, implausible (degrees, millimetres) or of
            another shape; and arms that are not in the profile, or have no readings.
        """
        return checked_readings(self.profile, source, in_order=in_order)

    def calibrate(self, readings: ReadingsLike, job: JobToken = UNATTENDED, *, in_order: bool = False) -> Calibration:
        """Identify every arm, its residual network and the transform between the bases, as ``cellapp calibrate`` does.

        Parameters
        ----------
        readings, in_order
            As for ``readings``. Readings without a split get one by the profile's seed.
        job : JobToken
            Its listener receives progress events; it can be cancelled.

        Raises
        ------
        InputError
            As ``readings`` does, and if an arm has too few of them.
        Cancelled
            If ``job`` is cancelled.
        """
        checked = self.readings(readings, in_order=in_order)
        split, notes = checked.with_splits()
        with one_blas_thread():
            found = calibrate_readings(self.profile, split, job)
        return Calibration(self.profile, split, found.model, calibrate_result(found, notes))

    def summary(self) -> str:
        """Return the name of the cell, its arms and their types."""
        arms = ", ".join(f"{name} {arm.type.model}" for name, arm in self.profile.arms.items())
        return f"{self.profile.name}: {arms}"

    def view(self) -> Parts:
        """Return arms, tracker and plan as tables, one quantity per row."""
        return profile_tables(self.profile)
