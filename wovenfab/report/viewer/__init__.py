"""The script that shows a run in ParaView in one step."""

from __future__ import annotations

from pathlib import Path

from wovenfab.record.results import write_whole

SCRIPT = "open_in_paraview.py"


def write_viewer(directory: Path) -> Path:
    """Write the script into a results directory and return its path.

    It finds the results beside itself; inside ParaView's window a script does not know where
    it is, so that it is told where the results are now.
    """
    text = (Path(__file__).parent / SCRIPT).read_text(encoding="utf-8")
    here = f"RESULTS = {str(directory.resolve())!r}"
    path = directory / SCRIPT
    write_whole(path, text.replace('RESULTS = ""', here, 1))
    return path
