"""Suspicions while stops are measured: a wrong SMR, a loose SMR, a bumped tracker, drift.

Each reading is compared with the model that did not know it (``online.Innovation``). Without a fault these deviations
are independent from stop to stop, about zero, with the covariance that the model states; unmodelled physics is part of
it. A fault leaves a pattern in them:

- an SMR that slipped: the same offset in the flange frame at every stop since then, of one arm;
- a bumped tracker: one rigid motion in the tracker frame of all arms since then;
- drift: such a motion that grows;
- an SMR with play: more scatter than before, of one arm.

For each pattern and each stop at which it may have begun, the test statistic is the decrease of chi-square by the best
offset or motion (a generalised likelihood ratio; Basseville, Nikiforov, Detection of Abrupt Changes (1993), ch. 7).
One bad reading alone never raises a suspicion of this kind: its share of the statistic is bounded.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import fdtrc

from cellapp.calibration.online import Innovation
from cellapp.kinematics.transforms import Array
from cellapp.progress import Suspicion

_CHANCE = 2e-7
"""False alarm probability of one test. 400 stops, two arms and 30 correlated tests each come to less than 1 % a run."""
_QUIET = 1e-2
"""Probability above which a stop shows no trace of a suspicion."""
_CLEARED_AFTER = 10
"""Stops without a trace after which a suspicion is cleared and may be raised again."""
_LEAST_FREEDOM = 20.0
"""Degrees of freedom of the model's scatter from which deviations are judged; below, the model knows too little."""
_CLIP = 4.0
"""Largest length of a deviation in standard uncertainties that counts, exceeded once in a thousand stops."""
_HISTORY = 80
"""Stops that are kept."""
_STEPS = (*range(2, 21), 30, 40, 60, 80)
"""Numbers of stops since a sudden change."""
_RAMPS = (20, 40, 80)
"""Numbers of stops since a slow change began."""
_PARAMETER_COST = 4.0
"""Chi-square that a parameter of a pattern must be worth where patterns are compared (BIC for some 50 coordinates)."""
_DECISIVE = 6.0
"""Difference of chi-square, less these costs, from which one of two patterns is believed: odds of 20."""
_PATIENCE = 5
"""Stops for which an undecided alarm waits; then the likeliest pattern is named."""
_PLAY_STOPS = 10
"""Stops over which scatter is judged."""
_OTHER_SMR_M = 2e-3
"""Offset of an SMR from which it is another one, or not in its seat: play of a loose one is smaller."""
_ALONG_NORMAL = math.cos(math.radians(30.0))
"""An SMR of another size, or one not in its seat, is off along the axis of its nest."""
_ELSEWHERE_M = 1e-3
"""Least distance from the expected position at which a reading is compared with the other arms' SMRs."""
_GROSS = 12.0
"""The same in standard uncertainties; the fit gives such a reading no weight."""


_LIKELY_CHANGE = 0.05
"""Standard deviation of an offset [m] or motion [m, rad]: far above any, it only settles what readings leave open."""
_NO_GEOMETRY_M = 2e-3
"""Scatter about the model beyond that of any arm and of any unmodelled physics."""

_Equations = tuple[Array, Array]
ChangeKind = Literal["slip", "move", "drift"]
_Key = tuple[str, str | None]


def _patterns() -> Array:
    """Share of a change that acts on a reading (patterns, ages): by pattern, and by age of the reading, 0 the newest."""
    age = np.arange(_HISTORY)
    steps = [np.where(age < stops, 1.0, 0.0) for stops in _STEPS]
    return np.array(steps + [np.clip((stops - age) / stops, 0.0, None) for stops in _RAMPS])


_SHARES = _patterns()
_STOPS = (*_STEPS, *_RAMPS)
_FIVE = _STEPS.index(5)


@dataclass(frozen=True)
class _Explanation:
    """A pattern that may explain the recent deviations, at its best number of stops.

    Attributes
    ----------
    kind : str
        ``slip`` of an SMR, ``move`` of the tracker or of a base, slow ``drift``.
    arm : str or None
        None: all arms.
    chi_square : float
        Decrease by the best offset or motion.
    parameters : int
    chance : float
        Probability of such a decrease without a fault.
    recent_chance : float
        The same of a change five stops ago.
    value : array, shape (3,) or (6,)
        Offset in the flange [m]; or shift [m] and rotation [rad] in the tracker frame.
    stops : int
        Number of stops since the change.
    """

    kind: ChangeKind
    arm: str | None
    chi_square: float
    parameters: int
    chance: float
    recent_chance: float
    value: Array
    stops: int

    @property
    def score(self) -> float:
        """Chi-square less the cost of the parameters."""
        return self.chi_square - _PARAMETER_COST * self.parameters


class _History:
    """Normal equations of each recent stop of one arm, newest first; zero where it has no reading.

    ``slip``: of an offset in the flange frame; ``move``: of a shift and a rotation in the tracker frame.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all stops."""
        self.slip = np.zeros((_HISTORY, 3)), np.zeros((_HISTORY, 3, 3))
        self.move = np.zeros((_HISTORY, 6)), np.zeros((_HISTORY, 6, 6))
        self.squares, self.present = np.zeros(_HISTORY), np.zeros(_HISTORY, dtype=bool)
        self.freedom = _LEAST_FREEDOM

    def push(self, found: Innovation | None, center_M: Array) -> None:
        """Add a stop; rotations are about ``center_M`` (3,) [m]."""
        for array in (*self.slip, *self.move, self.squares, self.present):
            array[1:] = array[:-1].copy()
            array[0] = 0.0
        if found is None:
            return
        information = np.linalg.inv(found.covariance_M)
        square = float(found.off_M @ information @ found.off_M)
        off = found.off_M * min(1.0, _CLIP / math.sqrt(max(square, 1e-300)))
        x, y, z = found.p_M - center_M
        motion = np.column_stack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
        for (b, A), basis in ((self.slip, found.R_M_F), (self.move, motion)):
            weighted = basis.T @ information
            b[0], A[0] = weighted @ off, weighted @ basis
        self.squares[0], self.present[0], self.freedom = min(square, _CLIP**2), True, found.freedom

    def play(self) -> float:
        """Probability of the scatter of the last stops without a fault; 1 before there are enough of them."""
        if self.present.sum() < _PLAY_STOPS:
            return 1.0
        recent = self.squares[np.flatnonzero(self.present)[:_PLAY_STOPS]]
        return float(fdtrc(3 * _PLAY_STOPS, self.freedom, recent.sum() / (3 * _PLAY_STOPS)))


class Suspicions:
    """Judge every stop; each suspicion is raised once until it clears.

    Parameters
    ----------
    normals_F : mapping
        Arm -> axis (3,) of its SMR's seat in the flange frame.
    """

    def __init__(self, normals_F: Mapping[str, Array]) -> None:
        self._normals_F = normals_F
        self._histories = {name: _History() for name in normals_F}
        self._quiet: dict[_Key, int] = {}
        """Suspicions that were raised, and for how many stops they have left no trace."""
        self._center_M: Array | None = None
        self._undecided = 0
        self._stops: deque[int] = deque(maxlen=_HISTORY)

    def forget(self) -> None:
        """Start afresh, after a person has looked at the cell."""
        self._quiet.clear()
        self._undecided = 0
        self._stops.clear()
        for history in self._histories.values():
            history.clear()

    def at_stop(self, stop: int, found: Mapping[str, Innovation | None]) -> tuple[Suspicion, ...]:
        """Suspicions that a stop raises; ``found`` is the newest ``OnlineFit.innovation`` of each arm, None without."""
        self._stops.appendleft(stop)
        usable = {name: one for name, one in found.items() if one is not None and one.freedom >= _LEAST_FREEDOM}
        wrong = _wrong_smrs(stop, usable)
        for name, history in self._histories.items():
            one = None if any(suspicion.arm == name for suspicion in wrong) else usable.get(name)
            if self._center_M is None and one is not None:
                self._center_M = one.p_M
            history.push(one, np.zeros(3) if self._center_M is None else self._center_M)
        explanations = self._explanations()
        play = {name: history.play() for name, history in self._histories.items()}
        self._clear_quiet(explanations, play, wrong)
        return self._new([*wrong, *self._changes(explanations), *self._scatter(explanations, play)])

    def _new(self, suspicions: list[Suspicion]) -> tuple[Suspicion, ...]:
        """Those that do not stand already."""
        new = tuple(one for one in suspicions if (one.kind, one.arm) not in self._quiet)
        self._quiet.update({(one.kind, one.arm): 0 for one in suspicions})
        return new

    def _stands(self, arm: str) -> bool:
        """Whether the deviations of an arm have been explained by a suspicion."""
        return any(key[1] in (arm, None) for key in self._quiet)

    def _explanations(self) -> list[_Explanation]:
        """The best explanation of each kind, for each arm and for all together."""
        found = []
        for name, one in self._histories.items():
            found += _explain("slip", name, [one.slip], one.freedom)
            if len(self._histories) > 1:
                found += _explain("move", name, [one.move], one.freedom)
        alone = {arm for _, arm in self._quiet}
        free = [one for name, one in self._histories.items() if name not in alone]
        if len(free) > 1 or (free and len(self._histories) == 1):
            freedom = min(one.freedom for one in free)
            together = [one.move for one in free]
            found += _explain("move", None, together, freedom) + _explain("drift", None, together, freedom)
        return found

    def _changes(self, explanations: list[_Explanation]) -> list[Suspicion]:
        """The likeliest of the changes, if there is one and it is decided."""
        open_ones = [one for one in explanations if not self._explained(one)]
        if not any(one.chance < _CHANCE for one in open_ones):
            self._undecided = 0
            return []
        best, *others = sorted(open_ones, key=lambda one: -one.score)
        self._undecided += 1
        if others and best.score - others[0].score < _DECISIVE and self._undecided <= _PATIENCE:
            return []
        self._undecided = 0
        return [self._words(best)]

    def _explained(self, one: _Explanation) -> bool:
        """Whether a suspicion that stands explains the same readings."""
        if one.arm is None:
            return any(key[1] is None for key in self._quiet) or all(self._stands(arm) for arm in self._histories)
        return self._stands(one.arm)

    def _scatter(self, explanations: list[_Explanation], play: Mapping[str, float]) -> list[Suspicion]:
        """Arms whose readings scatter more than before, where no change explains it."""
        if self._undecided or any(one.chance < _CHANCE for one in explanations):
            return []
        loose = [name for name, chance in play.items() if chance < _CHANCE and not self._stands(name)]
        if len(loose) > 1 and len(loose) == len(play):
            text = "the readings of all arms scatter more than before: check that the tracker stands firm, and the air"
            return [Suspicion("tracker moved", text)]
        return [
            Suspicion(
                "loose SMR", f"arm {name}: its readings scatter more than before: check that its SMR sits firmly", name
            )
            for name in loose
        ]

    def _words(self, best: _Explanation) -> Suspicion:
        """The suspicion that an explanation means."""
        since = f"since stop {self._stops[min(best.stops, len(self._stops)) - 1] + 1}"
        size = f"{float(np.linalg.norm(best.value[:3])) * 1e3:.2f} mm"
        turn = f"{float(np.linalg.norm(best.value[3:])) * 1e3:.2f} mrad"
        if best.kind == "drift":
            text = f"the readings of all arms drift together, by {size} and {turn} {since}: check warm-up and air"
            return Suspicion("drift", text)
        if best.kind == "move":
            who = "all arms have" if best.arm is None else f"arm {best.arm} have"
            check = "the tracker was touched" if best.arm is None else "its base is firm, or the tracker was touched"
            text = f"the readings of {who} moved together {since}, by {size} and {turn}: check whether {check}"
            return Suspicion("tracker moved", text, best.arm)
        assert best.arm is not None
        return _of_slip(best.arm, since, best.value, self._normals_F[best.arm])

    def _clear_quiet(self, explanations: list[_Explanation], play: Mapping[str, float], wrong: list[Suspicion]) -> None:
        """Clear suspicions that have left no trace for some stops; their arms' histories begin anew."""
        for key in list(self._quiet):
            arm = key[1]
            arms = [arm] if arm is not None else list(self._histories)
            chances = [one.recent_chance for one in explanations if one.arm in (arm, *arms)]
            chances += [play[name] for name in arms]
            trace = min(chances, default=1.0) < _QUIET or any((one.kind, one.arm) == key for one in wrong)
            self._quiet[key] = 0 if trace else self._quiet[key] + 1
            if self._quiet[key] >= _CLEARED_AFTER:
                del self._quiet[key]
                for name in arms:
                    self._histories[name].clear()


def _explain(kind: ChangeKind, arm: str | None, equations: list[_Equations], freedom: float) -> list[_Explanation]:
    """The best explanation of a kind by these arms' normal equations; none without a reading."""
    b, A = np.sum([one[0] for one in equations], axis=0), np.sum([one[1] for one in equations], axis=0)
    parameters = b.shape[1]
    patterns = slice(len(_STEPS), None) if kind == "drift" else slice(0, len(_STEPS))
    shares = _SHARES[patterns]
    right = shares @ b
    left = (shares**2 @ A.reshape(_HISTORY, -1)).reshape(-1, parameters, parameters)
    left += np.eye(parameters) / _LIKELY_CHANGE**2
    values = np.linalg.solve(left, right[:, :, None])[:, :, 0]
    chi_square = np.sum(values * right, axis=1)
    place = int(np.argmax(chi_square))
    if chi_square[place] <= 0.0:
        return []
    chances = fdtrc(parameters, freedom, chi_square[[place, _FIVE if kind != "drift" else 0]] / parameters)
    return [
        _Explanation(
            kind,
            arm,
            float(chi_square[place]),
            parameters,
            float(chances[0]),
            float(chances[1]),
            values[place],
            _STOPS[patterns][place],
        )
    ]


def _wrong_smrs(stop: int, found: Mapping[str, Innovation]) -> list[Suspicion]:
    """Arms whose reading is where another arm's SMR should be, or whose readings fit no geometry at all."""
    suspicions = []
    for name, one in found.items():
        off = float(np.linalg.norm(one.off_M))
        if one.scatter_m > _NO_GEOMETRY_M:
            text = (
                f"arm {name}: its readings fit no geometry near the nominal one ({one.scatter_m * 1e3:.1f} mm): check"
                " which SMR the tracker measures for it, and the SMR's offset in the profile"
            )
            suspicions.append(Suspicion("wrong SMR", text, name))
        elif off > max(_ELSEWHERE_M, _GROSS * one.scatter_m):
            for other, theirs in found.items():
                away = float(np.linalg.norm(one.p_M - (theirs.p_M - theirs.off_M)))
                if other != name and away < min(off, max(_ELSEWHERE_M, _GROSS * theirs.scatter_m)):
                    text = (
                        f"arm {name}: the reading of stop {stop + 1} is {away * 1e3:.1f} mm from where the SMR of arm"
                        f" {other} should be, and {off * 1e3:.0f} mm from its own: the tracker measured the wrong SMR"
                    )
                    suspicions.append(Suspicion("wrong SMR", text, name))
    return suspicions


def _of_slip(arm: str, since: str, offset_F: Array, normal_F: Array) -> Suspicion:
    """A large offset along the axis of the SMR's seat is another SMR, or one not in its seat; else it slipped."""
    size = float(np.linalg.norm(offset_F))
    if size > _OTHER_SMR_M and abs(float(offset_F @ normal_F)) > _ALONG_NORMAL * size * float(np.linalg.norm(normal_F)):
        text = f"arm {arm}: {since} its SMR is {size * 1e3:.1f} mm off along its axis: another SMR, or not in its seat?"
        return Suspicion("wrong SMR", text, arm)
    text = f"arm {arm}: {since} its SMR is {size * 1e3:.2f} mm off on the flange: check that it sits firmly"
    return Suspicion("loose SMR", text, arm)


class ReferenceWatch:
    """Judge reference measurements, each against the one before (a jump) and against the first (drift).

    Parameters
    ----------
    limit_m : float
        Largest accepted displacement [m].
    """

    def __init__(self, limit_m: float) -> None:
        self._limit_m = limit_m
        self._first: dict[str, Array] = {}
        self._last: dict[str, Array] = {}

    def at_reference(self, points_M: Mapping[str, Array], arms: Collection[str]) -> tuple[Suspicion, ...]:
        """Suspicions from the references' positions (3,) [m]: ``arms`` at home by their names, the others are nests."""
        jumps = self._beyond(points_M, self._last)
        drifts = {name: size for name, size in self._beyond(points_M, self._first).items() if name not in jumps}
        shared = len(self._last.keys() & points_M.keys())
        for name, point in points_M.items():
            if name in jumps or name not in self._first:  # a jump is raised once: the next ones are judged from here
                self._first[name] = point
            self._last[name] = point
        fixed = [name for name in jumps if name not in arms]
        if jumps and len(jumps) == shared and (fixed or len(jumps) > 1):
            text = f"all references moved by {_largest_mm(jumps)} since the last time: was the tracker touched?"
            return (Suspicion("tracker moved", text), *_drifts(drifts, arms))
        return (*(_jump(name, size, arms) for name, size in jumps.items()), *_drifts(drifts, arms))

    def _beyond(self, points_M: Mapping[str, Array], before: Mapping[str, Array]) -> dict[str, float]:
        away = {name: float(np.linalg.norm(point - before[name])) for name, point in points_M.items() if name in before}
        return {name: size for name, size in away.items() if size > self._limit_m}


def _jump(name: str, size: float, arms: Collection[str]) -> Suspicion:
    if name in arms:
        text = (
            f"arm {name}: its SMR at home moved by {size * 1e3:.2f} mm since the last time: check that it sits firmly"
        )
        return Suspicion("loose SMR", text, name)
    return Suspicion("loose SMR", f"nest {name} moved by {size * 1e3:.2f} mm since the last time: check it")


def _drifts(drifts: Mapping[str, float], arms: Collection[str]) -> tuple[Suspicion, ...]:
    if not drifts:
        return ()
    arm = next(iter(drifts)) if len(drifts) == 1 and next(iter(drifts)) in arms else None
    text = f"{', '.join(sorted(drifts))}: drifted by {_largest_mm(drifts)} since the first time: check warm-up and air"
    return (Suspicion("drift", text, arm),)


def _largest_mm(sizes: Mapping[str, float]) -> str:
    return f"{max(sizes.values()) * 1e3:.2f} mm"
