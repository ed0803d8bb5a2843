"""The real program collects over the wire from an emulated cell in a storm of faults of all kinds, and is killed at
random moments; a person repairs and resumes. Afterwards every reading is compared with an undisturbed run's."""

from __future__ import annotations

import argparse
from typing import Any

from cellapp.cell.profile import load_profile
from tests.evidence.skeleton import ROOT, Evidence, Limit, Table
from tests.evidence.wire.storm import StormResult, storm_trial

TITLE = "Storm on the wire"
ALONE = True


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--stops", type=int, default=400)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"storm": {key: getattr(asked, key) for key in ("stops", "faults", "kills", "seed")}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    profile = load_profile(ROOT / "profiles" / "twin-rtde.yaml")
    return {"result": storm_trial(profile, case["stops"], case["faults"], case["kills"], case["seed"]).to_json()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = StormResult.from_json(results[0]["result"], "storm")
    rows = {
        "planned stops": f"{result.stops}",
        "readings stored; missing, with their reason": f"{result.readings}; {len(result.missing)}",
        "sessions; faults; kills": f"{result.sessions}; {result.faults}; {result.kills}",
        "smallest distance between the arms": "" if result.clearance_mm is None else f"{result.clearance_mm:.0f} mm",
        **{
            f"arm {name}: largest deviation from the undisturbed run": f"{its.position_max_mm:.3f} mm"
            f" ({its.max_sigmas:.1f} standard deviations)"
            for name, its in result.deviation.items()
        },
        "duration": f"{result.seconds / 60.0:.0f} min",
    }
    limits = [
        Limit("readings lost", result.lost, 0),
        Limit("readings doubled", result.doubled, 0),
        Limit("motions after a stop", result.motions_after_a_stop, 0),
        Limit("complaints", len(result.complaints), 0),
    ]
    table = Table("", ["what", "value"], [[what, value] for what, value in rows.items()])
    return Evidence({"readings": str(result.readings)}, [table], limits, result.complaints)
