"""A second check of a complete plan by the gate (every stop, every motion, the tracker's view), and its forecast."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from cellapp.cell.planning.candidates import joint_ranges
from cellapp.cell.planning.planned_stops import (
    Configuration,
    PlannedStops,
    last_motions,
    orders,
    planned_time,
    read_planned_stops,
    refused_route,
    routes,
    stop_times_of,
    without_reserves,
)
from cellapp.cell.planning.records import ArmForecast, JointCoverage, PlanCheckResult, PlanForecastResult, PlanRefusal
from cellapp.cell.run import RunFile
from cellapp.cell.safety.bodies import (
    AZIMUTH,
    ELEVATION,
    FACING,
    RANGE,
    Sight,
    TrackerField,
    beam_clearance,
    mounted_hides,
    place,
    sight_conditions,
    sight_of,
    usable_acceptance,
)
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies, refuse_motion, refuse_stop, visible
from cellapp.cell.safety.shapes import beam_gaps
from cellapp.estimation.calibration.calibrate import rms_length_mm
from cellapp.estimation.calibration.parameters import EXPECTED_SCATTER_M
from cellapp.estimation.discovery.plan_forecast import (
    expected_readings,
    planned_accuracy,
    planned_data,
    planned_effects,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.transforms import Array

_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def check_plan_run(run: RunFile, job: JobToken = UNATTENDED) -> PlanCheckResult:
    """Check the plan of a run; nothing is written.

    Raises
    ------
    InputError
        If the run has no plan.
    Cancelled
    """
    stops = required_plan(run)
    refused = check_stops(run.profile, stops, job)
    return PlanCheckResult(run=str(run.folder), stops=len(stops), ways=len(stops) + 1, refused=refused)


def check_stops(profile: Profile, stops: PlannedStops, job: JobToken = UNATTENDED) -> tuple[PlanRefusal, ...]:
    """List what the gate or the tracker's view refuses of a plan, from home through all stops and home again.

    Raises
    ------
    InputError
        If the profile does not describe the cell.
    Cancelled
    """
    cell, homes, count = cell_bodies(profile), home_positions(profile), len(stops)
    refused: list[PlanRefusal] = []
    here: Configuration = homes
    for k in range(count):
        job.check()
        if k % _PROGRESS_EVERY == 0:
            job.tell("check", k, count)
        there = stops.targets(k)
        refused += _stop_refusals(cell, k, there)
        refused += _way_refusals(cell, stops, k, here, homes)
        here = there
    reason = refuse_motion(cell, here, homes)
    if reason:
        via_home = any(not refused_route(cell, here, route) for route in orders(homes))
        refused.append(PlanRefusal(configuration=None, before=count - 1, what="way", reason=reason, via_home=via_home))
    job.tell("check", count, count, "done")
    return tuple(refused)


def check_each_stop(profile: Profile, stops: PlannedStops) -> tuple[PlanRefusal, ...]:
    """List what the gate or the tracker's view refuses of each stop and its last motion, whatever the order.

    Raises ``InputError`` if the profile does not describe the cell.
    """
    cell = cell_bodies(profile)
    refused: list[PlanRefusal] = []
    for k in range(len(stops)):
        refused += _stop_refusals(cell, k, stops.targets(k))
        begin = {**stops.targets(k), **stops.approach_starts(k)}
        reason = refuse_motion(cell, begin, begin) or refuse_motion(cell, begin, stops.targets(k))
        if reason and stops.approach_starts(k):
            text = f"its last motion: {reason}"
            refused.append(PlanRefusal(configuration=k, before=None, what="way", reason=text))
    return tuple(refused)


def required_plan(run: RunFile) -> PlannedStops:
    """Read the plan of a run. Raise ``InputError`` if there is none."""
    stops = read_planned_stops(run)
    if not len(stops):
        raise InputError(
            f"{run.path}: the run has no plan (its readings were imported); make one with"
            " 'cellapp plan PROFILE --run NEW'"
        )
    return stops


def _stop_refusals(cell: CellBodies, k: int, q: Configuration) -> Iterator[PlanRefusal]:
    before = k - 1 if k else None
    if reason := refuse_stop(cell, q):
        yield PlanRefusal(configuration=k, before=before, what="stop", reason=reason)
    if reason := why_hidden(cell, q):
        yield PlanRefusal(configuration=k, before=before, what="view", reason=reason)


def _way_refusals(
    cell: CellBodies, stops: PlannedStops, k: int, here: Configuration, homes: Configuration
) -> Iterator[PlanRefusal]:
    """Yield the refusal of the planned motion to a stop, with the detour that collection would take, if any."""
    planned, *others = routes(stops, k, as_planned=True)
    reason = refused_route(cell, here, planned)
    if not reason or refuse_stop(cell, stops.targets(k)):
        return
    before = k - 1 if k else None
    refusal = PlanRefusal(configuration=k, before=before, what="way", reason=reason)
    detour = next((route for route in others if not refused_route(cell, here, route)), None)
    if detour is not None:
        word = "straight" if len(detour[0]) == len(stops.q) else "one arm after the other"
        yield refusal.model_copy(update={"detour": word})
        return
    from_home = any(not refused_route(cell, homes, route) for route in routes(stops, k, as_planned=k == 0))
    via_home = from_home and any(not refused_route(cell, here, route) for route in orders(homes))
    yield refusal.model_copy(update={"via_home": via_home})


# -- How much of the range of each joint a plan uses ------------------------------------------------------------------


def joint_coverage(ranges: Array, q: Array) -> tuple[JointCoverage, ...]:
    """Compute what configurations ``q`` (n, N) [rad] use of the ``ranges`` (N, 2) [rad], and the largest gaps."""
    within = np.clip(q, ranges[:, 0], ranges[:, 1])
    sorted_q = np.sort(np.concatenate([ranges.T, within]), axis=0)
    gaps = np.diff(sorted_q, axis=0).max(axis=0)
    return tuple(
        JointCoverage(
            joint=j + 1,
            allowed=(float(ranges[j, 0]), float(ranges[j, 1])),
            used=(float(within[:, j].min()), float(within[:, j].max())),
            largest_gap=float(gaps[j]),
        )
        for j in range(q.shape[1])
    )


# -- Forecast of a run's plan before it is measured: time, covered joint ranges, accuracy, visible effects ------------


def forecast_run(run: RunFile, job: JobToken = UNATTENDED) -> PlanForecastResult:
    """Forecast what the plan of a run will give; nothing is written.

    Raises
    ------
    InputError
        If the run has no plan, or the profile does not describe the cell.
    Cancelled
    """
    profile, plan = run.profile, required_plan(run)
    visited = without_reserves(profile, plan)
    if not len(visited):
        raise InputError(f"{run.path}: the plan has reserve stops only")
    times = stop_times_of(profile, visited)
    expected = expected_readings(
        profile,
        visited.q,
        time_s=times.measured_s,
        dwell_s=times.resting_s,
        step=last_motions(visited, home_positions(profile)),
        load=visited.load,
    )
    cell = cell_bodies(profile)
    arms: dict[str, ArmForecast] = {}
    notes: list[str] = []
    for number, (name, arm) in enumerate(expected.items()):
        data = planned_data(arm)
        job.check()
        job.tell("forecast", number, len(expected), f"arm {name}")
        try:
            with one_blas_thread():  # the matrices are small
                effects = planned_effects(data)
        except InputError as error:
            effects = ()
            notes.append(f"arm '{name}': {error}")
        assert data.stated is not None
        arms[name] = ArmForecast(
            stops=len(visited),
            reserves=len(plan) - len(visited),
            noise_rms_mm=rms_length_mm(data.stated),
            coverage=joint_coverage(joint_ranges(cell, profile, name), visited.q[name]),
            accuracy=tuple(planned_accuracy(data, scatter) for scatter in (0.0, EXPECTED_SCATTER_M)),
            effects=effects,
        )
    job.tell("forecast", len(expected), len(expected), "done")
    notes += [
        f"arm {name}: smr.offset is unknown; an offset of some centimetres beside the last axis was assumed"
        for name, arm in profile.arms.items()
        if arm.smr.offset == "unknown"
    ]
    return PlanForecastResult(run=str(run.folder), time=planned_time(profile, visited), arms=arms, notes=tuple(notes))


# -- Reasons why the tracker does not see an SMR, in words ------------------------------------------------------------


def why_hidden(cell: CellBodies, q: Mapping[str, Array]) -> str:
    """Return why the tracker does not see the SMRs of all arms at one stop, arm -> q (N,) [rad]; empty if it does.

    For each arm whose SMR is not seen: the first condition that fails, the actual value and the allowed one.
    """
    hidden = []
    for name in q:
        others = {other: value[np.newaxis] for other, value in q.items() if other != name}
        if not visible(cell, name, q[name][np.newaxis], others)[0]:
            hidden.append(f"arm {name}: {next(_reasons(cell, name, q), 'the tracker does not see its SMR')}")
    return "; ".join(hidden)


def _reasons(cell: CellBodies, name: str, q: Mapping[str, Array]) -> Iterator[str]:
    """Yield what hides the SMR of an arm, one reason after the other."""
    field = cell.field
    if field is None:
        yield "the cell has no tracker"
        return
    placed = {other: place(cell.arms[other], value[np.newaxis]) for other, value in q.items()}
    sight = sight_of(field.T_C_M, placed[name])
    for condition, holds in sight_conditions(field, cell.arms[name].acceptance, sight):
        if not holds[0]:
            yield _out_of_sight(condition, field, sight, cell.arms[name].acceptance)
    tracker, smr = field.T_C_M[:3, 3], placed[name].smr
    for other, bodies in placed.items():
        gap = float(beam_clearance(tracker, smr, bodies, own=other == name)[0])
        if not gap > BEAM_RADIUS:
            yield f"{'its own body' if other == name else f'arm {other}'} is {_in_the_beam(gap)}"
    if mounted_hides(tracker, placed[name], BEAM_RADIUS)[0]:
        yield "what is mounted beside the SMR hides it from the tracker"
    for obstacle in cell.obstacles:
        gap = float(beam_gaps((obstacle,), tracker, smr, BEAM_RADIUS)[0])
        if not gap > BEAM_RADIUS:
            yield f"obstacle '{obstacle.name}' is {_in_the_beam(gap)}"


def _in_the_beam(gap: float) -> str:
    if gap <= 0.0:
        return "in the beam to its SMR"
    return f"{1e3 * gap:.0f} mm from the beam to its SMR, {1e3 * BEAM_RADIUS:.0f} mm are needed"


def _out_of_sight(condition: str, field: TrackerField, sight: Sight, acceptance: float) -> str:
    """Compare the actual value with the allowed one, for a condition that the only SMR of ``sight`` does not meet."""
    if condition == RANGE:
        low, high = field.distance
        return f"its SMR is {sight.distance[0]:.2f} m from the tracker, allowed are {low:.4g} to {high:.4g} m"
    if condition == FACING:
        rotated, allowed = np.degrees([sight.incidence[0], usable_acceptance(acceptance)])
        return f"its SMR looks {rotated:.1f} deg past the tracker, allowed are {allowed:.1f} deg"
    seen, limits = {
        AZIMUTH: (sight.azimuth[0], field.azimuth),
        ELEVATION: (math.asin(min(max(sight.sine_of_elevation[0], -1.0), 1.0)), field.elevation),
    }[condition]
    low, high = np.degrees(limits)
    return f"its SMR is at {condition} {math.degrees(seen):.1f} deg, allowed are {low:.4g} to {high:.4g} deg"
