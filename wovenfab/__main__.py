"""The ``wovenfab`` command, also as ``python -m wovenfab``.

With ``-m`` nothing is imported from the current folder, which Python has put first: a file there
may bear the name of any module.
"""

import sys
from pathlib import Path


def main() -> None:
    """Run the command; what it needs from the start may be missing."""
    try:
        from wovenfab.cli.app import main as run
    except ModuleNotFoundError as error:
        from wovenfab.lacking import module_is_missing

        print(f"wovenfab: {module_is_missing(error)}", file=sys.stderr)
        sys.exit(2)
    run()


if __name__ == "__main__":
    if not sys.flags.safe_path:
        sys.path[0] = str(Path(__file__).resolve().parents[1])
    main()
