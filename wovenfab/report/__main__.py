"""``python3 -m wovenfab.report DIR``: draw, print each file, say on stderr what failed."""

from __future__ import annotations

import sys

from wovenfab.report.pictures import ReportError, draw


def main(arguments: list[str]) -> int:
    """Draw the pictures of the one directory named; return the exit code."""
    if len(arguments) != 1:
        print("usage: python3 -m wovenfab.report DIR", file=sys.stderr)
        return 2
    try:
        drawn, problem = draw(arguments[0]), None
    except ReportError as error:
        drawn, problem = error.drawn, str(error)
    for path in drawn:
        print(path)
    if problem:
        print(problem, file=sys.stderr)
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
