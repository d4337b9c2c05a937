"""``python -m wovenfab`` is the ``wovenfab`` command.

Nothing is imported from the current folder, which Python has put first: a file there may bear
the name of any module.
"""

import sys
from pathlib import Path

if __name__ == "__main__":
    if not sys.flags.safe_path:
        sys.path[0] = str(Path(__file__).resolve().parents[1])
    from wovenfab.cli.app import main

    main()
