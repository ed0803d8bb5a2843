"""``python -m tests.evidence``: list programs; ``NAME [options]``: run one; ``page``: renew what is generated."""

from __future__ import annotations

import sys

from tests.evidence.skeleton import program, programs, run

if __name__ == "__main__":
    match sys.argv[1:]:
        case []:
            for name in programs():
                print(f"{name:12} {program(name).TITLE}")
        case ["page"]:
            from tests.evidence.page import renew

            renew()
        case [name, *arguments] if name in programs():
            sys.exit(run(name, arguments))
        case _:
            sys.exit(f"python -m tests.evidence [page | {' | '.join(programs())}] [options]")
