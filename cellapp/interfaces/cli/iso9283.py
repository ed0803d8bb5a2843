"""``iso9283``: performance tests by ISO 9283, all of them or one by its own name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import AllowMotion, JsonOption, OutOfDate, ProfilePath

if TYPE_CHECKING:
    from cellapp.estimation.iso9283.norm import IsoTest

_ALL = "all"
_With = Literal["nominal", "calibrated", "both"]


class _AllByDefault(TyperGroup):
    """A group whose first word may be left out: it then makes all tests."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and args[0] != "--help":
            args = [_ALL, *args]
        return super().parse_args(ctx, args)


app = Commands(
    cls=_AllByDefault,
    no_args_is_help=True,
    help="Test pose accuracy and more by ISO 9283: 'cellapp iso9283 PROFILE' makes all tests. THE ARMS MOVE.",
)

_Folder = Annotated[
    Path | None,
    typer.Option("--run", metavar="DIR", help="A new run, or an existing one: its calibration is then used."),
]
_Cycles = Annotated[int, typer.Option("--cycles", metavar="N", help="Cycles of each test; the norm's number is 30.")]
_Speed = Annotated[float, typer.Option("--speed", metavar="PERCENT", help="Of the speed that the profile allows.")]
_Arms = Annotated[list[str] | None, typer.Option("--arm", metavar="NAME", help="Only this arm; may be repeated.")]
_Commands = Annotated[
    _With | None,
    typer.Option("--with", help="Nominal commands (as found), calibrated ones (as left); both if calibrated."),
]
_Minutes = Annotated[
    float, typer.Option("--drift-minutes", metavar="MIN", help="How long drift is observed; the norm's time is 480.")
]

_TESTS: dict[str, tuple[tuple[IsoTest, ...], str]] = {
    _ALL: (
        ("pose", "multidirectional", "distance", "drift", "path", "cooperative"),
        "All tests; this word may be left out.",
    ),
    "pose": (("pose",), "Pose accuracy AP and repeatability RP at five poses of the norm's cube."),
    "multidirectional": (
        ("multidirectional",),
        "Variation of pose accuracy vAP from three directions of approach.",
    ),
    "distance": (("distance",), "Distance accuracy AD and repeatability RD."),
    "drift": (("drift",), "Drift of pose accuracy dAP and repeatability dRP while the arm warms up."),
    "path": (("path",), "Path accuracy AT and repeatability RT along a line and a circle."),
    "cooperative": (("cooperative",), "Accuracy and repeatability between the SMRs of two arms."),
}


def _command(tests: Sequence[IsoTest]) -> Callable[..., None]:
    def command(
        profile: ProfilePath,
        folder: _Folder = None,
        cycles: _Cycles = 30,
        speed: _Speed = 100.0,
        arm: _Arms = None,
        commands: _Commands = None,
        drift_minutes: _Minutes = 60.0,
        out_of_date: OutOfDate = False,
        allow_motion: AllowMotion = False,
        json_file: JsonOption = None,
    ) -> None:
        from cellapp.cell.profile import load_profile
        from cellapp.commands.iso9283.run import iso9283_folder, iso9283_run
        from cellapp.commands.iso9283.view import iso9283_sentences, iso9283_tables
        from cellapp.commands.pipeline import default_folder
        from cellapp.estimation.iso9283.norm import ISO_COMMANDS

        with Job(json_file) as job:
            described = load_profile(profile)
            with iso9283_folder(described, folder or default_folder(described.name)) as run:
                result = iso9283_run(
                    run,
                    tests,
                    job.listen,
                    job.control,
                    cycles=cycles,
                    speed_share=speed / 100.0,
                    arms=arm or (),
                    commands=() if commands is None else ISO_COMMANDS if commands == "both" else (commands,),
                    drift_minutes=drift_minutes,
                    out_of_date=out_of_date,
                    ask=asking(job, run.profile.name, allowed=allow_motion),
                )
                job.show(iso9283_tables(result))
                job.say(*iso9283_sentences(result), f"stored in {run.folder}")
            job.result(result)
            require_none(result.complaints(), "iso9283")

    return command


for _name, (_tests, _help) in _TESTS.items():
    app.command(_name, help=_help)(_command(_tests))
