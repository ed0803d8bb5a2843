"""Python access to a stored run as immutable plain objects. Nothing here moves an arm or writes a file.

    import cellapp

    run = cellapp.open_run("logs/my-run")
    p_M = run.predict("left", q)

The module ``dataframes`` has the run's tables as pandas data frames; ``cellapp docs python`` describes both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from numpy.typing import ArrayLike

from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.view import calibration_tables
from cellapp.commands.run_results import RunResults
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import not_calibrated
from cellapp.commands.stored_model import model_of
from cellapp.commands.view.parts import Parts
from cellapp.estimation.calibration.quantities import measured_minus_computed
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE, DISCOVER, STAGE_NAMES, StageName
from cellapp.ground.shell import shell_word
from cellapp.interfaces.python.cell import Calibration, Discovery
from cellapp.interfaces.python.printed import Printed
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel
from cellapp.robot.model.arguments import of_arm

__all__ = ["Run", "open_run"]

_STAGES = frozenset(STAGE_NAMES)


@dataclass(frozen=True, eq=False, repr=False)
class Run(Printed):
    """Content of a run when it was opened.

    Attributes
    ----------
    folder : Path
    profile : Profile
        The cell, as it was when the run began.
    measured : mapping
        Arm -> Readings, for the arms that have readings.
    results : RunResults
        Result of each verb, None if it has not run; ``results.out_of_date`` says which are out of date, and why.
    model : CellModel or None
        The model that compensation uses; None before the calibration. Its tracker frame M is that of the tracker's
        current station: that of the readings, or the one that ``cellapp check --tracker-moved`` has found since.
    models : mapping
        The models that calibration and discovery stored, as JSON.
    """

    folder: Path
    profile: Profile
    measured: Mapping[str, Readings]
    results: RunResults
    model: CellModel | None
    models: Mapping[StageName, str] = field(default_factory=dict)

    @cached_property
    def calibration(self) -> Calibration:
        """The stored calibration, as returned by ``Cell.calibrate``. Raises ``InputError`` if there is none."""
        if self.results.calibrate is None or CALIBRATE not in self.models:
            raise not_calibrated(self.folder, self.folder)
        result = self.results.calibrate.without_effects()  # the effects of a discovery are only added for display
        return Calibration(self.profile, self.measured, self._stored(CALIBRATE), result)

    @cached_property
    def discovery(self) -> Discovery:
        """The stored discovery, as returned by ``Calibration.discover``.

        Raises ``InputError`` if there is none that is based on the stored calibration.
        """
        reason = self.results.out_of_date.get(DISCOVER, "no discovery is stored")
        if self.results.discover is None or DISCOVER not in self.models or DISCOVER in self.results.out_of_date:
            raise InputError(f"{self.folder}: {reason}; run 'cellapp discover {shell_word(self.folder)}' first")
        return Discovery(self.profile, self.measured, self._stored(DISCOVER), self.results.discover, self.calibration)

    def _stored(self, stage: StageName) -> CellModel:
        return CellModel.from_json(self.models[stage], f"{self.folder}: model of '{stage}'")

    def summary(self) -> str:
        """Return folder, cell, number of readings, and the names of the stored results."""
        counts = ", ".join(f"{name} {len(arm)}" for name, arm in self.measured.items()) or "none"
        stored = [name for name in type(self.results).model_fields if name in _STAGES and getattr(self.results, name)]
        return (
            f"{str(self.folder)!r}, cell {self.profile.name}, readings: {counts}, {', '.join(stored) or 'no results'}"
        )

    def view(self) -> Parts:
        """Return the held-out errors, and which results are out of date; ``discovery`` has a view of its own."""
        tables = [] if self.results.calibrate is None else calibration_tables(self.results.calibrate)
        return [*tables, *(f"out of date: {name}: {reason}" for name, reason in self.results.out_of_date.items())]

    def readings(self, arm: str) -> Readings:
        """Return the readings of one arm. Raises ``InputError`` if there is no such arm with readings."""
        return of_arm(self.measured, arm, "this run")

    def calibrated_model(self) -> CellModel:
        """Return the model. Raises ``InputError`` if the run is not calibrated."""
        if self.model is None:
            raise not_calibrated(self.folder, self.folder)
        return self.model

    def predict(self, arm: str, q: ArrayLike) -> Array:
        """Predict SMR positions (n, 3) in frame M [m] of an arm with N joints at controller readings ``q`` (n, N)
        [rad].

        ``calibrated_model().predict`` also takes approach directions, payloads and other conditions.

        Raises
        ------
        InputError
            If there is no such arm, ``q`` has another shape or seems to be in degrees, or the run is not calibrated.
        """
        return self.calibrated_model().predict(arm, q)

    def residuals(self, arm: str) -> Array:
        """Return measured minus computed SMR positions (n, 3) in frame M [m] of all readings of an arm, in order.

        Each is computed for the conditions of its reading: approach, step, payload, temperatures, the other arm.

        Raises
        ------
        InputError
            If no such arm has readings, or the run is not calibrated.
        """
        self.readings(arm)
        return measured_minus_computed(self.calibrated_model(), self.measured)[arm]


def open_run(folder: Path | str) -> Run:
    """Read a run.

    Raises
    ------
    InputError
        If there is none in ``folder``, or it is damaged.
    """
    with RunFile.open(Path(folder)) as run:
        state = RunState(run)
        stages = state.stages
        return Run(
            folder=run.folder,
            profile=run.profile,
            measured={arm: run.readings(arm) for arm in run.arms()},
            results=state.results,
            model=None if stages.in_force is None else model_of(run, stages.in_force),
            models={name: stage.model for name, stage in stages.current.items() if stage.model is not None},
        )
