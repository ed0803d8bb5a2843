"""The real program collects over the wire from an emulated cell in a storm of faults of all kinds, and is killed at
random moments; a person repairs and resumes. Afterwards every reading is compared with an undisturbed run's."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellapp.cell.driving.collect import collect_run
from cellapp.cell.planning.planned_stops import PlannedStops, read_planned_stops, write_planned_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.measured_again import missing_readings
from cellapp.commands.plan.run import new_planned_run
from cellapp.ground.profile import Profile
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table
from tests.evidence.wire.storm_cell import emulated_cell, undisturbed_profile, wire_profile
from tests.evidence.wire.storm_faults import KILL, sampled_events
from tests.evidence.wire.storm_operator import Operator, StormLog, lost_and_doubled, stored
from tests.sure import sure

TITLE = "Storm on the wire"
ALONE = True
PACE = 50.0
"""Seconds of the cell for each second: the driver's own waits and the wire's cycles then take most of the time."""
_LARGEST_SIGMAS = 6.0
"""Largest deviation of a point from the undisturbed run, in standard deviations of the difference."""
SAME_RAD = 1e-6
OPTIONS = {"stops": 400, "faults": 200, "kills": 50, "seed": 1}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"storm": {key: getattr(asked, key) for key in OPTIONS}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Collect over the wire while faults of all kinds and SIGKILLs of the program happen; the judgement of the run."""
    stops = case["stops"]
    profile = wire_profile(load_profile(ROOT / "profiles" / "twin-rtde.yaml"), stops)
    random = np.random.default_rng(case["seed"])
    events = sampled_events(stops, case["faults"], case["kills"], tuple(profile.arms), random)
    with tempfile.TemporaryDirectory(prefix="cellapp-storm-") as name:
        folder = Path(name) / "run"
        with new_planned_run(profile, folder) as run:
            quiet = undisturbed(profile, read_planned_stops(run), folder.with_name("undisturbed"))
        began_s = time.monotonic()
        with folder.with_name("output.txt").open("wb") as output, emulated_cell(profile, PACE) as cell:
            log = Operator(cell, folder, events, output).work()
            clearance_m = cell.clearance_m()
        minutes = (time.monotonic() - began_s) / 60.0
        with RunFile.open(folder) as run, RunFile.open(quiet) as reference:
            return {"minutes": minutes, **_judged(run, reference, log, len(events), clearance_m)}


def undisturbed(profile: Profile, plan: PlannedStops, folder: Path) -> Path:
    """Collect the same plan in the same cell without a fault, in this process."""

    def fill(run: RunFile) -> None:
        write_planned_stops(run, plan)

    with RunFile.create(folder, undisturbed_profile(profile), fill) as run:
        collect_run(run)
    return folder


def _judged(run: RunFile, reference: RunFile, log: StormLog, drawn: int, clearance_m: float | None) -> dict[str, Any]:
    """Compare the run with its plan, with what the person saw, and with the undisturbed run."""
    complaints = list(log.complaints)
    found = stored(run.folder)
    missing = missing_readings(run)
    lost, doubled = lost_and_doubled(log.seen, found)
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
    if log.struck.total() < drawn:
        complaints.append(f"only {log.struck.total()} of {drawn} faults were caused before the run was complete")
    for name, one in deviations.items():
        if one.max_sigmas > _LARGEST_SIGMAS or one.joints_max_rad > SAME_RAD:
            complaints.append(
                f"arm {name}: a reading differs from the undisturbed run by {one.words()}, {one.joints_max_rad:.1e} rad"
            )
    kills, stops = log.struck[KILL], len(planned) // max(len(run.read_plan()), 1)
    rows = {
        "planned stops": f"{stops}",
        "readings stored; missing, with their reason": f"{len(found)}; {len(missing)}",
        "sessions; faults; kills": f"{log.sessions}; {log.struck.total() - kills}; {kills}",
        "longest from a stop to a motion of another arm, braked too": f"{1e3 * log.latest_start_s:.0f} ms",
        "smallest distance between the arms": "" if clearance_m is None else f"{1e3 * clearance_m:.0f} mm",
        **{f"arm {name}: largest deviation from the undisturbed run": its.words() for name, its in deviations.items()},
    }
    wrong = {"readings lost": lost, "readings doubled": doubled, "motions after a stop": log.motions_after_a_stop}
    return {"readings": len(found), "rows": rows, "wrong": wrong, "complaints": complaints}


@dataclass(frozen=True)
class Deviation:
    """Largest deviation of an arm's readings from an undisturbed run's: of joints, of points, over their noise."""

    joints_max_rad: float
    position_max_mm: float
    max_sigmas: float

    def words(self) -> str:
        return f"{self.position_max_mm:.3f} mm ({self.max_sigmas:.1f} standard deviations)"


def deviation(run: RunFile, reference: RunFile, name: str) -> Deviation:
    """Compare the readings of an arm at the stops that both runs have."""
    ours, theirs = run.readings(name), reference.readings(name)
    _, i, k = np.intersect1d(ours.configuration, theirs.configuration, return_indices=True)
    off = ours.p_M[i] - theirs.p_M[k]
    spread = np.linalg.inv(sure(ours.covariance_M)[i] + sure(theirs.covariance_M)[k])
    return Deviation(
        joints_max_rad=float(np.abs(ours.q[i] - theirs.q[k]).max(initial=0.0)),
        position_max_mm=float(1e3 * np.linalg.norm(off, axis=1).max(initial=0.0)),
        max_sigmas=float(np.sqrt(np.einsum("ni,nij,nj->n", off, spread, off)).max(initial=0.0)),
    )


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = results[0]
    rows: Mapping[str, str] = {**result["rows"], "duration": f"{result['minutes']:.0f} min"}
    limits = [Limit(what, count, 0) for what, count in result["wrong"].items()]
    limits.append(Limit("complaints", len(result["complaints"]), 0))
    table = Table("", ["what", "value"], [[what, value] for what, value in rows.items()])
    return Evidence({"readings": str(result["readings"])}, [table], limits, result["complaints"])
