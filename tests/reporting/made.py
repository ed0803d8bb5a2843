"""A discovery result made up by hand, in which everything that can be shown of one occurs."""

from __future__ import annotations

import math
from typing import Any

ANGLES = [-170.0 + 2.0 * k for k in range(150)]  # to 128 deg: some 60 deg of the turn were never trained


def parameter(value: float, error: float, unit: str) -> dict[str, Any]:
    return {"value": value, "standard_error": error, "unit": unit}


def finding(effect: str, law: str, where: dict[str, Any], parameters: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {
        "effect": effect,
        "title": effect.replace("_", " "),
        "law": {"name": law, "constants": more.pop("constants", {})},
        "where": where,
        "parameters": parameters,
        "evidence": {
            "statistic": 250.25,
            "corrected_p": 0.004975,
            "heldout_mm": {"before": 0.4512, "after": 0.0312},
        },
        "answer_set": [effect, *more.pop("instead", ())],
        "runners_up": more.pop("runners_up", []),
        "correlated_with": more.pop("correlated", None),
        **more,
    }


def made_picture(effect: str, joint: int, *, curve: bool = False) -> dict[str, Any]:
    computed = [300.0 * math.sin(math.radians(11.0 * angle)) for angle in ANGLES]
    around = [-180.0 + k for k in range(361)]
    return {
        "title": f"{effect.replace('_', ' ')}, joint {joint}",
        "effect": effect,
        "x_label": f"joint {joint} [deg]" if curve else f"gravity torque on joint {joint} [Nm]",
        "y_label": f"offset of joint {joint} [urad]",
        "x": ANGLES,
        "measured": [value + 20.0 * (-1) ** k for k, value in enumerate(computed)],
        "computed": computed,
        "band": [5.0] * len(ANGLES),
        "curve": None
        if not curve
        else {
            "x": around,
            "value": [300.0 * math.sin(math.radians(11.0 * angle)) for angle in around],
            "band": [10.0 if angle < 128.0 else 150.0 for angle in around],
        },
    }


def made_arm(name: str) -> dict[str, Any]:
    """An arm with a free curve, an effect with look-alikes and a term that has no name."""
    joints = {"joints": [1, 2], "acts_on": ["joint 1", "joint 2"]}
    accepted = [
        finding(
            "transmission_error",
            "curve",
            joints,
            {f"cos{k}q1": parameter(1e-5, 1e-6, "rad") for k in range(2, 60)},
            cycles={
                "1": {"from": 9, "to": 37, "peak": 11, "rms_urad": 212.4},
                "2": {"from": 14, "to": 14, "peak": 14, "rms_urad": 80.0},
            },
        ),
        finding(
            "joint_compliance",
            "two_slope",
            {"joints": [2, 3, 4, 6], "acts_on": ["joint 2", "joint 3", "joint 4", "joint 6"]},
            {"compliance2": parameter(1.6668e-5, 1.8e-8, "rad/Nm")},
            constants={"knee2": 18.84},
            instead=["pedestal_compliance", "link_bending"],
            runners_up=[
                {"effect": "pedestal_compliance", "statistic": 249.0, "told_apart": False},
                {"effect": "link_bending", "statistic": 248.0, "told_apart": False},
                {"effect": "tracker_angle_error", "statistic": 244.0, "told_apart": True},
            ],
            correlated={"parameter": "theta2", "correlation": 0.7283},
        ),
        finding(
            "unknown",
            "joint 5|q2",
            {"joints": [5], "acts_on": ["joint 5"], "channel": "joint 5", "variables": ["q2"]},
            {"joint_5.cos1_q2": parameter(1e-4, 1e-6, "rad")},
            description={
                "channel": "joint 5",
                "variables": ["q2"],
                "size_um": 22.4,
                "formula": "c |sin(q2)|",
                "gain_over_curve": 12.3,
                "curve": [[0.0, 0.0], [1.0, 1e-4]],
                "sentence": "joint 5 depends on q2, about c |sin(q2)|; 22 um rms at the SMR",
            },
        ),
    ]
    return {
        "noise_floor_mm": 0.0223,
        "heldout_mm": {"before": 0.4906, "after": 0.0312},
        "steps": [
            {"what": "geometry alone", "effect": "", "heldout_mm": 0.4906},
            {"what": "transmission error: a free curve a joint", "effect": "transmission_error", "heldout_mm": 0.1112},
            {"what": "a data-driven term added", "effect": "unknown", "heldout_mm": 0.0299},
        ],
        "threshold": 9.7,
        "omnibus_p": 0.0,
        "scatter": 1.4,
        "accepted": accepted,
        "invisible": [
            {"effect": "backlash", "reason": "not testable: no approach signs", "smallest_seen": None},
            {
                "effect": "tracker_scale",
                "reason": "invisible: geometry follows nearly all of it under this plan",
                "visible_share": 0.01,
                "smallest_seen": None,
                "smallest_seen_rms_mm": 0.3988,
            },
        ],
        "not_found": [
            {
                "effect": "target_slip",
                "reason": "not found; it could have been seen from these sizes on",
                "visible_share": 0.97,
                "smallest_seen": {"slip_x": {"value": 3e-5, "unit": "m"}},
                "smallest_seen_rms_mm": 0.0047,
            },
        ],
        "network_mm": {"before": 0.3965, "after": 0.0},
        "uncertainty_mm": {"median": 0.0937, "largest": 0.374},
        "pictures": [
            made_picture("transmission_error", 1, curve=True),
            made_picture("transmission_error", 2, curve=True),
            made_picture("joint_compliance", 2),
            made_picture("joint_compliance", 3),
            made_picture("joint_compliance", 4),
            made_picture("unknown", 5),
        ],
        "verdict": "unknown effect",
        "sentence": f"arm {name}: something that the library does not have; 31 um rms held out",
    }


def nothing_missing(name: str) -> dict[str, Any]:
    return {
        **made_arm(name),
        "heldout_mm": {"before": 0.0225, "after": 0.0225},
        "steps": [{"what": "geometry alone", "effect": "", "heldout_mm": 0.0225}],
        "omnibus_p": 0.42,
        "scatter": 1.01,
        "accepted": [],
        "network_mm": None,
        "uncertainty_mm": None,
        "pictures": [],
        "verdict": "nothing missing",
        "sentence": f"arm {name}: 23 um rms held out against a noise floor of 22 um",
    }


def made_result(first: str, second: str) -> dict[str, Any]:
    """The object of ``discover --json`` for two arms: one with everything, one with nothing."""
    arms = {first: made_arm(first), second: nothing_missing(second)}
    return {"schema": "cellapp-discover", "version": 1, "arms": arms}
