"""Provenance of a page's numbers: programs, seeds, settings, readings, hashes."""

from __future__ import annotations

import platform

import numpy as np

from cellapp.cell.profile import profile_to_json
from cellapp.cell.run.measurement_order import order_sentences
from cellapp.commands.basis import readings_digest, sha256_of
from cellapp.commands.report.data import ReportData
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.commands.view.parts import Facts
from cellapp.ground.profile import Profile
from cellapp.ground.results import Provenance
from cellapp.ground.version import __version__

_HASH = "SHA-256"


def provenance_facts(data: ReportData) -> Facts:
    """Show programs, seeds, settings, counts of readings, hashes."""
    origin = data.calibrate.provenance
    plant = data.profile.plant
    lines = [
        ("Profile", data.profile.name),
        (f"{_HASH} of the profile", sha256_of(profile_to_json(data.profile))),
        ("Seed of splits and draws", str(origin.seed)),
        *([] if plant is None else [("Seed of the simulated cell", str(plant.seed))]),
        ("Calibrated by", _programs(origin)),
        ("Calibrated at", origin.written),
        ("Page made by", f"cellapp {__version__}, Python {platform.python_version()}, numpy {np.__version__}"),
        *_reading_lines(data),
        ("Settings", _settings(data.profile)),
        *((f"{_HASH} of the readings of arm {name}", readings_digest(arm)) for name, arm in data.readings.items()),
        (f"{_HASH} of {CALIBRATION_FILE}", sha256_of(data.model_in_force + "\n")),
    ]
    return Facts(tuple(lines))


def _reading_lines(data: ReportData) -> list[tuple[str, str]]:
    lines = []
    for name, readings in data.readings.items():
        splits = data.calibrate.arms[name].splits
        used = ", ".join(f"{count} {word}" for word, count in splits.items())
        unused = len(readings) - sum(splits.values())
        arm = data.profile.arms[name]
        title = f"Readings of arm {name} ({arm.type.model})"
        lines.append((title, f"{len(readings)}: {used}, {unused} unused; driver: {arm.driver.kind}"))
    lines += [("Order of measurement", sentence) for sentence in order_sentences(data.in_order)]
    pair = data.calibrate.pair.get("method_1")
    if pair is not None and pair.splits:
        lines.append(("Common stops of the pair", ", ".join(f"{count} {word}" for word, count in pair.splits.items())))
    return lines


def _settings(profile: Profile) -> str:
    settings = profile.calibration
    stated = (("length", settings.priors.length, "m"), ("angle", settings.priors.angle, "rad"))
    priors = [f"{kind} {value:g} {unit}" for kind, value, unit in stated if value is not None]
    none = "from the arm's own spread" if settings.parameter_set == "auto" else "none"
    return f"parameter set {settings.parameter_set}, priors {', '.join(priors) or none}, robust {settings.robust}"


def _programs(origin: Provenance) -> str:
    words = [origin.program]
    for title, version in (("Python", origin.python), ("numpy", origin.numpy), ("torch", origin.torch)):
        if version is not None:
            words.append(f"{title} {version}")
    return ", ".join(words)
