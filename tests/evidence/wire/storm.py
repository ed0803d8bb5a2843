"""A storm of faults on the wire: the real collecting program, emulated devices, and a person who repairs and resumes.

Nothing here needs hardware. Controllers and tracker are emulated in a process of their own; ``cellapp collect`` runs as
a separate program, is killed and interrupted, and is resumed until every stop is measured or listed.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.planned_stops import PlannedStops, read_planned_stops, write_planned_stops
from cellapp.cell.run import Outcome, RunFile
from cellapp.cell.run.measured_again import missing_readings
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.results import Record, Result
from tests.evidence.wire.storm_cell import emulated_cell, undisturbed_profile, wire_profile
from tests.evidence.wire.storm_faults import KILL, sampled_events
from tests.evidence.wire.storm_operator import Operator, StormLog, stored

PACE = 50.0
"""Seconds of the cell for each second: the driver's own waits and the wire's cycles then take most of the time."""
_LARGEST_SIGMAS = 6.0
"""Largest deviation of a point from the undisturbed run, in standard deviations of the difference."""
SAME_RAD = 1e-6


class StormDeviation(Record):
    """Deviation of an arm's readings from those of the undisturbed run: joints, points, and points over their noise."""

    n: int
    joints_max_rad: float
    position_rms_mm: float
    position_max_mm: float
    max_sigmas: float


class StormResult(Result, schema="cellapp-trials-storm"):
    """the program storm: what became of the planned stops, and what did not happen as specified (``complaints``).

    Attributes
    ----------
    stops, readings : int
        Planned stops, and stored readings.
    missing : tuple of Outcome
        Planned readings that the run lacks, each with its reason.
    lost, doubled : int
        Readings that were seen as stored and are gone or changed; readings stored twice or from one measurement.
    sessions, faults, kills : int
        Starts of the program; faults caused, and SIGKILLs of the program.
    by_fault, exit_codes : mapping
        How often each was caused, and how the sessions ended.
    motions_after_a_stop : int
        Motions that began after a stop, before the person resumed.
    latest_start_ms : float
        Longest time from the first stop that a controller received to the start of a motion of another arm that had
        been commanded before; that arm was braked too.
    clearance_mm : float or None
        Smallest distance between the arms.
    deviation : mapping
        Arm -> deviation from the undisturbed run.
    seconds : float
        Duration of the storm.
    """

    stops: int
    readings: int
    missing: tuple[Outcome, ...]
    lost: int
    doubled: int
    sessions: int
    faults: int
    kills: int
    by_fault: Mapping[str, int]
    exit_codes: Mapping[str, int]
    motions_after_a_stop: int
    latest_start_ms: float
    clearance_mm: float | None
    deviation: Mapping[str, StormDeviation]
    seconds: float
    complaints: tuple[str, ...]


def storm_trial(
    profile: Profile,
    stops: int = 400,
    faults: int = 200,
    kills: int = 50,
    seed: int = 0,
    pace: float = PACE,
    keep: Path | None = None,
    job: JobToken = UNATTENDED,
) -> StormResult:
    """Collect ``stops`` stops over the wire while ``faults`` faults of all kinds and ``kills`` SIGKILLs happen.

    ``keep`` is a new folder for the run, the undisturbed one, and what the programs printed; None: they are removed.

    Raises
    ------
    InputError
        If the profile's devices cannot be emulated on this computer, or ``keep`` exists.
    HardwareError
        If the emulated cell does not start, or cannot be repaired.
    Cancelled
    """
    if stops < 2:
        raise InputError("storm: at least 2 stops are needed")
    profile = wire_profile(profile, stops)
    random = np.random.default_rng(seed)
    events = sampled_events(stops, faults, kills, tuple(profile.arms), random)
    with _folder(keep) as parent:
        folder = parent / "run"
        with new_planned_run(profile, folder, job) as run:
            plan = read_planned_stops(run)
        job.tell("undisturbed run", 0, 1)
        quiet = undisturbed(profile, plan, parent / "undisturbed")
        job.tell("undisturbed run", 1, 1)
        began_s = time.monotonic()
        with (parent / "output.txt").open("wb") as output, emulated_cell(profile, pace) as cell:
            log = Operator(cell, folder, events, stops, output, job).work()
            clearance_m = cell.clearance_m()
        took_s = time.monotonic() - began_s
        job.tell("storm", stops, stops, "done")
        with RunFile.open(folder) as run, RunFile.open(quiet) as reference:
            return _judged(run, reference, log, len(events), clearance_m, took_s)


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="cellapp-storm-") as folder:
            yield Path(folder)
        return
    try:
        keep.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{keep}: cannot be made ({error.strerror}); give the path of a new folder") from error
    yield keep.absolute()


def undisturbed(profile: Profile, plan: PlannedStops, folder: Path) -> Path:
    """Collect the same plan in the same cell without a fault, in this process."""

    def fill(run: RunFile) -> None:
        write_planned_stops(run, plan)

    with RunFile.create(folder, undisturbed_profile(profile), fill) as run:
        collect_run(run)
    return folder


def _judged(
    run: RunFile, reference: RunFile, log: StormLog, drawn: int, clearance_m: float | None, took_s: float
) -> StormResult:
    """Compare the run with its plan, with what the person saw, and with the undisturbed run."""
    complaints = list(log.complaints)
    found = stored(run.folder)
    missing = missing_readings(run)
    lost = sum(found.get(key) != values for key, values in log.seen.items())
    measurements = {(name, values[-4:]) for (_, name), values in found.items()}
    doubled = len(found) - len(measurements)
    planned = {(stop, name) for name, q in run.read_plan().items() for stop in range(len(q))}
    listed = {(one.stop, one.arm) for one in missing if one.reason and one.kind != "not tried"}
    unexplained = planned - set(found) - listed
    deviations = {name: deviation(run, reference, name) for name in run.arms()}
    if unexplained:
        complaints.append(f"{len(unexplained)} planned readings are neither stored nor listed with a reason")
    if lost or doubled:
        complaints.append(f"{lost} readings were lost, {doubled} doubled")
    if clearance_m is None or clearance_m <= 0.0:
        complaints.append("the arms touched, or their distance was not observed")
    if sum(log.struck.values()) < drawn:
        complaints.append(f"only {sum(log.struck.values())} of {drawn} faults were caused before the run was complete")
    for name, one in deviations.items():
        if one.max_sigmas > _LARGEST_SIGMAS or one.joints_max_rad > SAME_RAD:
            complaints.append(
                f"arm {name}: a reading differs from the undisturbed run by {one.position_max_mm:.3f} mm,"
                f" {one.max_sigmas:.1f} standard deviations, {one.joints_max_rad:.1e} rad"
            )
    return StormResult(
        stops=len(planned) // max(len(run.read_plan()), 1),
        readings=len(found),
        missing=missing,
        lost=lost,
        doubled=doubled,
        sessions=log.sessions,
        faults=sum(count for kind, count in log.struck.items() if kind != KILL),
        kills=log.struck[KILL],
        by_fault=dict(sorted(log.struck.items())),
        exit_codes={str(code): count for code, count in sorted(log.exit_codes.items())},
        motions_after_a_stop=log.motions_after_a_stop,
        latest_start_ms=1e3 * log.latest_start_s,
        clearance_mm=None if clearance_m is None else 1e3 * clearance_m,
        deviation=deviations,
        seconds=took_s,
        complaints=tuple(complaints),
    )


def deviation(run: RunFile, reference: RunFile, name: str) -> StormDeviation:
    """Compare the readings of an arm at the stops that both runs have."""
    ours, theirs = run.readings(name), reference.readings(name)
    common, i, k = np.intersect1d(ours.configuration, theirs.configuration, return_indices=True)
    off = ours.p_M[i] - theirs.p_M[k]
    joints = np.abs(ours.q[i] - theirs.q[k])
    sigmas = np.zeros(len(common))
    if ours.covariance_M is not None and theirs.covariance_M is not None:
        spread = np.linalg.inv(ours.covariance_M[i] + theirs.covariance_M[k])
        sigmas = np.sqrt(np.einsum("ni,nij,nj->n", off, spread, off))
    distance_mm = 1e3 * np.linalg.norm(off, axis=1)
    return StormDeviation(
        n=len(common),
        joints_max_rad=float(joints.max(initial=0.0)),
        position_rms_mm=float(np.sqrt(np.mean(distance_mm**2))) if len(common) else 0.0,
        position_max_mm=float(distance_mm.max(initial=0.0)),
        max_sigmas=float(sigmas.max(initial=0.0)),
    )
