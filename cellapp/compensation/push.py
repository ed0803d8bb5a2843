"""The verb: push compensated targets to the arms and, with verification, measure where the SMR really goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from cellapp.calibration.evaluation import Summary, summarise
from cellapp.collection.cell import Cell, open_cell
from cellapp.collection.motion import MotionRefused, Mover
from cellapp.compensation.compensate import Command, arriving
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from drivers.trackers.protocol import TrackerError

Way = Literal["nominal", "compensated"]


@dataclass(frozen=True)
class Verified:
    """One target as measured.

    Attributes
    ----------
    name, arm : str
    nominal_m, compensated_m : float or None
        Distance of the measured SMR from the target with either command [m]; None where it was not pushed or measured.
    note : str
        Why not; empty otherwise.
    """

    name: str
    arm: str
    nominal_m: float | None
    compensated_m: float | None
    note: str


@dataclass(frozen=True)
class Verification:
    """All targets, and errors by arm and command in mm."""

    targets: tuple[Verified, ...]
    summaries: Mapping[str, Mapping[Way, Summary]]

    def as_dict(self) -> dict[str, Any]:
        """The object that ``--json`` writes."""
        return {
            "schema": "cellapp-verify",
            "version": 1,
            "arms": {
                name: {f"{way}_mm": summary.as_dict() for way, summary in ways.items()}
                for name, ways in self.summaries.items()
            },
            "targets": [
                {
                    "name": target.name,
                    "arm": target.arm,
                    "nominal_mm": None if target.nominal_m is None else target.nominal_m * 1e3,
                    "compensated_mm": None if target.compensated_m is None else target.compensated_m * 1e3,
                    "note": target.note,
                }
                for target in self.targets
            ],
        }


def unverified(result: Mapping[str, Any]) -> list[str]:
    """Why a verification did not hold, arm by arm; empty if it did. From the object of ``push --verify --json``."""
    complaints = []
    for name in dict.fromkeys(target["arm"] for target in result["targets"]):
        ways = result["arms"].get(name)
        if ways is None:
            complaints.append(f"arm {name}: no target could be measured")
        elif ways["compensated_mm"]["mean"] >= ways["nominal_mm"]["mean"]:
            before, after = ways["nominal_mm"]["mean"], ways["compensated_mm"]["mean"]
            complaints.append(
                f"arm {name}: compensated targets were missed by {after:.3f} mm in the mean, uncompensated by"
                f" {before:.3f} mm; do not use this calibration"
            )
    return complaints


def push(
    profile: Profile,
    model: CellModel,
    commands: Sequence[Command],
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    verify: bool,
    opened: Callable[[Cell], object] = lambda cell: None,
) -> Verification:
    """Send every command to its arm, the other arms at home; with ``verify`` both ways and measured.

    ``opened`` is called with the open cell before anything moves; what it raises ends the job.

    Raises
    ------
    InputError
        If no target can be commanded at all.
    HardwareError
        If an arm or the tracker fails; all arms have been told to stop.
    Cancelled
    """
    cancel = cancel or CancelToken()
    if not any(command.q_compensated is not None for command in commands):
        raise InputError("push: none of the targets can be commanded: " + commands[0].refusal)
    bodies = cell_bodies(profile, model)
    homes = home_positions(profile)
    verified: list[Verified] = []
    ways: tuple[Way, ...] = ("nominal", "compensated") if verify else ("compensated",)
    with open_cell(profile) as cell:
        opened(cell)
        mover = Mover(profile, cell, bodies)
        mover.go_home()
        busy = ""
        for done, command in enumerate(commands):
            cancel.check()
            listener(Progress("push", done, len(commands), command.target.name))
            name = command.target.arm
            if busy and busy != name:
                mover.move({busy: homes[busy]})
            busy = name
            errors: dict[Way, float] = {}
            note = command.refusal
            for way in ways if not note else ():
                try:
                    off = _go_and_measure(mover, model.arms[name], command, way, homes[name], measure=verify)
                except (MotionRefused, TrackerError) as error:
                    note = str(error)
                    break
                if off is not None:
                    errors[way] = off
            verified.append(Verified(command.target.name, name, errors.get("nominal"), errors.get("compensated"), note))
        mover.go_home()
    listener(Progress("push", len(commands), len(commands), "done"))
    return Verification(tuple(verified), _summaries(verified))


def _go_and_measure(
    mover: Mover, arm: ArmModel, command: Command, way: Way, home: Array, *, measure: bool
) -> float | None:
    """Move to a target and, if wanted, measure its error [m]."""
    name = command.target.arm
    wanted = command.nominal_M if way == "nominal" else command.expected_M
    if wanted is None:
        return None

    def joints() -> Array:
        if way == "nominal":
            return np.asarray(command.q_nominal)
        return arriving(arm, np.asarray(command.q_compensated), mover.positions()[name])

    # straight, if the arm can go home from there too, so that it never strands; else by way of home and back
    if mover.refusal({name: joints()}, {name: home}):
        mover.move({name: home})
    states = mover.move({name: joints()})
    if not measure:
        return None
    return float(np.linalg.norm(mover.measure(name, states[name].q).p_M - wanted))


def _summaries(verified: Sequence[Verified]) -> dict[str, dict[Way, Summary]]:
    summaries: dict[str, dict[Way, Summary]] = {}
    for name in dict.fromkeys(target.arm for target in verified):
        both = [t for t in verified if t.arm == name and t.nominal_m is not None and t.compensated_m is not None]
        if both:
            summaries[name] = {
                "nominal": summarise(np.array([t.nominal_m for t in both])),
                "compensated": summarise(np.array([t.compensated_m for t in both])),
            }
    return summaries
