"""Running estimates while stops are measured: air temperature, and the model refitted after each stop."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from cellapp.estimation.calibration.online import GROSS, NO_GEOMETRY_M, Innovation, OnlineFit, Residuals
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import AirReport, StopReport, Suspicion
from cellapp.robot.kinematics.transforms import Array, twist_columns
from drivers.sensors.protocol import AirSensor, SensorError

Note = Callable[[str, str], None]
"""Callback with a log level ("info", "warning") and a sentence."""


@dataclass
class AirTemperature:
    """Air temperature from the weather station; None while the station fails, which is noted once.

    The tracker's own sensor is no substitute: a change of sensor would look like a change of the air. ``heard`` is
    called with every reading.
    """

    sensor: AirSensor
    note: Note
    heard: Callable[[AirReport], None]
    state: Literal["new", "working", "failed"] = "new"

    def at_stop(self, stop: int) -> float | None:
        """Read the air temperature [degC]; None if the station fails."""
        try:
            reading = self.sensor.read()
        except SensorError as error:
            if self.state != "failed":
                self.note("warning", f"stop {stop + 1}: readings go without air temperature: {error}")
            self.state = "failed"
            return None
        if self.state != "working":
            self.note("info", f"stop {stop + 1}: {reading}")
        self.state = "working"
        self.heard(AirReport(reading.temperature_c, reading.pressure_hpa, reading.humidity_percent))
        return reading.temperature_c


class LiveModel:
    """Models of all arms, refitted after each stop. An arm whose model cannot be fitted is measured without one."""

    def __init__(
        self, profile: Profile, planned: Mapping[str, Array], stored: Mapping[str, Readings], note: Note
    ) -> None:
        """Start with the ``stored`` readings; ``planned`` has the joint positions (n, N) [rad] of all stops by arm."""
        self._finish = profile.collection.finish
        self._note = note
        self._fits: dict[str, OnlineFit] = {}
        self._latest: dict[str, StopReport] = {}
        for name, q in planned.items():
            try:
                self._fits[name] = OnlineFit(profile, name, q)
                if name in stored:
                    its = stored[name]
                    report = self._fits[name].add(its.configuration.tolist(), its.q, its.p_M, its.covariance_M)
                    self._latest |= {} if report is None else {name: report}
            except (InputError, np.linalg.LinAlgError) as error:
                self._drop(name, error)
        normals = {name: np.array(arm.smr.normal) / math.hypot(*arm.smr.normal) for name, arm in profile.arms.items()}
        self._suspicions = Suspicions(normals)

    def add(self, stop: int, rows: Mapping[str, Readings]) -> list[StopReport | Suspicion]:
        """Refit with the readings of a stop; return a report for each arm with a model, and suspicions."""
        found: list[StopReport | Suspicion] = []
        innovations = {}
        for name, reading in rows.items():
            fit = self._fits.get(name)
            if fit is None:
                continue
            try:
                report = fit.add([stop], reading.q, reading.p_M, reading.covariance_M)
            except np.linalg.LinAlgError as error:
                self._drop(name, error)
                continue
            innovations[name] = fit.innovation
            if report is not None:
                self._latest[name] = report
                found.append(report)
        return [*found, *self._suspicions.at_stop(stop, innovations)]

    def forget_suspicions(self) -> None:
        """Reset the suspicions after a person has inspected the cell."""
        self._suspicions.forget()

    @property
    def standard_error_mm(self) -> dict[str, float]:
        """Standard uncertainty [mm] of a predicted SMR position due to the parameters, by arm with a model."""
        return {name: report.standard_error_mm for name, report in self._latest.items()}

    def residuals(self) -> dict[str, Residuals]:
        """Return the residuals of all readings in order of arrival, by arm with a model."""
        found = {name: fit.residuals() for name, fit in self._fits.items()}
        return {name: one for name, one in found.items() if one is not None}

    def lengths_m(self, name: str, readings: Readings) -> list[float | None]:
        """Return the residual lengths [m] of readings that were not used in the fit; None without a model."""
        fit = self._fits.get(name)
        lengths = None if fit is None or not len(readings) else fit.lengths_m(readings.q, readings.p_M)
        return [None] * len(readings) if lengths is None else list(lengths.tolist())

    def accurate_enough(self, stops_done: int) -> bool:
        """Return whether every arm has the requested standard error, after the minimum number of stops."""
        asked = self._finish.standard_error
        if asked is None or stops_done < self._finish.least_stops or set(self._latest) != set(self._fits):
            return False
        return bool(self._fits) and all(error <= asked * 1e3 for error in self.standard_error_mm.values())

    def _drop(self, name: str, error: Exception) -> None:
        self._fits.pop(name, None)
        self._latest.pop(name, None)
        self._note("info", f"arm {name}: measured without a running model: {error}")


# -- Detect faults while stops are measured: a wrong SMR, a loose SMR, a bumped tracker, drift ------------------------
#
# Each reading is compared with the model fitted without it (``online.Innovation``). Without a fault these deviations
# have zero mean and the covariance that the model states, which includes unmodelled physics. Unmodelled physics
# correlates consecutive stops that are close to each other: their correlation over the run so far reduces their joint
# weight (integrated autocorrelation: Bartlett, J. R. Stat. Soc. B 8 (1946) 27). A fault leaves a pattern in the
# deviations:
#
# - an SMR that slipped: from some stop on the same offset in the flange frame, of one arm;
# - an SMR with play: more scatter than before, of one arm;
# - a bumped tracker: from some stop on one rigid motion of all arms in the tracker frame; of one arm: its base moved;
# - drift: such a motion that grows.
#
# The test statistic of each pattern and each stop at which it may have begun is the decrease of chi-square by the best
# offset, motion or scatter (generalised likelihood ratio; Basseville, Nikiforov, Detection of Abrupt Changes (1993),
# ch. 7). A single bad reading never raises such a suspicion: its contribution to the statistic is bounded.


_CHANCE = 3e-10
"""Alarm threshold: probability of a pattern without a fault. Found by trial: less than 1 in 100 runs of 400 stops of
the simulated cell with gravity and backlash then raises any alarm. It is so small because unmodelled physics makes
large deviations more frequent than a normal distribution does, and a run has some 1e5 correlated tests."""
_TRACE = 1e-3
"""If the likeliest pattern is more probable than this without a fault, a stop shows no trace of a suspicion."""
_CLEARED_AFTER = 10
"""Consecutive stops without a trace after which a suspicion is cleared and may be raised again."""
_LEAST_FREEDOM = 20.0
"""Degrees of freedom of the model's scatter needed to judge deviations; with fewer its covariance is too uncertain."""
_CLIP = 4.0
"""Length at which a deviation is clipped [standard uncertainties]; exceeded once in a thousand stops."""
_HISTORY = 80
"""Number of recent stops that are kept."""
_STEPS = (*range(2, 11), 12, 15, 20, 30, 40, 60, 80)
"""Tested numbers of stops since a sudden change."""
_RAMPS = (20, 40, 80)
"""Tested numbers of stops since a slow change began."""
_PARAMETER_COST = 4.0
"""Chi-square that each parameter of a pattern costs when patterns are compared (BIC for some 50 coordinates)."""
_DECISIVE = 6.0
"""Lead in chi-square, less these costs, with which one of two patterns is accepted: odds of 20."""
_PATIENCE = 5
"""Number of stops that an undecided alarm waits; then the likeliest pattern is reported."""
_OTHER_SMR_M = 2e-3
"""Larger offsets mean another SMR, or one that is not in its seat: the play of a loose one is smaller [m]."""
_ALONG_NORMAL = math.cos(math.radians(30.0))
"""Cosine of the largest angle between offset and seat axis for another SMR, or one that is not in its seat."""
_ELSEWHERE_M = 1e-3
"""Distance from the expected position from which a reading is compared with the other arms' SMRs [m]."""
_SETTLED_AFTER = 15
"""Delay [stops] before a deviation enters the correlation: a fault correlates stops too, but is detected earlier."""
_INDEPENDENT_PAIRS = 20.0
"""Weight of the prior that consecutive stops are independent [pairs of stops]."""
_MOST_ALIKE = 0.8
"""Upper limit of the correlation of consecutive stops: then nine of them carry as much information as one."""
_LIKELY_CHANGE = 0.05
"""Prior standard deviation of an offset [m] or motion [m, rad]: so wide that it only regularises the estimate."""

PatternKind = Literal["slip", "play", "move", "drift"]
_Key = tuple[str, str | None]


def _shares() -> Array:
    """Return the fraction (patterns, ages) of a change that acts on a reading, by pattern and age (0 is the newest)."""
    age = np.arange(_HISTORY)
    steps = [np.where(age < stops, 1.0, 0.0) for stops in _STEPS]
    return np.array(steps + [np.clip((stops - age) / stops, 0.0, None) for stops in _RAMPS])


_SHARES = _shares()
_STOPS = np.array([*_STEPS, *_RAMPS])
_SUDDEN, _SLOW = slice(0, len(_STEPS)), slice(len(_STEPS), None)
_OFFSET, _MOTION = slice(0, 3), slice(3, 9)
"""Parameters of a change: an offset of the SMR in the flange frame, and a motion in the tracker frame."""
_STOP = np.dtype([("normal", "f8", (9, 9)), ("clipped", "f8", 9), ("raw", "f8", 9), ("square", "f8"), ("count", "f8")])
"""What a stop adds to the normal equations of these parameters: ``clipped`` and ``raw`` are right sides with and
without clipping, ``square`` is the clipped square of the deviation, ``count`` 1. All are zero without a reading."""


@dataclass(frozen=True)
class _Explanation:
    """Pattern that may explain the recent deviations, with its best number of stops.

    Attributes
    ----------
    kind : str
        ``slip`` or ``play`` of an SMR, ``move`` of the tracker or of a base, slow ``drift``.
    arm : str or None
        None if it is of all arms.
    chi_square : float
        Decrease of chi-square, or of twice the negative log likelihood.
    parameters : int
    chance : float
        Probability of such deviations without a fault.
    value : array, shape (3,), (6,) or (0,)
        Offset in the flange frame [m]; or translation [m] and rotation [rad] in the tracker frame.
    stops : int
        Number of stops since the change.
    """

    kind: PatternKind
    arm: str | None
    chi_square: float
    parameters: int
    chance: float
    value: Array
    stops: int

    @property
    def score(self) -> float:
        """Chi-square less the cost of the parameters."""
        return self.chi_square - _PARAMETER_COST * self.parameters


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Recent stops of one arm or of several: columns of ``_STOP`` summed over the stops with each pattern's shares.

    ``freedom`` is that of the model's scatter. ``dependence`` is the number of stops with the information of one
    independent stop.
    """

    sums: Mapping[str, Array]
    freedom: float
    dependence: float

    @classmethod
    def together(cls, each: Sequence[_Evidence]) -> _Evidence:
        """Return the evidence of several arms together."""
        sums = {column: np.sum([one.sums[column] for one in each], axis=0) for column in each[0].sums}
        return cls(sums, min(one.freedom for one in each), max(one.dependence for one in each))

    def change(self, kind: Literal["slip", "move", "drift"], arm: str | None) -> list[_Explanation]:
        """Return the best offset or motion over the patterns of its kind, as a list of one; empty without readings.

        Patterns with fewer coordinates than twice the parameters are left out: they would explain anything.
        """
        rows, which = _SLOW if kind == "drift" else _SUDDEN, _OFFSET if kind == "slip" else _MOTION
        b, raw = self.sums["clipped"][rows, which], self.sums["raw"][rows, which]
        parameters = b.shape[1]
        normal = self.sums["normal"][rows, which, which] + np.eye(parameters) / _LIKELY_CHANGE**2
        values = np.asarray(np.linalg.solve(normal, np.stack([b, raw], axis=2)), dtype=np.float64)
        enough = 3.0 * self.sums["count"][rows] >= 2.0 * parameters
        chi_square = np.where(enough, np.sum(values[:, :, 0] * b, axis=1), 0.0)
        place = int(np.argmax(chi_square))
        largest = float(chi_square[place]) / self.dependence
        if largest <= 0.0:
            return []
        chance = float(scipy.special.fdtrc(parameters, self.freedom, largest / parameters))
        return [_Explanation(kind, arm, largest, parameters, chance, values[place, :, 1], int(_STOPS[rows][place]))]

    def play(self, arm: str | None) -> list[_Explanation]:
        """Return the best increase of the scatter, as a list of one; empty without readings.

        Squares of correlated stops are hardly correlated, so that the probability needs no allowance for it. The gain
        is reduced like those of the other patterns, with which it is compared.
        """
        coordinates = 3.0 * self.sums["count"][_SUDDEN]
        ratio = np.maximum(self.sums["square"][_SUDDEN] / np.maximum(coordinates, 1.0), 1.0)
        gain = coordinates * (ratio - 1.0 - np.log(ratio))
        place = int(np.argmax(gain))
        if gain[place] <= 0.0:
            return []
        chance = float(scipy.special.fdtrc(coordinates[place], self.freedom, ratio[place]))
        return [_Explanation("play", arm, float(gain[place]) / self.dependence, 1, chance, np.zeros(0), _STEPS[place])]


class _History:
    """Recent stops of one arm, newest first."""

    def __init__(self) -> None:
        self.stops = np.zeros(_HISTORY, _STOP)
        self._freedom = _LEAST_FREEDOM
        self._recent: deque[Array] = deque()
        self._product, self._square = 0.0, 3.0 * _INDEPENDENT_PAIRS

    def push(self, found: Innovation | None, center_M: Array) -> None:
        """Add a stop; rotations are about ``center_M`` (3,) [m]."""
        self.stops[1:] = self.stops[:-1].copy()
        self.stops[0] = 0.0
        if found is None:
            return
        information = np.linalg.inv(found.covariance_M)
        square = float(found.off_M @ information @ found.off_M)
        clip = min(1.0, _CLIP / math.sqrt(max(square, 1e-300)))
        basis = np.hstack([found.R_M_F, twist_columns(found.p_M[None] - center_M)[0]])
        weighted = basis.T @ information
        raw = weighted @ found.off_M
        self.stops[0] = weighted @ basis, clip * raw, raw, min(square, _CLIP**2), 1.0
        self._freedom = found.freedom
        self._recent.append(clip * np.linalg.solve(np.linalg.cholesky(found.covariance_M), found.off_M))
        if len(self._recent) > _SETTLED_AFTER:
            first, second = self._recent.popleft(), self._recent[0]
            self._product += float(first @ second)
            self._square += 0.5 * float(first @ first + second @ second)

    def evidence(self) -> _Evidence:
        """Return what the stops say: their dependence is (1 + r) / (1 - r), r the correlation of consecutive ones."""
        sums = {column: np.tensordot(_SHARES, self.stops[column], 1) for column in _STOP.fields or ()}
        sums["normal"] = np.tensordot(_SHARES**2, self.stops["normal"], 1)
        r = min(max(self._product / self._square, 0.0), _MOST_ALIKE)
        return _Evidence(sums, self._freedom, (1.0 + r) / (1.0 - r))


class Suspicions:
    """Judges every stop; raises each suspicion once until it is cleared.

    Parameters
    ----------
    normals_F : mapping
        Arm -> axis (3,) of its SMR's seat in the flange frame.
    """

    def __init__(self, normals_F: Mapping[str, Array]) -> None:
        self._normals_F = normals_F
        self._histories = {name: _History() for name in normals_F}
        self._quiet: dict[_Key, int] = {}
        """Raised suspicions -> number of consecutive stops without a trace of them."""
        self._center_M: Array | None = None
        self._undecided = 0
        self._stops: deque[int] = deque(maxlen=_HISTORY)

    def forget(self) -> None:
        """Reset everything after a person has inspected the cell."""
        self._quiet.clear()
        self._undecided = 0
        self._stops.clear()
        for history in self._histories.values():
            history.stops[:] = 0.0

    def at_stop(self, stop: int, found: Mapping[str, Innovation | None]) -> tuple[Suspicion, ...]:
        """Return the suspicions that a stop raises; ``found`` has each arm's new ``OnlineFit.innovation``, or None."""
        self._stops.appendleft(stop)
        usable = {name: one for name, one in found.items() if one is not None and one.freedom >= _LEAST_FREEDOM}
        wrong = _wrong_smrs(stop, usable)
        for name, history in self._histories.items():
            one = None if any(suspicion.arm == name for suspicion in wrong) else usable.get(name)
            if self._center_M is None and one is not None:
                self._center_M = one.p_M
            history.push(one, np.zeros(3) if self._center_M is None else self._center_M)
        explanations = self._explanations()
        self._clear_quiet(explanations, wrong)
        raised = [*wrong, *self._changes(explanations)]
        new = tuple(one for one in raised if (one.kind, one.arm) not in self._quiet)
        self._quiet.update({(one.kind, one.arm): 0 for one in raised})
        return new

    def _explanations(self) -> list[_Explanation]:
        """Return the best explanation of each kind, for each arm and for all arms together."""
        each = {name: one.evidence() for name, one in self._histories.items() if one.stops["count"].any()}
        found = []
        for name, own in each.items():
            found += own.change("slip", name) + own.play(name)
            if len(each) > 1:
                found += own.change("move", name)
        explained = {arm for _, arm in self._quiet}
        free = [own for name, own in each.items() if name not in explained]
        if len(free) > 1 or (free and len(each) == 1):
            both = _Evidence.together(free)
            found += both.change("move", None) + both.change("drift", None)
            found += both.play(None) if len(each) > 1 else []
        return found

    def _changes(self, explanations: list[_Explanation]) -> list[Suspicion]:
        """Return the likeliest change in a list, empty if there is no alarm or it is undecided."""
        open_ones = [one for one in explanations if not self._stands(one.arm)]
        if not any(one.chance < _CHANCE for one in open_ones):
            self._undecided = 0
            return []
        best, *others = sorted(open_ones, key=lambda one: -one.score)
        self._undecided += 1
        if others and best.score - others[0].score < _DECISIVE and self._undecided <= _PATIENCE:
            return []
        self._undecided = 0
        return [self._words(best)]

    def _stands(self, arm: str | None) -> bool:
        """Return whether a raised suspicion already explains the deviations of an arm, or of all if None."""
        explained = {key[1] for key in self._quiet}
        return None in explained or (explained >= self._histories.keys() if arm is None else arm in explained)

    def _words(self, best: _Explanation) -> Suspicion:
        """Return the suspicion, with its text, for an explanation."""
        since = f"since stop {self._stops[min(best.stops, len(self._stops)) - 1] + 1}"
        size = f"{float(np.linalg.norm(best.value[:3])) * 1e3:.2f} mm"
        angle = f"{float(np.linalg.norm(best.value[3:])) * 1e3:.2f} mrad"
        if best.kind == "slip" and best.arm is not None:
            return _of_slip(best.arm, since, best.value, self._normals_F[best.arm])
        if best.kind == "play" and best.arm is not None:
            text = f"arm {best.arm}: {since} its readings scatter more than before: check that its SMR sits firmly"
            return Suspicion("loose SMR", text, best.arm)
        if best.kind == "play":
            text = f"{since} the readings of all arms scatter more than before: check that the tracker stands firmly"
            return Suspicion("tracker moved", text)
        if best.kind == "drift":
            text = f"{since} the readings of all arms drift together, by {size} and {angle}: check warm-up and air"
            return Suspicion("drift", text)
        if best.arm is not None:
            text = f"arm {best.arm}: {since} its readings are off by one motion, {size} and {angle}: is its base firm?"
            return Suspicion("tracker moved", text, best.arm)
        text = f"{since} the readings of all arms are off by one motion, {size} and {angle}: was the tracker touched?"
        return Suspicion("tracker moved", text)

    def _clear_quiet(self, explanations: list[_Explanation], wrong: list[Suspicion]) -> None:
        """Clear suspicions without a trace for some stops, and the histories of their arms."""
        for key in list(self._quiet):
            arms = [key[1]] if key[1] is not None else list(self._histories)
            chances = [one.chance for one in explanations if one.arm in arms]
            trace = min(chances, default=1.0) < _TRACE or any((one.kind, one.arm) == key for one in wrong)
            self._quiet[key] = 0 if trace else self._quiet[key] + 1
            if self._quiet[key] >= _CLEARED_AFTER:
                del self._quiet[key]
                for name in arms:
                    self._histories[name].stops[:] = 0.0


def _wrong_smrs(stop: int, found: Mapping[str, Innovation]) -> list[Suspicion]:
    """Find arms whose reading is where another arm's SMR should be, or whose readings fit no geometry at all."""
    suspicions = []
    for name, one in found.items():
        off = float(np.linalg.norm(one.off_M))
        if one.scatter_m > NO_GEOMETRY_M:
            text = (
                f"arm {name}: its readings fit no geometry near the nominal one ({one.scatter_m * 1e3:.1f} mm): check"
                " which SMR the tracker measures for it, and the SMR's offset in the profile"
            )
            suspicions.append(Suspicion("wrong SMR", text, name))
        elif off > max(_ELSEWHERE_M, GROSS * one.scatter_m):
            for other, theirs in found.items():
                away = float(np.linalg.norm(one.p_M - (theirs.p_M - theirs.off_M)))
                if other != name and away < min(off, max(_ELSEWHERE_M, GROSS * theirs.scatter_m)):
                    text = (
                        f"arm {name}: the reading of stop {stop + 1} is {away * 1e3:.1f} mm from where the SMR of arm"
                        f" {other} should be, and {off * 1e3:.0f} mm from its own: the tracker measured the wrong SMR"
                    )
                    suspicions.append(Suspicion("wrong SMR", text, name))
    return suspicions


def _of_slip(arm: str, since: str, offset_F: Array, normal_F: Array) -> Suspicion:
    """Report a large offset along the axis of the seat as another SMR or one not in its seat; else as a slipped SMR."""
    size = float(np.linalg.norm(offset_F))
    if size > _OTHER_SMR_M and abs(float(offset_F @ normal_F)) > _ALONG_NORMAL * size * float(np.linalg.norm(normal_F)):
        text = f"arm {arm}: {since} its SMR is {size * 1e3:.1f} mm off along its axis: another SMR, or not in its seat?"
        return Suspicion("wrong SMR", text, arm)
    text = f"arm {arm}: {since} its SMR is {size * 1e3:.2f} mm off on the flange: check that it sits firmly"
    return Suspicion("loose SMR", text, arm)
