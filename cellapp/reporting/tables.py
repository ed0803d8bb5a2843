"""The accuracy tables of a run as plain data: CLI, TUI and the HTML page only draw them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from cellapp.reporting.findings import discovery_tables
from cellapp.reporting.table import Table

STAGES = ("nominal", "geometry", "network", "effects")
METHODS = ("nominal", "method_1", "method_2", "proposed", "effects")


def calibration_tables(result: Mapping[str, Any]) -> list[Table]:
    """Held-out errors by stage, one table an arm, and the pair's; from the object of ``calibrate --json``."""
    tables = []
    for name, arm in result["arms"].items():
        rows = []
        for stage in STAGES:
            if stage in arm["validate"]:
                for measure in ("position_mm", "distance_mm"):
                    if measure in arm["validate"][stage]:
                        rows.append((f"{stage}, {measure[:-3]}", *_numbers(arm["validate"][stage][measure])))
        title = f"Arm {name}: held-out errors [mm] ({arm['rank']} parameters, {arm['iterations']} iterations)"
        tables.append(Table(title, ("stage, measure", "mean", "rms", "std", "max", "n"), tuple(rows)))
    if result["pair"]:
        rows = [
            (method, *_numbers(result["pair"][method]["cooperative_mm"]))
            for method in METHODS
            if method in result["pair"]
        ]
        title = "Pair: held-out cooperative errors [mm]"
        tables.append(Table(title, ("method", "mean", "rms", "std", "max", "n"), tuple(rows)))
    return tables


def detailed_tables(result: Mapping[str, Any]) -> list[Table]:
    """``calibration_tables`` for where there is room: with percentiles, the 95 % interval of each mean and the tracker.

    The last column is how many times the root mean square is what the tracker's stated uncertainty alone would leave.
    """
    columns = ("mean", "95 % of mean", "rms", "std", "p50", "p95", "max", "n", "rms / tracker")
    known = {name: arm.get("tracker_mm") for name, arm in result["arms"].items()}
    tables = []
    for table, (name, arm) in zip(calibration_tables(result), result["arms"].items(), strict=False):
        rows = []
        for stage in STAGES:
            for measure, summary in arm["validate"].get(stage, {}).items():
                # the distance between two points has noise along one direction from each
                stated = known[name] or None
                alone = stated if measure == "position_mm" else distance_mm(stated, stated)
                rows.append((f"{stage}, {measure[:-3]}", *_details(summary, alone)))
        tables.append(Table(table.title, ("stage, measure", *columns), tuple(rows)))
    if result["pair"]:
        alone = distance_mm(*known.values())
        rows = [
            (method, *_details(result["pair"][method]["cooperative_mm"], alone))
            for method in METHODS
            if method in result["pair"]
        ]
        tables.append(Table(calibration_tables(result)[-1].title, ("method", *columns), tuple(rows)))
    return tables


def transform_tables(result: Mapping[str, Any]) -> list[Table]:
    """Either way to the inter-base transform on the same held-out stops; nothing where there is no pair."""
    rows = []
    for method in METHODS:
        for way, summary in result["pair"].get(method, {}).get("by_transform_mm", {}).items():
            numbers = (f"{summary[key]:.4f}" for key in ("rms", "std", "p50", "p95", "max"))
            words = "distances alone" if way == "distances" else "the tracker frame"
            mean = f"{summary['mean']:.4f}"
            rows.append((f"{method}, by {words}", mean, _mean_interval(summary), *numbers, str(summary["n"])))
    if not rows:
        return []
    columns = ("method, transform", "mean", "95 % of mean", "rms", "std", "p50", "p95", "max", "n")
    return [Table("Pair: cooperative errors by either transform [mm]", columns, tuple(rows))]


def distance_mm(first: float | None, second: float | None) -> float | None:
    """Root mean square error [mm] of a distance, from the root mean square lengths of its two points' noise [mm].

    None where either is unknown.
    """
    return None if not first or not second else math.sqrt((first**2 + second**2) / 3.0)


def _details(summary: Mapping[str, Any], alone_mm: float | None) -> tuple[str, ...]:
    mean, rms, std, largest, n = _numbers(summary)
    middle, high = (f"{summary[key]:.4f}" if key in summary else "" for key in ("p50", "p95"))
    ratio = "" if alone_mm is None else f"{summary['rms'] / alone_mm:.1f}"
    return mean, _mean_interval(summary), rms, std, middle, high, largest, n, ratio


def _mean_interval(summary: Mapping[str, Any]) -> str:
    if "mean_ci95" not in summary:
        return ""
    low, high = summary["mean_ci95"]
    return f"{low:.4f} to {high:.4f}"


def parameter_tables(result: Mapping[str, Any]) -> list[Table]:
    """Identified parameters with standard errors, one table an arm; from the object of ``calibrate --json``."""
    tables = []
    for name, arm in result["arms"].items():
        rows = []
        for parameter, entry in arm["identified"].items():
            factor, unit = (1e3, "mm") if entry["unit"] == "m" else (180.0 / 3.141592653589793, "deg")
            value, error = entry["value"] * factor, entry["standard_error"] * factor
            rows.append((parameter, f"{value:.5f}", f"{error:.5f}", unit))
        columns = ("parameter", "value", "standard error", "unit")
        tables.append(Table(f"Arm {name}: identified parameters", columns, tuple(rows)))
    return tables


def verification_tables(result: Mapping[str, Any]) -> list[Table]:
    """Errors at new targets before and after compensation; from the object of ``push --json``."""
    rows = []
    for name, ways in result["arms"].items():
        for way, label in (("nominal_mm", "uncompensated"), ("compensated_mm", "compensated")):
            rows.append((f"{name}, {label}", *_numbers(ways[way])))
    if not rows:
        return []
    columns = ("arm, command", "mean", "rms", "std", "max", "n")
    return [Table("Targets: measured distance from where they should be [mm]", columns, tuple(rows))]


def all_tables(results: Mapping[str, Mapping[str, Any]]) -> list[Table]:
    """The tables of whatever steps a run has results of: ``calibrate``, ``discover``, ``verify``."""
    tables: list[Table] = []
    for step, make in (
        ("calibrate", calibration_tables),
        ("discover", discovery_tables),
        ("verify", verification_tables),
    ):
        if step in results:
            tables += make(results[step])
    return tables


def _numbers(summary: Mapping[str, float | int]) -> tuple[str, ...]:
    return (*(f"{summary[key]:.4f}" for key in ("mean", "rms", "std", "max")), str(summary["n"]))


def parameter_set_table(arm: str, trials: Sequence[Mapping[str, Any]]) -> Table:
    """Redundant against reduced model; from the rows of ``trials parameter-sets --json``."""
    rows = tuple(
        (
            f"{trial['parameter_set']} ({trial['parameters']}), {trial['solver']}",
            f"{trial['iterations']:g}",
            f"{trial['converged']} of {trial['seeds']}",
            f"{trial['mean_mm']:.4g}",
            f"{trial['max_mm']:.4g}",
        )
        for trial in trials
    )
    columns = ("set (parameters), solver", "iterations", "converged", "mean [mm]", "max [mm]")
    return Table(f"Arm {arm}: redundant and reduced models, medians over seeds", columns, rows)


def paper_tables(result: Mapping[str, Any]) -> list[Table]:
    """The paper's methods over seeds, beside the paper; from the object of ``trials paper --json``."""
    rows: list[tuple[str, ...]] = []
    for method, entry in result["cooperative_mm"].items():
        paper = "" if entry["paper"] is None else f"{entry['paper']:.4f}"
        rows.append((method, f"{entry['median']:.4f}", f"{entry['worst']:.4f}", paper))
    gain = result["gain"]
    rows.append(("proposed below method_1", *(f"{100 * gain[key]:.1f} %" for key in ("median", "worst", "paper"))))
    seeds = len(result["trials"])
    columns = ("method", "median", "worst", "paper")
    tables = [Table(f"Mean cooperative error [mm], {seeds} simulated cells", columns, tuple(rows))]
    for where, title in (("position_mm", "Mean position error [mm]"), ("moved_mm", "At another tracker station [mm]")):
        shown: list[tuple[str, ...]] = []
        for name in result["trials"][0][where]:
            for stage in result["trials"][0][where][name]:
                values = sorted(t[where][name][stage] for t in result["trials"] if stage in t[where][name])
                shown.append((f"{name}, {stage}", f"{values[len(values) // 2]:.4f}", f"{values[-1]:.4f}"))
        tables.append(Table(title, ("arm, model", "median", "worst"), tuple(shown)))
    return tables


def link_table(result: Mapping[str, Any]) -> Table:
    """What was measured of emulated arms under the real client; from the object of ``trials links --json``."""
    rows = [
        (name, *_times(result[key]))
        for name, key in (
            ("connect", "connect_s"),
            ("ask for the state", "state_s"),
            ("motion, beyond its ideal time", "move_overhead_s"),
        )
    ]
    for fault, times in result["by_fault"].items():
        for name, key in (("reported", "reported_s"), ("at rest", "at_rest_s"), ("ready again", "recovered_s")):
            rows.append((f"{fault}: {name}", *_times(times[key])))
    return Table("Times [s]", ("what", "median", "95 %", "max", "n"), tuple(rows))


def bridge_table(result: Mapping[str, Any]) -> Table:
    """How long measurements took by what befell them; from the object of ``trials bridge --json``."""
    undisturbed = ("none", str(result["asked"] - sum(result["faults"].values())), f"{result['undisturbed_s']:.3f}")
    rows = [(fault, str(result["faults"][fault]), f"{longest:.3f}") for fault, longest in result["recovery_s"].items()]
    return Table("Times of a measurement [s]", ("fault", "n", "longest; none: median"), (undisturbed, *rows))


def _times(spread: Mapping[str, float | int] | None) -> tuple[str, ...]:
    if spread is None:
        return ("", "", "", "0")
    return (*(f"{spread[key]:.3f}" for key in ("median", "p95", "max")), str(spread["n"]))


def tracker_sentences(result: Mapping[str, Any]) -> list[str]:
    """How near each arm comes to the tracker's own uncertainty; from the object of ``calibrate --json``."""
    sentences = []
    for name, arm in result["arms"].items():
        if arm["tracker_mm"] is None:
            sentences.append(f"arm {name}: the readings state no uncertainty to compare with")
            continue
        stage = next(stage for stage in reversed(STAGES) if stage in arm["validate"])
        rms = arm["validate"][stage]["position_mm"]["rms"]
        sentences.append(
            f"arm {name}: {stage} leaves {rms:.4f} mm rms, {rms / arm['tracker_mm']:.1f} times the tracker's own"
            f" {arm['tracker_mm']:.4f} mm"
        )
    return sentences
