"""The doors for a shell: parse, call, print. Everything slow is imported where it is used, so that --help is quick."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cellapp.errors import CellappError, CheckFailed, InputError
from cellapp.progress import Cancelled, CancelToken, Progress

if TYPE_CHECKING:
    from cellapp.reporting.tables import Table
    from cellapp.run import RunFile

app = typer.Typer(
    help="Calibrate a dual-arm robot cell with a laser tracker, and name the physics that the model is missing.",
    no_args_is_help=False,
    pretty_exceptions_enable=False,
    add_completion=False,
)
trials_app = typer.Typer(help="Monte Carlo trials on simulated cells.", no_args_is_help=True)
app.add_typer(trials_app, name="trials")

ProfilePath = Annotated[Path, typer.Argument(metavar="PROFILE", help="The cell, as YAML.")]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The run's folder.")]
NewRun = Annotated[Path, typer.Option("--run", metavar="DIR", help="Folder of the new run; must not hold one yet.")]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON to FILE; '-' is standard output.")
]

EXIT_INTERRUPTED = 4


@app.callback(invoke_without_command=True)
def tui(context: typer.Context) -> None:
    """Without a command: the terminal application."""
    if context.invoked_subcommand is None:
        from cellapp.tui import run_app

        raise typer.Exit(run_app())


@app.command()
def run(
    profile: ProfilePath,
    folder: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="Folder of the new run; else a new one below logs/.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Everything, unattended: plan, collect, calibrate, discover, compensate, verify, report."""
    from cellapp.pipeline import VERIFY_RESULT, run_whole
    from cellapp.reporting.findings import discovery_lines
    from cellapp.reporting.tables import calibration_tables, tracker_sentences, verification_tables

    with _Job(json_file) as job:
        outcome = run_whole(profile, folder, job.listen, job.cancel)
        job.show(calibration_tables(outcome.results["calibrate"]))
        job.say(*discovery_lines(outcome.results["discover"]))
        job.show(verification_tables(outcome.results.get(VERIFY_RESULT, {"arms": {}})))
        job.say(*tracker_sentences(outcome.results["calibrate"]), *outcome.notes)
        job.say(f"run: {outcome.folder}   report: {outcome.folder / 'report.html'}")
        job.result({"schema": "cellapp-run", "version": 1, "run": str(outcome.folder), **outcome.results})
        _check_verified(outcome.results)


@app.command()
def doctor(profile: ProfilePath, json_file: JsonOption = None) -> None:
    """What is reachable, what is missing, what would be refused; nothing moves."""
    from cellapp.commissioning.doctor import examine
    from cellapp.profile import load_profile

    with _Job(json_file) as job:
        findings = examine(load_profile(profile))
        for finding in findings:
            job.say(f"{finding.status:8} {finding.subject}: {finding.text}")
        rows = [{"subject": f.subject, "status": f.status, "text": f.text} for f in findings]
        job.result({"schema": "cellapp-doctor", "version": 1, "findings": rows})
        failed = sum(finding.status == "failed" for finding in findings)
        if failed:
            raise CheckFailed(f"{failed} of {len(findings)} checks failed")


@app.command()
def plan(profile: ProfilePath, folder: NewRun, json_file: JsonOption = None) -> None:
    """Plan the stops of a new run: seen by the tracker, safe to stand at and to reach."""
    from cellapp.pipeline import new_planned_run
    from cellapp.profile import load_profile

    with _Job(json_file) as job:
        with new_planned_run(load_profile(profile), folder, job.listen, job.cancel) as new:
            counts = {name: len(rows) for name, rows in new.read_plan().items()}
        job.say(*(f"arm {name}: {count} stops planned" for name, count in counts.items()))
        job.result({"schema": "cellapp-plan", "version": 1, "run": str(folder), "stops": counts})


@app.command()
def collect(
    folder: RunFolder,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a run that was interrupted.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Drive the planned stops and measure; every stop is committed before the next move."""
    from cellapp.collection.collect import collect_run

    with _Job(json_file) as job, _open_run(folder, write=True) as opened:
        notes = collect_run(opened, job.listen, job.cancel, resume=resume)
        stops = len(opened.stops_done())
        job.say(f"{stops} stops stored", *notes)
        job.result({"schema": "cellapp-collect", "version": 1, "stops": stops, "notes": list(notes)})


@app.command("import")
def import_(
    profile: ProfilePath,
    csv: Annotated[Path, typer.Argument(metavar="CSV", help="Readings; see the README for the columns.")],
    folder: NewRun,
    json_file: JsonOption = None,
) -> None:
    """Make a run from readings that were measured elsewhere."""
    from cellapp.profile import load_profile
    from cellapp.run import import_csv

    with _Job(json_file) as job:
        with import_csv(load_profile(profile), csv, folder) as new:
            counts = {name: len(new.readings(name)) for name in new.arms()}
            notes = [event.text for event in new.events() if event.level == "note"]
        job.say(*(f"arm {name}: {count} readings" for name, count in counts.items()), *notes)
        result = {"schema": "cellapp-import", "version": 1, "run": str(folder), "readings": counts, "notes": notes}
        job.result(result)


@app.command()
def export(
    folder: RunFolder,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Where to write the readings.")] = None,
    geometry: Annotated[
        Path | None,
        typer.Option("--geometry", metavar="FILE", help="Where to write the identified arms as URDF and UR values."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Write the readings of a run as CSV, or the identified geometry for other programs.

    Importing the CSV again gives the same readings bit for bit.
    """
    from cellapp.run import write_readings_csv

    with _Job(json_file) as job, _open_run(folder) as opened:
        result: dict[str, Any] = {"schema": "cellapp-export", "version": 1}
        if csv is None and geometry is None:
            raise InputError("export: say what to write: --csv FILE for the readings, --geometry FILE for the arms")
        if csv is not None:
            write_readings_csv(opened, csv)
            counts = {name: len(opened.readings(name)) for name in opened.arms()}
            job.say(*(f"arm {name}: {count} readings" for name, count in counts.items()), f"written to {csv}")
            result |= {"csv": str(csv), "readings": counts}
        if geometry is not None:
            job.say(*_export_geometry(opened, geometry))
            result |= {"geometry": str(geometry)}
        job.result(result)


@app.command()
def calibrate(
    folder: RunFolder,
    parameters: Annotated[bool, typer.Option("--parameters", help="Show the identified parameters too.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Identify arms and pair, evaluate on held-out stops, write calibration.json."""
    from cellapp.calibration.calibrate import calibrate_run
    from cellapp.reporting.tables import calibration_tables, parameter_tables, tracker_sentences

    with _Job(json_file) as job, _open_run(folder, write=True) as opened:
        result = calibrate_run(opened, job.listen, job.cancel).as_dict()
        job.show(calibration_tables(result))
        if parameters:
            job.show(parameter_tables(result))
            job.say(*_merged(result))
        job.say(*tracker_sentences(result), *result["notes"])
        job.result(result)


@app.command()
def discover(
    folder: RunFolder,
    propose: Annotated[
        int | None,
        typer.Option(
            "--propose", metavar="N", min=1, max=1000, help="Plan N further stops that best tell what is left open."
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Find where model and measurement disagree, name the missing effect, add it, show the gap shrink."""
    from cellapp.discovery.discover import discover_run
    from cellapp.discovery.outcome import as_dict
    from cellapp.reporting.findings import discovery_lines

    with _Job(json_file) as job, _open_run(folder, write=True) as opened:
        found = discover_run(opened, job.listen, job.cancel)
        result = as_dict(found)
        job.say(*discovery_lines(result))
        if propose is not None:
            from cellapp.discovery.propose import propose_run
            from cellapp.reporting.proposal import proposal_lines

            result["proposal"] = propose_run(opened, found, propose, job.listen, job.cancel).as_dict()
            job.say("", *proposal_lines(result["proposal"]))
        job.result(result)


@app.command()
def compensate(
    folder: RunFolder,
    targets: Annotated[Path, typer.Argument(metavar="TARGETS", help="Target list, YAML.")],
    json_file: JsonOption = None,
) -> None:
    """Joint positions that bring the real arms to Cartesian targets, from the calibrated model."""
    from cellapp.compensation.targets import load_targets
    from cellapp.pipeline import compensate_run

    with _Job(json_file) as job, _open_run(folder, write=True) as opened:
        result = compensate_run(opened, load_targets(targets, opened.profile))
        refused = [entry for entry in result["targets"] if entry["refusal"]]
        job.say(f"{len(result['targets']) - len(refused)} of {len(result['targets'])} targets compensated")
        job.say(*(f"target {entry['name']}: {entry['refusal']}" for entry in refused))
        job.result(result)


@app.command()
def push(
    folder: RunFolder,
    targets: Annotated[Path, typer.Argument(metavar="TARGETS", help="Target list, YAML.")],
    verify: Annotated[bool, typer.Option("--verify", help="Measure where the SMR really goes.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Move the arms to compensated targets; with --verify, measure them before and after compensation."""
    from cellapp.compensation.targets import load_targets
    from cellapp.pipeline import PUSH_RESULT, VERIFY_RESULT, push_run, stored_results
    from cellapp.reporting.tables import verification_tables

    with _Job(json_file) as job, _open_run(folder, write=True) as opened:
        notes = push_run(opened, load_targets(targets, opened.profile), job.listen, job.cancel, verify=verify)
        result = stored_results(opened)[VERIFY_RESULT if verify else PUSH_RESULT]
        job.show(verification_tables(result))
        job.say(*notes)
        job.result(result)
        if verify:
            _check_verified({VERIFY_RESULT: result})


@app.command()
def report(folder: RunFolder, json_file: JsonOption = None) -> None:
    """Write report.html, one page that needs nothing else, into the run's folder."""
    from cellapp.pipeline import stored_results
    from cellapp.reporting.page import write_page
    from cellapp.reporting.tables import all_tables

    with _Job(json_file) as job, _open_run(folder) as opened:
        path = write_page(opened)
        results = stored_results(opened)
        job.show(all_tables(results))
        job.say(f"written: {path}")
        job.result({"schema": "cellapp-report", "version": 1, "page": str(path), **results})


@app.command()
def emulate(
    profile: ProfilePath,
    pace: Annotated[
        float, typer.Option("--pace", metavar="X", min=0.1, max=1000.0, help="Seconds in the cell for each real one.")
    ] = 1.0,
    json_file: JsonOption = None,
) -> None:
    """Stand in for this cell's controllers and, behind a bridge, its tracker, on loopback until interrupted."""
    from dataclasses import asdict

    from cellapp.commissioning.emulate import EmulatedArm, EmulatedTracker
    from cellapp.commissioning.emulate import emulate as serve
    from cellapp.profile import load_profile

    with _Job(json_file) as job:
        trackers: list[EmulatedTracker] = []

        def announce(arms: Sequence[EmulatedArm]) -> None:
            job.say(*(str(arm) for arm in arms), *(str(tracker) for tracker in trackers), "Ctrl-C ends this")
            job.result(
                {
                    "schema": "cellapp-emulate",
                    "version": 1,
                    "pace": pace,
                    "arms": [asdict(arm) for arm in arms],
                    "tracker": asdict(trackers[0]) if trackers else None,
                }
            )

        serve(load_profile(profile), job.cancel, announce, pace=pace, announce_tracker=trackers.append)


@app.command("tracker-bridge")
def tracker_bridge(
    profile: ProfilePath,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on; one that other machines reach needs a token.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, help="TCP port; else 50960, or none beside --serial.")
    ] = None,
    serial: Annotated[
        str | None, typer.Option("--serial", metavar="PORT", help="A serial port to serve, as COM3 or /dev/ttyUSB0.")
    ] = None,
    baud: Annotated[int, typer.Option("--baud", min=300, help="Of the serial port.")] = 115200,
    token_file: Annotated[
        Path | None, typer.Option("--token-file", metavar="FILE", help="The shared token; only you may read the file.")
    ] = None,
    token_env: Annotated[
        str | None, typer.Option("--token-env", metavar="NAME", help="Environment variable that holds the token.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Serve the tracker that this computer is wired to, to the cell PC, until interrupted."""
    from dataclasses import asdict

    from cellapp.commissioning.tracker_bridge import DEFAULT_PORT, ServedTracker, serve_tracker
    from cellapp.profile import load_profile

    with _Job(json_file) as job:
        if token_file is not None and token_env is not None:
            raise InputError("tracker-bridge: give --token-file or --token-env, not both")

        def announce(served: ServedTracker) -> None:
            job.say(str(served), "Ctrl-C ends this")
            job.result({"schema": "cellapp-tracker-bridge", "version": 1, **asdict(served)})

        serve_tracker(
            load_profile(profile),
            job.cancel,
            announce,
            host=host,
            port=DEFAULT_PORT if port is None and serial is None else port,
            serial=serial,
            baud=baud,
            token_file=token_file,
            token_env=token_env,
        )


@trials_app.command("coverage")
def trials_coverage(
    profile: ProfilePath,
    n: Annotated[int, typer.Option("--n", min=2, help="Simulated runs.")] = 200,
    stops: Annotated[int, typer.Option("--stops", min=20, help="Stops each is identified from.")] = 100,
    json_file: JsonOption = None,
) -> None:
    """How often the stated 95 % intervals hold the truth, over many simulated arms."""
    from cellapp.profile import load_profile
    from cellapp.trials.coverage import coverage

    with _Job(json_file) as job:
        loaded = load_profile(profile)
        results = {}
        for arm in loaded.arms:
            result = coverage(loaded, arm, n, stops, job.listen, job.cancel)
            results[arm] = result.as_dict()
            job.say(
                f"arm {arm}: {100 * result.share:.2f} % of {result.intervals} stated 95 % intervals hold the truth"
                f" ({result.runs} runs; by parameter {100 * min(result.by_parameter.values()):.1f} to"
                f" {100 * max(result.by_parameter.values()):.1f} %)"
            )
        job.result({"schema": "cellapp-trials-coverage", "version": 1, "arms": results})


@trials_app.command("parameter-sets")
def trials_parameter_sets(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated arms.")] = 5,
    json_file: JsonOption = None,
) -> None:
    """The paper's comparison: redundant, paper's and identifiable set; iterations, mean and maximum error."""
    from cellapp.profile import load_profile
    from cellapp.reporting.tables import parameter_set_table
    from cellapp.trials.parameter_sets import compare_parameter_sets

    with _Job(json_file) as job:
        loaded = load_profile(profile)
        results = {}
        for arm in loaded.arms:
            trials = compare_parameter_sets(loaded, arm, range(seeds), listener=job.listen, cancel=job.cancel)
            results[arm] = [trial.as_dict() for trial in trials]
            job.show([parameter_set_table(arm, results[arm])])
        job.result({"schema": "cellapp-trials-parameter-sets", "version": 1, "arms": results})


@trials_app.command("paper")
def trials_paper(
    profile: ProfilePath,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Simulated cells.")] = 10,
    json_file: JsonOption = None,
) -> None:
    """The paper's three methods on many simulated cells, and the two networks at another tracker station."""
    from cellapp.profile import load_profile
    from cellapp.reporting.tables import paper_tables
    from cellapp.trials.paper import paper_trials, summary

    with _Job(json_file) as job:
        result = summary(paper_trials(load_profile(profile), range(seeds), job.listen, job.cancel))
        job.show(paper_tables(result))
        job.result(result)


@trials_app.command("links")
def trials_links(
    moves: Annotated[int, typer.Option("--moves", min=2, help="Motions in all, of two arms at once.")] = 1000,
    every: Annotated[int, typer.Option("--every", min=2, help="Motions to each fault.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws targets and faults.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Two emulated UR arms under the real client, faults at random: what is reported, and how soon all is at rest."""
    from cellapp.reporting.tables import link_table
    from cellapp.trials.links import link_trials

    with _Job(json_file) as job:
        trial = link_trials(moves, every, seed, job.listen, job.cancel)
        result = trial.as_dict()
        job.show([link_table(result)])
        job.say(f"{trial.moves} moves, {len(trial.struck)} faults, {len(trial.complaints)} complaints")
        job.say(*trial.complaints)
        job.result(result)
        if trial.complaints:
            raise CheckFailed(f"trials links: {len(trial.complaints)} things went otherwise than promised; see above")


@trials_app.command("bridge")
def trials_bridge(
    profile: ProfilePath,
    measurements: Annotated[int, typer.Option("--measurements", min=1, help="Measurements in all.")] = 1000,
    every: Annotated[int, typer.Option("--every", min=1, help="Measurements to each fault.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the faults.")] = 0,
    serial: Annotated[
        tuple[str, str] | None,
        typer.Option("--serial", metavar="BRIDGE CLIENT", help="Both ends of a serial cable, to go over that."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Many measurements over the tracker bridge, faults at random: none may be lost, doubled or mixed up."""
    from cellapp.profile import load_profile
    from cellapp.reporting.tables import bridge_table
    from cellapp.trials.bridge import bridge_trial

    with _Job(json_file) as job:
        trial = bridge_trial(load_profile(profile), measurements, every, seed, serial, job.listen, job.cancel)
        result = trial.as_dict()
        job.show([bridge_table(result)])
        job.say(
            f"{trial.asked} measurements asked for, {trial.delivered} delivered; {trial.lost} lost,"
            f" {trial.doubled} doubled, {trial.strange} mixed up"
        )
        job.result(result)
        if trial.lost or trial.doubled or trial.strange:
            raise CheckFailed("trials bridge: measurements were lost, doubled or mixed up")


@trials_app.command("seal")
def trials_seal(
    profile: ProfilePath,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder of the trials.")],
    n: Annotated[int, typer.Option("--n", min=1, help="Runs.")] = 200,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Draws everything; left out, one that nobody is told.")
    ] = None,
    kind: Annotated[
        str, typer.Option("--kind", metavar="KIND", help="What is hidden: one, none, outside, pair or mixed.")
    ] = "one",
    noise: Annotated[
        str, typer.Option("--noise", metavar="NOISE", help="gaussian, heavy (tails) or repeatability (8 urad a joint).")
    ] = "gaussian",
    json_file: JsonOption = None,
) -> None:
    """Runs of simulated cells whose hidden effects stand in a sealed file of their own."""
    from cellapp.profile import load_profile
    from cellapp.trials.sealed import SEAL_FILE, TRUTH_FILE, seal_trials

    with _Job(json_file) as job:
        sealed = seal_trials(
            load_profile(profile), out, n, seed=seed, kind=kind, noise=noise, listener=job.listen, cancel=job.cancel
        )
        job.say(f"{sealed.runs} runs in {out}; their truth is in {out / TRUTH_FILE}: open it with 'trials judge' only")
        job.say(f"SHA-256 of the truth, also in {out / SEAL_FILE}: {sealed.digest}")
        content = {"runs": sealed.runs, "folder": str(out), "sha256": sealed.digest}
        job.result({"schema": "cellapp-trials-seal", "version": 1, **content})


@trials_app.command("judge")
def trials_judge(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the trials.")],
    jobs: Annotated[int, typer.Option("--jobs", min=1, max=64, help="Processes, each of one thread.")] = 2,
    again: Annotated[bool, typer.Option("--again", help="Judge anew also what was judged before.")] = False,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", metavar="FILE", help="Write the tables as Markdown to FILE.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Calibrate and discover on every sealed run, then open the truth and compare; goes on where it was stopped."""
    from cellapp.trials.judge import judge_trials
    from cellapp.trials.verdicts import judged_sentences, judged_tables, trial_table_markdown

    with _Job(json_file) as job:
        if markdown is not None and not markdown.absolute().parent.is_dir():
            raise InputError(f"--markdown: {markdown}: there is no such folder; nothing was done")
        judgement = judge_trials(folder, jobs=jobs, again=again, listener=job.listen, cancel=job.cancel)
        job.show(judged_tables(judgement.result))
        job.say(*judged_sentences(judgement.result))
        job.result(dict(judgement.result))
        if markdown is not None:
            try:
                markdown.write_text(trial_table_markdown(judgement.result), encoding="utf-8")
            except OSError as error:
                raise CellappError(f"--markdown: {markdown} cannot be written ({error.strerror})") from None
        if judgement.failed:
            raise CheckFailed(f"{len(judgement.failed)} runs could not be judged: {'; '.join(judgement.failed)}")


def main() -> None:
    """The program: errors become one sentence and an exit code."""
    try:
        app()
    except Cancelled as error:
        _complain(f"{error}; what was committed is kept, and a collection goes on with 'cellapp collect DIR --resume'")
        sys.exit(EXIT_INTERRUPTED)
    except CellappError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of our output went away
        sys.stderr.close()
        sys.exit(0)
    except Exception as error:  # noqa: BLE001 - the last door: a person gets a sentence, the trace goes to a file
        log = Path("cellapp-error.log")
        with contextlib.suppress(OSError):
            log.write_text(traceback.format_exc(), encoding="utf-8")
        _complain(f"unexpected {type(error).__name__}: {error}; please report it with {log} from this folder")
        sys.exit(1)


class _Job:
    """One command: its progress bars, its cancel token on Ctrl-C, its tables and its JSON."""

    def __init__(self, json_file: str | None) -> None:
        if json_file not in (None, "-") and not Path(str(json_file)).absolute().parent.is_dir():
            raise InputError(f"--json: {json_file}: there is no such folder; nothing was done")
        self._json_file = json_file
        self.cancel = CancelToken()
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        self._before: dict[int, Any] = {}
        self._began = time.monotonic()

    def __enter__(self) -> _Job:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bars is not None:
            self._bars.stop()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _interrupt(self, number: int, frame: object) -> None:
        if self.cancel.cancelled:
            raise Cancelled("stopped at once")
        self.cancel.cancel()
        print("stopping at the next step; once more to stop at once", file=sys.stderr)

    def listen(self, event: Progress) -> None:
        """Draw one bar a job on standard error, if a person looks at it."""
        if not sys.stderr.isatty():
            return
        if self._bars is None:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bars

            self._bars = Bars(
                TextColumn("{task.description:12}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.fields[note]}"),
                console=Console(stderr=True),
            )
            self._bars.start()
        if event.job not in self._tasks:
            self._tasks[event.job] = self._bars.add_task(event.job, total=event.total, note="")
        self._bars.update(self._tasks[event.job], completed=event.done, total=event.total, note=event.note)

    def say(self, *lines: str) -> None:
        """Lines for the person: on standard output, unless that carries the JSON."""
        self._stop_bars()
        for line in lines:
            print(line, file=sys.stderr if self._json_file == "-" else sys.stdout, flush=True)

    def show(self, tables: Sequence[Table]) -> None:
        """Tables for the person."""
        from rich import box
        from rich.console import Console
        from rich.table import Table as RichTable
        from rich.text import Text

        self._stop_bars()
        console = Console(stderr=self._json_file == "-")
        for table in tables:
            drawn = RichTable(title=Text(table.title), title_justify="left", box=box.SIMPLE_HEAD)
            for place, column in enumerate(table.columns):
                drawn.add_column(Text(column), justify="left" if place == 0 else "right", no_wrap=place == 0)
            for row in table.rows:
                drawn.add_row(*(Text(cell) for cell in row))
            console.print(drawn)

    def result(self, content: dict[str, Any]) -> None:
        """Write the JSON, if it was asked for."""
        if self._json_file is None:
            return
        text = json.dumps(content, indent=1) + "\n"
        if self._json_file == "-":
            sys.stdout.write(text)
            sys.stdout.flush()
            return
        try:
            Path(self._json_file).write_text(text, encoding="utf-8")
        except OSError as error:
            raise CellappError(f"--json: {self._json_file} cannot be written ({error.strerror})") from None

    def _stop_bars(self) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars, self._tasks = None, {}


def _export_geometry(run: RunFile, path: Path) -> list[str]:
    from cellapp.calibration.calibrate import CALIBRATION_FILE
    from cellapp.exports.geometry import geometry_export
    from cellapp.model import CellModel

    content = geometry_export(CellModel.load(run.folder / CALIBRATION_FILE))
    try:
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}); choose another place") from None
    lines = []
    for name, arm in content["arms"].items():
        lost = arm["ur_deltas"]["lost"]["position_mm"]
        lines.append(f"arm {name}: UR's D-H deltas cannot hold the Hayati angles and lose {lost['rms']:.3f} mm rms")
    return [*lines, f"written to {path}"]


@contextlib.contextmanager
def _open_run(folder: Path, *, write: bool = False) -> Iterator[RunFile]:
    from cellapp.run import RunFile

    with RunFile.open(folder, write=write) as opened:
        yield opened


def _check_verified(results: Mapping[str, Any]) -> None:
    from cellapp.compensation.push import unverified
    from cellapp.pipeline import VERIFY_RESULT

    complaints = unverified(results[VERIFY_RESULT]) if VERIFY_RESULT in results else []
    if complaints:
        raise CheckFailed(f"verification: {'; '.join(complaints)}")


def _merged(result: dict[str, Any]) -> list[str]:
    lines = []
    for name, arm in result["arms"].items():
        for parameter, shares in arm["merged"].items():
            into = ", ".join(f"{share:+.4g} {kept}" for kept, share in shares.items()) or "nothing: no effect here"
            lines.append(f"arm {name}: {parameter} is merged into {into}")
    return lines


def _complain(text: str) -> None:
    print(f"cellapp: {text}", file=sys.stderr)
