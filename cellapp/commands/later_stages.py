"""What a new calibration does to the stages that a run holds already."""

from __future__ import annotations

from cellapp.cell.run.file import RunFile
from cellapp.commands.stages import CALIBRATION_FILE, RunStages
from cellapp.ground.results import CHECK, DISCOVER, LOCATE, VERIFY


def note_later_stages(run: RunFile, stages: RunStages) -> list[str]:
    """Notes on what an earlier discovery and verification are worth after a new calibration; logged too."""
    notes = []
    discovered, reason = stages.current.get(DISCOVER), stages.out_of_date.get(DISCOVER)
    if discovered is not None and reason is None:
        notes.append(f"the discovery still holds; {CALIBRATION_FILE} keeps the effects that were found")
    elif discovered is not None:
        kept = "keeps its effects" if stages.in_force is discovered else "holds the new calibration without effects"
        notes.append(
            f"the discovery is out of date ({reason}): {CALIBRATION_FILE} {kept}; run 'cellapp discover {run.folder}'"
        )
    if LOCATE in stages.out_of_date:
        reason = stages.out_of_date[LOCATE]
        notes.append(f"the tracker's station is out of date ({reason}); run 'cellapp locate {run.folder}'")
    if VERIFY in stages.out_of_date:
        notes.append(f"the verification is out of date ({stages.out_of_date[VERIFY]})")
    if CHECK in stages.out_of_date:
        notes.append(f"the check of the calibration is out of date ({stages.out_of_date[CHECK]})")
    for note in notes:
        run.log("note", note)
    return notes
