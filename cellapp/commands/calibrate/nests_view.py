"""Several SMRs on a flange, for terminal, terminal application and page."""

from __future__ import annotations

from cellapp.commands.view.table import Column, Table, number_column
from cellapp.estimation.calibration.records import CalibrateResult, NestsResult
from cellapp.ground.counting import counted


def nest_tables(result: CalibrateResult) -> list[Table]:
    """Show the position of each nest on the flange, one table for each arm with several nests."""
    columns = (
        Column("nest"),
        *(number_column(f"{axis} [mm]", ".3f") for axis in "xyz"),
        number_column("standard error [mm]", ".4f"),
        number_column("n", "d"),
    )
    return [
        Table(
            f"Arm {name}: nests in the flange frame",
            columns,
            tuple(
                (nest, *(1e3 * x for x in one.offset_m), 1e3 * max(one.standard_error_m), one.n)
                for nest, one in arm.nests.found.items()
            ),
        )
        for name, arm in result.arms.items()
        if arm.nests is not None
    ]


def nest_sentences(result: CalibrateResult) -> list[str]:
    """Say how well the nests determined the orientation, and at which stops they did not."""
    return [_sentence(name, arm.nests) for name, arm in result.arms.items() if arm.nests is not None]


def _sentence(name: str, nests: NestsResult) -> str:
    words = f"Arm {name}: {counted(len(nests.found), 'nest')}, which tell the orientation at"
    words += f" {nests.with_orientation} of {counted(nests.stops, 'stop')}"
    if nests.orientation_mrad is not None:
        words += f", to {nests.orientation_mrad:.3f} mrad about the axis that is known least"
    if nests.noise_mm is not None:
        words += f"; a coordinate scatters by {1e3 * nests.noise_mm:.1f} um about the figure of the nests"
    if nests.left_out:
        shown = ", ".join(str(stop) for stop in nests.left_out[:5])
        words += (
            f"; {counted(len(nests.left_out), 'stop')} without the first nest and without three others"
            f" ({shown}{', ...' if len(nests.left_out) > 5 else ''}) left out"
        )
    return f"{words}."
