"""Several commands of ``cellapp`` in one process. Argument: a JSON list of commands; prints their exit codes."""

from __future__ import annotations

import json
import sys

from cellapp.interfaces.cli import main


def exit_code(words: list[str]) -> int | str | None:
    """Run one command."""
    sys.argv = ["cellapp", *words]
    try:
        main()
    except SystemExit as end:
        return end.code
    return 0


if __name__ == "__main__":
    codes = [exit_code(words) for words in json.loads(sys.argv[1])]
    sys.stdout.write(f"\n{json.dumps(codes)}\n")
