"""What all programs share: cases on executors, results that resume, limits, intervals, and one file of results."""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from scipy.stats import beta

from cellapp.ground.executors import PoolWork, gather
from cellapp.ground.progress import JobToken, Progress

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
RESULTS = FOLDER / "results"
NO_PROGRAMS = ("__init__", "__main__", "page", "skeleton")
PACKED = {"wire": "wire.attacks", **{name: f"wire.{name}" for name in ("bridge", "presses", "storm")}}
"""Programs that stand in a package."""


@dataclass(frozen=True)
class Table:
    """A table of the page: what it shows, columns, and rows of text; a row may be a case or a mean of many."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Limit:
    """A limit of a figure: at least, at most; None is no limit on that side."""

    what: str
    reached: float
    most: float | None = None
    least: float | None = None

    @property
    def met(self) -> bool:
        return (self.most is None or self.reached <= self.most) and (self.least is None or self.reached >= self.least)

    def words(self) -> str:
        sides = [] if self.least is None else [f"at least {self.least:g}"]
        sides += [] if self.most is None else [f"at most {self.most:g}"]
        return f"{self.what}: {self.reached:.4g} ({', '.join(sides)}{'' if self.met else '; MISSED'})"


@dataclass(frozen=True)
class Evidence:
    """What a program found: ``figures`` by name, as text, for chapters and README; tables; limits; sentences."""

    figures: Mapping[str, str] = field(default_factory=dict)
    tables: Sequence[Table] = ()
    limits: Sequence[Limit] = ()
    said: Sequence[str] = ()


@dataclass(frozen=True)
class Share:
    """``hits`` of ``n``, in words with the exact interval of 95 % (Clopper and Pearson)."""

    hits: int
    n: int

    @classmethod
    def of(cls, facts: Iterable[object]) -> Share:
        """Count the true ones among some facts."""
        known = [bool(fact) for fact in facts]
        return cls(sum(known), len(known))

    @property
    def interval(self) -> tuple[float, float]:
        low = beta.ppf(0.025, self.hits, self.n - self.hits + 1) if self.hits else 0.0
        high = beta.ppf(0.975, self.hits + 1, self.n - self.hits) if self.hits < self.n else 1.0
        return float(low), float(high)

    def __str__(self) -> str:
        if not self.n:
            return ""
        low, high = self.interval
        return f"{self.hits} of {self.n} ({100 * low:.1f} to {100 * high:.1f} %)"


def programs() -> list[str]:
    """Names of all programs."""
    return sorted({path.stem for path in FOLDER.glob("*.py")} - {*NO_PROGRAMS} | PACKED.keys())


def program(name: str) -> ModuleType:
    """The module of a program."""
    return importlib.import_module(f"tests.evidence.{PACKED.get(name, name)}")


def run(name: str, arguments: Sequence[str]) -> int:
    """Run a program; print its results and write results/NAME.json. 1 if a case failed or a limit is missed."""
    module = program(name)
    parser = argparse.ArgumentParser(prog=f"python -m tests.evidence {name}", description=module.__doc__)
    parser.add_argument("--jobs", type=int, help="processes; all cores if left out")
    parser.add_argument("--scheduler", help="address of a Dask scheduler instead")
    parser.add_argument("--resume", action="store_true", help="go on where the same program was stopped")
    for option, default in getattr(module, "OPTIONS", {}).items():
        parser.add_argument(f"--{option}", type=type(default), default=default)
    asked = parser.parse_args(arguments)
    kept = RESULTS / f"{name}.part.jsonl"
    if not asked.resume:
        kept.unlink(missing_ok=True)
    jobs = 1 if getattr(module, "ALONE", False) and asked.scheduler is None else asked.jobs
    work = PoolWork(jobs, asked.scheduler, kept, job=JobToken(_say))
    given = module.cases(asked)
    gathered = gather(_one, partial(program, name), given, dict, name, work, all_may_fail=True)
    if not gathered.found:
        sys.exit(f"{name}: every case failed, nothing was written: {gathered.failed[0]}")
    evidence = module.summary(gathered.found, asked)
    stated = {
        "title": module.TITLE,
        "command": " ".join(["python -m tests.evidence", name, *(one for one in arguments if one != "--resume")]),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": _commit(),
        "cases": len(given),
        "seeds": _ranges(case["seed"] for case in given.values() if "seed" in case),
        "failed": list(gathered.failed),
        **asdict(evidence),
    }
    print(words(stated))
    write(name, stated)
    if not gathered.failed:  # else --resume computes these alone
        kept.unlink(missing_ok=True)
    return int(bool(gathered.failed) or not all(limit.met for limit in evidence.limits))


def write(name: str, stated: Mapping[str, Any]) -> None:
    """Write the results of a program."""
    text = json.dumps(stated, indent=1, ensure_ascii=False)
    (RESULTS / f"{name}.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def stated_results() -> dict[str, dict[str, Any]]:
    """Name -> results that are kept, of every program that has some."""
    return {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(RESULTS.glob("*.json"))}


def words(stated: Mapping[str, Any]) -> str:
    """Tables, sentences, limits and failures as Markdown."""
    lines = []
    for table in stated["tables"]:
        lines += [f"**{table['title']}**", ""] if table["title"] else []
        rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
        lines += [*("| " + " | ".join(row) + " |" for row in rows), ""]
    lines += [sentence for one in stated["said"] for sentence in (one, "")]
    limits = [Limit(**limit).words() for limit in stated["limits"]]
    lines += [f"Limits: {'; '.join(limits)}.", ""] if limits else []
    failed = stated["failed"]
    lines += [f"Failed, {len(failed)} of {stated['cases']}: {'; '.join(failed)}", ""] if failed else []
    return "\n".join(lines).rstrip()


def _one(module: ModuleType, case: Any) -> dict[str, Any]:
    found: dict[str, Any] = module.one(case)
    return found


def _ranges(seeds: Iterable[int]) -> str:
    """Whole numbers as ranges: 0 to 9, 12."""
    ends = list[list[int]]()
    for seed in sorted(set(seeds)):
        if ends and seed == ends[-1][1] + 1:
            ends[-1][1] = seed
        else:
            ends.append([seed, seed])
    return ", ".join(f"{low} to {high}" if high > low else f"{low}" for low, high in ends)


def _say(event: object) -> None:
    if isinstance(event, Progress) and sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{event.job} {event.done}/{event.total} {event.note}")
        sys.stderr.flush()


def _commit() -> str:
    """The commit that measured, and whether anything but results had been changed since it."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False
        ).stdout.strip()

    changed = git("status", "--porcelain", "--", ".", ":(exclude)tests/evidence/results")
    return f"{git('rev-parse', '--short=10', 'HEAD') or 'not recorded'}{' and changes' if changed else ''}"
