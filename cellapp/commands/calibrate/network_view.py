"""Comparison of a network from all readings with the committee, in words."""

from __future__ import annotations

from cellapp.estimation.calibration.records import BatchesResult, CalibrateResult
from cellapp.ground.counting import counted


def network_sentences(result: CalibrateResult) -> list[str]:
    """Return one sentence for each arm for which a network from all readings was requested."""
    said = []
    for name, arm in result.arms.items():
        if arm.network is not None and arm.network.batches is not None:
            said.append(f"arm {name}: a network {batches_words(arm.network.batches)}")
    return said


def batches_words(found: BatchesResult) -> str:
    """Say how the network compared with the committee, and whether it is used."""
    compared = (
        f"{found.left_out_rms_mm:.4f} mm rms on {found.blocks} left-out blocks of time, the committee"
        f" {found.committee_rms_mm:.4f} mm ({found.sigmas:.1f} standard errors)"
    )
    used = "it is the network" if found.used else "it is not used: it is not surely better"
    return f"from {counted(found.readings, 'reading')} in batches leaves {compared}; {used}"
