"""Tables of a calibration that only the page shows."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.commands.calibrate.view import batches_words
from cellapp.commands.view.table import Cell, Number, Table, table_of_cells
from cellapp.commands.view.words import METHOD_WORDS, geometry_unit
from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult, NetworkResult
from cellapp.ground.results import METHODS


def pair_tables(calibrate: CalibrateResult) -> list[Table]:
    """Show the inter-base transform that each method identified, beside its value from the common tracker frame."""
    numbers = ("by distances", ".5f"), ("standard error", ".5f"), ("by the tracker frame", ".5f")
    tables = []
    for method in METHODS:
        if method not in calibrate.pair or not calibrate.pair[method].identified:
            continue
        rows = list[tuple[Cell, ...]]()
        for name, estimate in calibrate.pair[method].identified.items():
            factor, unit = geometry_unit(estimate.unit)
            values = (estimate.value, estimate.standard_error, estimate.by_tracker)
            rows.append((name, *(None if value is None else value * factor for value in values), unit))
        first, second = calibrate.arms
        title = f"Pair: base of {first} in the base of {second}, with {METHOD_WORDS[method]}"
        tables.append(table_of_cells(title, rows, "parameter", *numbers, "unit"))
    return tables


def calibration_facts(calibrate: CalibrateResult) -> Table:
    """Show figures of the identification and of the network's training, one column for each arm."""
    facts = [_arm_facts(arm) for arm in calibrate.arms.values()]
    every = dict.fromkeys(what for arm in facts for what in arm)
    rows = ((what, *(arm.get(what) for arm in facts)) for what in every)
    return table_of_cells("Identification and network training", rows, "", *(f"arm {name}" for name in calibrate.arms))


def _arm_facts(arm: ArmCalibrationResult) -> Mapping[str, Cell]:
    repeats, network = arm.repeatability_mm, arm.network
    facts: dict[str, Cell] = {
        "parameters identified": arm.rank,
        "iterations": arm.iterations,
        "condition number of the scaled Jacobian": None if arm.condition is None else Number(arm.condition, 1),
        "stated uncertainty of the tracker, rms length [mm]": (
            Number(arm.tracker_mm, 4) if arm.tracker_mm else "not stated"
        ),
        "scatter of a coordinate beyond it [mm]": None if arm.excess_mm is None else Number(arm.excess_mm, 4),
        **({} if arm.excess_mrad is None else {"scatter of an orientation [mrad]": Number(arm.excess_mrad, 4)}),
        "position repeatability, mean and RP [mm]": (
            "no stop was repeated" if repeats is None else f"{repeats.mean:.4f}, {repeats.rp:.4f}"
        ),
        "network": "none trained" if network is None else _network_words(network),
    }
    if network is not None:
        left_out = f"{network.left_out_rms_mm:.4f}, without a network {network.without_rms_mm:.4f}"
        facts["network, rms on left-out folds [mm]"] = left_out
        if network.batches is not None:
            facts["network from all readings"] = batches_words(network.batches)
    return facts


def _network_words(network: NetworkResult) -> str:
    inputs = {"sincos": "sines and cosines", "angles": "scaled angles", "both": "angles, sines and cosines"}
    layers, turning = " + ".join(map(str, network.hidden)), ", rotating with joint 1" if network.turning else ""
    used = "used" if network.used else "not used: it did not reduce the error on left-out folds"
    return f"{inputs[network.inputs]}, {layers}{turning}; {used}"
