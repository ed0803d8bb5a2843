"""Calibrate from readings: identify the arms, train residual networks, find the inter-base transform, evaluate all on
held-out readings.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.identification import (
    Identification,
    identify,
    identify_with_excess,
    refused_by_arm,
    robust_loss,
    start_from_nominal,
)
from cellapp.estimation.calibration.least_squares import NORMAL_95, usual_scatter
from cellapp.estimation.calibration.network_training import (
    Training,
    learn,
    learning_steps,
    require_learner,
    train_network,
    training_steps,
)
from cellapp.estimation.calibration.pair_calibration import PairCalibration, calibrate_pair, common_stops
from cellapp.estimation.calibration.parameters import unknown_offset
from cellapp.estimation.calibration.quantities import (
    FEWEST_ROTATIONS,
    SUSPECT_RAD,
    Quantities,
    evaluate_quantities,
    measured_orientations,
    measured_quantities,
    refuse_odd_orientations,
    repeatability,
    rotation_scatter,
    states_nothing,
    with_probe,
)
from cellapp.estimation.calibration.records import ArmPriorResult, ClockResult, MotionResult, Repeatability
from cellapp.estimation.calibration.station_location import wrong_factory
from cellapp.estimation.readings import SPLITS, Readings, stated_uncertainty
from cellapp.estimation.readings.readings import FIRST_SAMPLE, first_stops, neighbours_words
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, UNTOLD, JobSteps, JobToken, SharedProgress
from cellapp.ground.results import Provenance, Stage, StageErrors
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.effects.registry import program_of
from cellapp.robot.kinematics.chain import TOOL_NAMES, Geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, apply, register, rms_length
from cellapp.robot.model import ArmModel, CellModel, ResidualNetwork
from cellapp.robot.model.nominal import nominal_arm, prior_sigmas

# Detection of gross errors: a broken beam, a wrong SMR, a disturbed arm, swapped rows. They are left out and reported.
#
# A reading has a gross error if its residual is longer than ``_MOST`` times a typical length. This is taken from the
# median length, which a few gross errors do not move. Noise with heavy tails, or a local error of an arm, stays below.

_MOST = 10.0
"""Length of a gross error, in standard deviations of a coordinate. Of Student's t with 4 degrees of freedom one reading
in several thousand is beyond; of a normal distribution none."""
_LEAST_TYPICAL_M = 5e-5
"""Length below which a residual is no gross error [m], however small the typical one."""
_LEAST_READINGS = 40
"""Number of readings from which they are judged: with fewer, some 30 parameters of geometry leave most residuals far
below the noise, and an effect that the model lacks looks like a gross error."""
_LARGEST_SHARE = 0.08
"""Share of readings above which long residuals are no gross errors but an effect that acts on some stops only. With 5 %
of gross errors, parts of the readings may hold some more by chance; these must still be found."""
_PLAINLY_NONE = 4.0
"""Ratio of the longest residual to the median one up to which a least-squares fit of enough readings hides no gross
error: of a normal distribution one in a million is longer. Measured series of clean readings reach 3.7."""
_ENOUGH_FITTED = 100
"""Number of fitted readings from which none has the leverage to hide its own error: it would have to determine nine
tenths of its own residual."""
ROUNDS = 3
"""Maximum number of searches: gross errors that the first ones hid show in the next."""
_MOST_LISTED = 8
"""Number of configurations with gross errors that a sentence lists; more are counted."""


def gross_errors(residual_M: Array, angular: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Return a mask (n,) of the residuals (n, 3) [m] that are gross errors; all False if there are few readings.

    Orientations, masked by ``angular`` (n,), are judged separately [rad].
    """
    if angular is not None:
        wrong = np.zeros(len(residual_M), dtype=np.bool_)
        for rows in (angular, ~angular):
            wrong[rows] = gross_errors(residual_M[rows])
        return wrong
    lengths = np.linalg.norm(residual_M, axis=1)
    if len(lengths) < _LEAST_READINGS:
        return np.zeros(len(lengths), dtype=np.bool_)
    wrong = np.asarray(lengths > max(_MOST * usual_scatter(lengths, 0.0), _LEAST_TYPICAL_M))
    return wrong if wrong.mean() <= _LARGEST_SHARE else np.zeros_like(wrong)


def gross_errors_of_geometry(
    start: Geometry, nominal: Geometry, readings: Readings, fitted: int = 0
) -> NDArray[np.bool_]:
    """Return a mask (n,) of the readings that are gross errors by a robust fit, which gives them no weight.

    Parameters
    ----------
    start : Geometry
        Start of the identification; ``nominal`` is used if that fits most readings better.
    nominal : Geometry
        Mean of the priors.
    readings : Readings
    fitted : int
        Number of readings that ``start`` was fitted to by least squares. If there are enough, clean readings need no
        further fit. 0 if ``start`` may hide gross errors.
    """
    none, its = np.zeros(len(readings), dtype=np.bool_), measured_quantities(readings)
    q, p_M, angular = its.readings.q, its.readings.p_M, its.angular
    if len(q) < _LEAST_READINGS:
        return none

    def lengths(geometry: Geometry) -> list[Array]:
        """Compute the lengths of the residuals of positions, and of orientations."""
        found = np.linalg.norm(its.off(geometry), axis=1)
        return [found] if angular is None else [found[~angular], found[angular]]

    if fitted >= _ENOUGH_FITTED:
        clean = (one.max() <= _PLAINLY_NONE * float(np.median(one)) for one in lengths(start))
        if all(clean):
            return none
    # A few readings that are wrong by a metre can pull a least-squares fit further off than the published geometry is.
    begin = min((start, nominal), key=lambda one: float(np.median(lengths(one)[0])))
    offset = unknown_offset(nominal, q, its.R_M_S)
    found = identify(
        begin, q, p_M, R_M_S=its.R_M_S, prior_sigma=offset, prior_mean=nominal, robust="tukey", tolerance=1e-6
    )
    found = found.settled("robust fit that finds gross errors")
    return its.readings_with(gross_errors(its.off(found.geometry), angular))


def gross_errors_of_model(model: ArmModel, its: Quantities) -> NDArray[np.bool_]:
    """Return a mask (n,) of the readings whose position or orientation is a gross error by a model."""
    return its.readings_with(gross_errors(its.residuals(model), its.angular))


def without(readings: Readings, configurations: Sequence[int]) -> Readings:
    """Return the readings of one arm without those at some configurations."""
    if not configurations:
        return readings
    return readings.take(~np.isin(readings.configuration, configurations))


def left_out_words(configurations: Sequence[int]) -> str:
    """Say how many readings were left out, and which: samples of recordings have no number that a person knows."""
    count = len(configurations)
    stops = [one for one in configurations if one < FIRST_SAMPLE]
    named = ", ".join(map(str, stops[:_MOST_LISTED])) + (", ..." if len(stops) > _MOST_LISTED else "")
    places = [f"configuration{'s' if len(stops) > 1 else ''} {named}"] if stops else []
    places += [f"{counted(count - len(stops), 'sample')} of recordings"] if count > len(stops) else []
    what = "1 reading with a gross error was" if count == 1 else f"{count} readings with gross errors were"
    return f"{what} left out ({', '.join(places)})"


# -- Random assignment of stops to identification, training and validation, reproducible by the profile's seed --------


_FEWEST_DIFFERENT = 4
"""Least number of different configurations to begin an identification with."""


@dataclass(frozen=True)
class SplitSizes:
    """Number of stops in each split; ``notes`` report if there are fewer stops than the profile requires."""

    identify: int
    train: int
    validate: int
    notes: tuple[str, ...]


def split_sizes(n: int, identify: int, train: int, validate: int | None) -> SplitSizes:
    """Compute split sizes of ``n`` stops; ``validate`` None takes the rest. Too few stops reduce all in proportion."""
    wanted = max(1, n // 5) if validate is None else validate
    if identify + train + (1 if validate is None else validate) <= n:
        return SplitSizes(identify, train, n - identify - train if validate is None else validate, ())
    share = n / (identify + train + wanted)
    less_identify = max(1, int(identify * share))
    less_train = min(int(train * share), n - less_identify - 1)
    less_validate = n - less_identify - less_train
    note = (
        f"{counted(n, 'stop is', 'stops are')} too few for identify {identify}, train {train}, validate"
        f" {validate or 'rest'}: used {less_identify}, {less_train}, {less_validate} instead"
    )
    return SplitSizes(less_identify, less_train, less_validate, (note,))


def planned_splits(profile: Profile, stops: int | None = None) -> SplitSizes:
    """Compute the split sizes of a plan with this number of ``stops``, that of the profile if None.

    Raise ``InputError`` if they are too few for any calibration.
    """
    splits, n = profile.splits, profile.plan.stops if stops is None else stops
    sizes = split_sizes(n, splits.identify, splits.train, _held_out(profile))
    require_enough(f"plan.stops: {counted(n, 'stop leaves', 'stops leave')}", sizes.identify, sizes.validate)
    return sizes


def require_enough(stops_leave: str, different: int, held_out: int) -> None:
    """Raise ``InputError`` if there are too few ``different`` configurations to identify, or ``held_out`` readings."""
    if different < _FEWEST_DIFFERENT or held_out < 1:
        raise InputError(
            f"{stops_leave} {counted(different, 'different configuration')} to identify and {max(held_out, 0)} to"
            f" validate; at least {_FEWEST_DIFFERENT} and 1 are needed to begin with: measure more configurations"
        )


def refuse_too_few(name: str, readings: Readings) -> None:
    """Raise ``InputError`` if the splits leave an arm too few readings to identify or to validate."""
    different = len(np.unique(readings.q[readings.in_split("identify")].round(6), axis=0))
    leave = f"arm '{name}': {counted(len(readings), 'reading leaves', 'readings leave')}"
    require_enough(leave, different, len(readings.in_split("validate")))


def _held_out(profile: Profile) -> int | None:
    return None if profile.splits.validate_ == "rest" else profile.splits.validate_


def sample_splits(
    configurations: NDArray[np.int64],
    identify: int,
    train: int,
    validate: int | None,
    seed: int,
    first: Mapping[int, int] = MappingProxyType({}),
) -> tuple[dict[int, str | None], tuple[str, ...]]:
    """Sample a split for each configuration number; stops beyond the required ones get None. Return splits and notes.

    The sample depends on the set of numbers and the seed, not on the order of ``configurations``. Stops that are not to
    be divided have the same ``first`` one among them, which is sampled for all.
    """
    numbers = np.unique(configurations)
    sizes = split_sizes(len(numbers), identify, train, validate)
    order = np.random.default_rng([seed, 0x5EED]).permutation(numbers)
    words = ["identify"] * sizes.identify + ["train"] * sizes.train + ["validate"] * sizes.validate
    together = grouped((first.get(number, number), number) for number in numbers.tolist())
    sampled: dict[int, str | None] = {}
    for stops in (together[number] for number in order.tolist() if number in together):
        sampled |= dict.fromkeys(stops, words[len(sampled)] if len(sampled) < len(words) else None)
    return sampled, sizes.notes


# -- Detection of a tracker station or robot base that was moved during the run: this would invalidate every fit ------

_COARSE_TRIALS = 24
"""Number of split points that are tried first, evenly over the readings; then all points around the best one."""
_FEWEST = 6
"""Least number of readings before and after a split point: registration needs three, twice as many leave residuals."""
_RATIO = 3.0
"""Ratio of the rms residual of one registration to that of two from which a move is reported. Unmodelled geometry
leaves a ratio near 1."""
_LEAST_M = 2e-3
"""Rms residual of one station below which no move is searched for: smaller steps are drift, which discovery finds."""


def station_change(p_B: Array, p_M: Array) -> int | None:
    """Find the first row measured after the station was moved; None if it was not moved.

    Register the points before and after a split point separately. The station was moved at the split point with the
    smallest residual, if that is far smaller than the residual of one registration of all points.

    Parameters
    ----------
    p_B : array, shape (n, 3)
        SMR positions in the base frame by the nominal geometry [m], in the order of measurement.
    p_M : array, shape (n, 3)
        Measured SMR positions in the tracker frame [m].
    """
    n = len(p_B)
    if n < 2 * _FEWEST:
        return None
    together = _registration_rms(p_B, p_M)
    if together < _LEAST_M:
        return None

    def separate(k: int) -> float:
        before, after = _registration_rms(p_B[:k], p_M[:k]), _registration_rms(p_B[k:], p_M[k:])
        return float(np.sqrt((k * before**2 + (n - k) * after**2) / n))

    step = max(1, (n - 2 * _FEWEST) // _COARSE_TRIALS)
    row = min(range(_FEWEST, n - _FEWEST + 1, step), key=separate)
    row = min(range(max(_FEWEST, row - step), min(n - _FEWEST, row + step) + 1), key=separate)
    return row if together > _RATIO * separate(row) else None


def _registration_rms(p_B: Array, p_M: Array) -> float:
    """Compute the rms distance [m] of the points after registration."""
    return rms_length(p_M - apply(register(p_M, p_B), p_B))


_HARDLY_BETTER = 0.9
"""Ratio of held-out errors, identified to nominal, from which the operator is warned: the geometry is hardly better."""
_UNDETERMINED_MM = 1.0
"""Standard deviation of a probe's offset from which a note calls it undetermined: ten times that of a usual run."""
_OF_NOISE = 3.0
"""Multiple of the tracker's noise below which a held-out error does not suggest wrong readings."""


@dataclass(frozen=True)
class ArmCalibration:
    """One calibrated arm.

    Attributes
    ----------
    model : ArmModel
    identification : Identification
    excess_m : float
        Standard deviation of a coordinate beyond the stated uncertainty [m].
    validate : mapping
        Held-out errors by model stage.
    counts : mapping
        Number of readings in each split.
    repeatability : Repeatability or None
    tracker_mm, probe_mrad : float or None
        Rms length of the stated noise of positions [mm] and of orientations [mrad].
    training : Training or None
        How the residual network was trained.
    tracker_frame_network : ResidualNetwork or None
        The same network of an arm of a pair trained in the tracker frame, the counter-example of Bai et al. (2023).
    prior : ArmPriorResult or None
        The earlier calibration used as prior. Identification and model then include it, and there is no network.
    left_out : tuple of int
        Configurations of readings with gross errors. No parameter and no held-out error uses them.
    left_out_counts : mapping
        Number of readings left out of each split.
    clocks, motion
        Clocks by recording and results of the motion; None unless the arm was recorded in motion.
    """

    model: ArmModel
    identification: Identification
    excess_m: float
    validate: Mapping[Stage, StageErrors]
    counts: Mapping[str, int]
    repeatability: Repeatability | None
    tracker_mm: float | None
    probe_mrad: float | None = None
    training: Training | None = None
    tracker_frame_network: ResidualNetwork | None = None
    prior: ArmPriorResult | None = None
    left_out: tuple[int, ...] = ()
    left_out_counts: Mapping[str, int] = field(default_factory=dict)
    clocks: Mapping[str, ClockResult] | None = None
    motion: MotionResult | None = None


@dataclass(frozen=True)
class CellCalibration:
    """The calibrated cell: its model, every arm, the pair, and notes for the operator."""

    model: CellModel
    arms: Mapping[str, ArmCalibration]
    pair: PairCalibration | None
    notes: tuple[str, ...]
    provenance: Provenance


def calibrate_readings(
    profile: Profile,
    readings: Mapping[str, Readings],
    job: JobToken = UNATTENDED,
    *,
    known: Mapping[str, ArmCalibration] = MappingProxyType({}),
) -> CellCalibration:
    """Calibrate geometry, networks and pair from readings that have splits; arms in ``known`` are not identified again.

    Raises
    ------
    InputError
        If an arm has too few readings.
    Cancelled
        If the token says so.
    """
    notes: list[str] = []
    trains = profile.network.kind != "none"
    require_learner(profile.network)
    training = learning_steps(profile.network) + training_steps(1) * in_a_pair(profile) if trains else 0
    total = (1 + training) * len(readings) + 1
    arms: dict[str, ArmCalibration] = {}
    _refuse_exchanged_probes(profile, readings)
    for name, arm_readings in readings.items():
        job.tell("calibrate", len(arms), total, f"arm {name}: geometry")
        job.check()
        arms[name], arm_notes = (known[name], []) if name in known else calibrate_arm(profile, name, arm_readings)
        notes += arm_notes
    if trains:
        job.tell("calibrate", len(arms), total, "residual networks")
        with ThreadPoolExecutor(max_workers=2) as pool:  # matrix products release the interpreter lock
            shared = SharedProgress(job, "calibrate", len(arms), total)
            tasks = {
                name: pool.submit(train_arm, profile, arm, readings[name], shared.part(f"arm {name}"))
                for name, arm in arms.items()
                if arm.training is None
            }
            for name, task in tasks.items():
                arms[name] = task.result()
                notes += _network_notes(name, arms[name])
    job.tell("calibrate", total - 1, total, "pair")
    job.check()
    good = {name: without(its, arms[name].left_out) for name, its in readings.items()}
    models = {name: arm.model for name, arm in arms.items()}
    in_tracker = {name: arm.tracker_frame_network for name, arm in arms.items()}
    pair, pair_notes = calibrate_pair(profile, good, models, in_tracker)
    notes += pair_notes
    names = tuple(profile.arms)
    provenance = provenance_of(profile)
    model = CellModel(
        arms=models,
        T_R_L=None if pair is None else pair.T_R_L,
        pair=None if pair is None else (names[0], names[1]),
        provenance=provenance.model_dump(),
    )
    job.tell("calibrate", total, total, "done")
    return CellCalibration(model, arms, pair, tuple(notes), provenance)


def _refuse_exchanged_probes(profile: Profile, readings: Mapping[str, Readings]) -> None:
    """Raise ``InputError`` if what the probes of two arms measured follows the other arm each."""
    if len(readings) != 2:
        return
    stops = common_stops(*readings.values())
    seen = np.intersect1d(measured_orientations(stops[0])[0], measured_orientations(stops[1])[0])
    if len(seen) < FEWEST_ROTATIONS:
        return
    both = [one.take(seen) for one in stops]

    def scatter(points: Sequence[Readings], rotations: Sequence[Readings]) -> float:
        """Return how far the orientations of ``rotations`` are off the arms whose bases ``points`` give."""
        found = []
        for name, own, point, rotation in zip(readings, both, points, rotations, strict=True):
            unknown = profile.arms[name].smr.offset == "unknown"
            geometry = start_from_nominal(nominal_arm(profile.arms[name]), own.q, point.p_M, tool_unknown=unknown)
            found.append(rotation_scatter(geometry, own.q, measured_orientations(rotation)[1]))
        return max(found)

    if scatter(both, both) < SUSPECT_RAD:
        return
    exchanged = both[::-1]
    for what, points in {"orientations": both, "positions and orientations": exchanged}.items():
        if scatter(points, exchanged) < SUSPECT_RAD:
            first, second = readings
            raise InputError(
                f"the probes of arms '{first}' and '{second}' are exchanged: the {what} of each follow the other arm,"
                f" from configuration {both[0].configuration[0]} on; give each arm the {what} of its own probe, and"
                " import again"
            )


def provenance_of(profile: Profile) -> Provenance:
    """Return the provenance of a model that is made now."""
    return Provenance(
        profile=profile.name,
        seed=profile.seed,
        program=program_of(profile),
        python=platform.python_version(),
        numpy=np.__version__,
        written=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def missing_splits(
    profile: Profile, readings: Mapping[str, Readings]
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """Sample splits if no reading has one yet; return them with notes, both empty if some readings have a split."""
    if any(word is not None for arm in readings.values() for word in arm.split or ()):
        return {}, ()
    return profile_splits(profile, readings)


def profile_splits(
    profile: Profile, readings: Mapping[str, Readings]
) -> tuple[dict[str, tuple[str | None, ...]], tuple[str, ...]]:
    """Sample a split for each reading by the profile's seed, the same for all arms at a stop and for stops that are not
    to be divided (``undivided``); return splits and notes."""
    splits = profile.splits
    first, notes = first_stops(readings)
    held_out = _held_out(profile)
    sampled, sizes = sample_splits(np.array([*first]), splits.identify, splits.train, held_out, profile.seed, first)
    words = {name: tuple(sampled[number] for number in arm.configuration.tolist()) for name, arm in readings.items()}
    return words, (*sizes, *notes)


def calibrate_arm(profile: Profile, name: str, readings: Readings) -> tuple[ArmCalibration, list[str]]:
    """Identify one arm on its identify split and evaluate it on its validate split; return the calibration and notes.

    Gross errors are searched for in all readings and left out of everything, held-out errors included.
    """
    fitted = _fitted(profile, name, readings)
    for _ in range(ROUNDS):
        good, geometry = fitted.readings, fitted.identification.geometry
        wrong = gross_errors_of_geometry(geometry, fitted.nominal, good, len(good.in_split("identify")))
        if not wrong.any():
            break
        fitted = _fitted(profile, name, good.take(~wrong), robust=True)
    calibration = _evaluated(profile, name, readings, fitted)
    notes = _arm_notes(name, calibration, fitted)
    if misfit := wrong_factory(profile.arms[name], fitted.readings):
        notes.append(f"arm '{name}': {misfit}; no program, command or export is made of such a model")
    return calibration, notes


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Fit of one arm: the readings that were not left out, the start geometry, the identification, excess scatter."""

    readings: Readings
    nominal: Geometry
    identification: Identification
    excess_m: float


def _fitted(profile: Profile, name: str, readings: Readings, *, robust: bool = False) -> _Fitted:
    """Identify one arm on its identify split; with ``robust``, use robust weights even if the profile asks for none."""
    refuse_too_few(name, readings)
    arm, learn = profile.arms[name], readings.take(readings.in_split("identify"))
    nominal = start_from_nominal(nominal_arm(arm), learn.q, learn.p_M, tool_unknown=arm.smr.offset == "unknown")
    refuse_odd_orientations(name, nominal, readings)
    its = measured_quantities(learn)
    nominal = with_probe(nominal, its.readings.q, its.R_M_S)
    settings = profile.calibration
    with refused_by_arm(name):
        found, excess_m = identify_with_excess(
            nominal,
            its,
            parameter_set=settings.parameter_set,
            prior_sigma=prior_sigmas(nominal, settings.priors, arm.fixed),
            robust=robust_loss(settings, robust=robust),
            tool_unknown=arm.smr.offset == "unknown",
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
        )
    return _Fitted(readings, nominal, found, excess_m)


def _evaluated(profile: Profile, name: str, readings: Readings, fitted: _Fitted) -> ArmCalibration:
    """Compute the held-out errors of one fitted arm. ``readings`` include those that were left out."""
    good, nominal, identification = fitted.readings, fitted.nominal, fitted.identification
    held_out = good.take(good.in_split("validate"))
    known, covariance = identification.estimated.names, identification.estimated_covariance
    its = measured_quantities(held_out)
    geometries: dict[Stage, Geometry] = {"nominal": nominal, "geometry": identification.geometry}
    stages: dict[Stage, StageErrors] = {
        stage: evaluate_quantities(its, smr_positions(geometry, its.readings.q, its.R_M_S))
        for stage, geometry in geometries.items()
    }
    left_out = readings.take(~np.isin(readings.configuration, good.configuration))
    stated = stated_uncertainty(held_out)
    return ArmCalibration(
        model=ArmModel.of(profile, name, identification.geometry, nominal, known, covariance),
        identification=identification,
        excess_m=fitted.excess_m,
        validate=stages,
        counts={word: len(good.in_split(word)) for word in SPLITS},
        repeatability=repeatability(good.q, good.p_M),
        tracker_mm=None if stated is None else rms_length_mm(stated),
        probe_mrad=_probe_mrad(its),
        left_out=tuple(left_out.configuration.tolist()),
        left_out_counts={word: len(left_out.in_split(word)) for word in SPLITS} if len(left_out) else {},
    )


def _probe_mrad(its: Quantities) -> float | None:
    """Return the rms length [mrad] of the stated noise of orientations; None if none was measured or stated."""
    if its.angular is None or its.stated is None or states_nothing(its.stated[its.angular]):
        return None
    return rms_length_mm(its.stated[its.angular])


def _arm_notes(name: str, arm: ArmCalibration, fitted: _Fitted) -> list[str]:
    """Return the notes for the operator about one arm's calibration."""
    found, readings = arm.identification, fitted.readings
    notes = [left_out_note(name, arm)] if arm.left_out else []
    notes += [f"arm '{name}': {words}"] if (words := neighbours_words(readings)) else []
    notes += [*_hardly_better(name, arm), *_carried(name, fitted), *undetermined_offset(name, found)]
    moved = station_change(smr_positions(fitted.nominal.with_T_M_B(np.eye(4)), readings.q), readings.p_M)
    if moved is not None:
        notes.append(
            f"arm '{name}': the tracker or the base seems to have been moved before configuration"
            f" {readings.configuration[moved]}; import the two parts as runs of their own"
        )
    return notes


def _network_notes(name: str, arm: ArmCalibration) -> list[str]:
    """Say that a network does not help on held-out readings, although it did on left-out ones of the learnt."""
    if "network" not in arm.validate or arm.training is None:
        return []
    with_network, without = (arm.validate[stage].position_mm.rms for stage in ("network", "geometry"))
    if with_network < without:
        return []
    its = arm.training.result
    return [
        f"arm '{name}': the network is in force, as it predicts left-out configurations of the learnt ones better"
        f" ({its.left_out_rms_mm:.4f} mm rms, without it {its.without_rms_mm:.4f}), but not the held-out ones"
        f" ({with_network:.4f} mm rms, geometry {without:.4f}): '--network none' calibrates without it"
    ]


def left_out_note(name: str, arm: ArmCalibration) -> str:
    """Say which readings were left out, and how many of them are in the validate split."""
    held_out, left_out = arm.counts["validate"], arm.left_out_counts.get("validate", 0)
    return (
        f"arm '{name}': {left_out_words(arm.left_out)}; held-out errors are those of"
        f" {counted(held_out, 'reading')}, without"
        f" {left_out} of these: look at the rows, and measure these configurations again"
    )


def _hardly_better(name: str, arm: ArmCalibration) -> list[str]:
    """Warn if the identified geometry predicts hardly better than the nominal one and noise does not explain it."""
    nominal, found = arm.validate["nominal"].position_mm, arm.validate["geometry"].position_mm
    if found.mean < _HARDLY_BETTER * nominal.mean or found.mean < _OF_NOISE * (arm.tracker_mm or 0.0):
        return []
    return [
        f"arm '{name}': the identified geometry is hardly better than the nominal one (mean held-out error"
        f" {found.mean:.3f} mm, nominal {nominal.mean:.3f} mm): look for readings in other units, swapped rows, another"
        " arm type or SMR offset, and too few readings, before you use this calibration"
    ]


def _carried(name: str, fitted: _Fitted) -> list[str]:
    """Say how many parameters the readings determine, if there are few rows for them, or the flange hardly turned."""
    found, learn = fitted.identification, fitted.readings.take(fitted.readings.in_split("identify"))
    rows, names = len(np.unique(learn.q.round(6), axis=0)), found.estimated.names
    if rows >= len(names) and TOOL_NAMES[0] not in found.prior_sigma:
        return []
    variances = np.diag(found.estimated_covariance)[: len(names)]
    priors = np.array([found.prior_sigma.get(one, np.inf) for one in names]) ** 2
    rest = counted(int(np.count_nonzero(variances > 0.5 * priors)), "rests", "rest")
    return [
        f"arm '{name}': {counted(rows, 'different row')} to learn {len(names)} parameters: they determine"
        f" {len(found.parameter_set.names)} combinations, {rest} more on the prior than on the readings; measure more"
        " configurations"
    ]


def undetermined_offset(name: str, found: Identification) -> list[str]:
    """Warn if the offset of a probe or point is hardly determined along some direction of the flange, which then hardly
    turned."""
    places = [found.estimated.names.index(one) for one in TOOL_NAMES if one in found.estimated.names]
    if (found.angular is None and TOOL_NAMES[0] not in found.prior_sigma) or len(places) < len(TOOL_NAMES):
        return []
    variances, axes = np.linalg.eigh(found.estimated_covariance[np.ix_(places, places)])
    sd_mm = 1e3 * float(np.sqrt(variances[-1]))
    if sd_mm < _UNDETERMINED_MM:
        return []
    direction = axes[:, -1] * np.sign(axes[np.argmax(np.abs(axes[:, -1])), -1])
    words = ", ".join(f"{round(one, 2) + 0.0:.2f}" for one in direction.tolist())
    what, of = ("probe", "itself") if found.angular is not None else ("SMR", "with the flange rotated so")
    return [
        f"arm '{name}': the offset of the {what} along ({words}) of the flange is not determined (95 % within"
        f" +-{NORMAL_95 * sd_mm:.0f} mm), as that direction hardly rotated; positions of the {what} {of} are not"
        " affected, those of another tool are: measure with the wrist turned to more sides"
    ]


def train_arm(profile: Profile, arm: ArmCalibration, readings: Readings, steps: JobSteps = UNTOLD) -> ArmCalibration:
    """Train an arm's residual network in the base frame; for a pair the same in the tracker frame, for comparison.

    The training data are the train split, or the identify split if there is no train split.
    """
    readings = without(readings, arm.left_out)
    rows = readings.in_split("train")
    taught = readings.take(rows if len(rows) else readings.in_split("identify"))
    held_out = readings.take(readings.in_split("validate"))
    if len(taught) < 2 * profile.network.folds:
        return arm
    loaded = MeasurementConditions(approach=taught.approach, payload_kg=taught.payload_kg)
    residual_M = taught.p_M - arm.model.predict(taught.q, conditions=loaded)
    arm = with_networks(profile, arm, taught.q, residual_M, taught.time_s, steps)
    if arm.model.network is None:
        return arm
    done = learning_steps(profile.network)
    rotations = JobSteps(lambda _, words: steps(done, f"rotations: {words}"), steps.job)
    rotations_net = rotation_network(profile, arm.model, measured_quantities(taught), rotations)
    arm = replace(arm, model=replace(arm.model, network=replace(arm.model.network, rotation=rotations_net)))
    its = measured_quantities(held_out)
    return replace(arm, validate={**arm.validate, "network": evaluate_quantities(its, its.predicted(arm.model))})


def rotation_network(profile: Profile, model: ArmModel, taught: Quantities, steps: JobSteps) -> ResidualNetwork | None:
    """Train a network on the rotation vectors that a model leaves of measured orientations, in the base frame.

    None if there are too few, or it does not predict left-out ones better than none.
    """
    if taught.angular is None or np.count_nonzero(taught.angular) < 2 * profile.network.folds:
        return None
    some = taught.take(taught.angular)
    return network_of_residuals(profile, model, some.readings, -some.predicted(model), steps)


def network_of_residuals(
    profile: Profile, model: ArmModel, readings: Readings, residual_M: Array, steps: JobSteps
) -> ResidualNetwork | None:
    """Train a network on residuals ``residual_M`` (n, 3) [m, rad]; None if it predicts left-out ones no better."""
    residual_B = residual_M @ model.geometry.T_M_B()[:3, :3]
    return learn(profile.network, readings.q, residual_B, readings.time_s, seed=profile.seed, steps=steps).network


def with_networks(
    profile: Profile, arm: ArmCalibration, q: Array, residual_M: Array, time_s: Array, steps: JobSteps
) -> ArmCalibration:
    """Train networks on residuals ``residual_M`` (n, 3) [m] at ``q`` (n, N) [rad]: one in the base frame;
    for method 2 of a pair the same in the tracker frame; none if a network does not help."""
    residual_B, seed = residual_M @ arm.model.geometry.T_M_B()[:3, :3], profile.seed
    training = learn(profile.network, q, residual_B, time_s, seed=seed, steps=steps.after(0, "base frame"))
    if training.network is None:
        return replace(arm, training=training)
    arm = replace(arm, model=replace(arm.model, network=training.network), training=training)
    if not in_a_pair(profile):
        return arm
    # The same shape, not rotated with joint 1: the tracker frame has no relation to that axis.
    shape = replace(training.shape, rotates_with_joint_1=False)
    later = steps.after(learning_steps(profile.network), "tracker frame")
    in_tracker = train_network(profile.network, q, residual_M, seed, later, shapes=(shape,))
    return replace(arm, tracker_frame_network=in_tracker.network)


def in_a_pair(profile: Profile) -> bool:
    """Return whether there is a network in the tracker frame as well: only methods of the pair use it."""
    return len(profile.arms) > 1


def rms_length_mm(sigma: Array) -> float:
    """Compute the rms length [mm] of the stated noise from sigmas (n,) [m] or covariances (n, 3, 3) [m^2]."""
    squares = 3.0 * sigma**2 if sigma.ndim == 1 else np.trace(sigma, axis1=1, axis2=2)
    return float(np.sqrt(squares.mean())) * 1e3
