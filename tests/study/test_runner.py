"""What is told of a process that failed."""

from __future__ import annotations

from pathlib import Path

import pytest

from wovenfab.study.runner import Command, execute

RULE = "-" * 74
REFUSED = f"{RULE}\nThe launcher does not run\nas root.\n\nIt may be told to.\n{RULE}"


@pytest.mark.parametrize(
    ("output", "told"),
    [
        pytest.param("reading\nerror: no such file", "error: no such file", id="its last line"),
        pytest.param(
            f"error: no such file\n{RULE}\nOne process has failed.\n{RULE}",
            "error: no such file",
            id="not what the launcher says of it",
        ),
        pytest.param(REFUSED, "The launcher does not run as root.", id="why it was not launched"),
        pytest.param("", "exit code 3", id="the exit code of a silent one"),
    ],
)
@pytest.mark.parametrize("logged", [False, True])
def test_the_useful_line_is_told(output: str, told: str, logged: bool, tmp_path: Path) -> None:
    script = tmp_path / "fails.py"
    script.write_text(f"import sys\nprint({output!r}, file=sys.stderr)\nsys.exit(3)\n")
    log = tmp_path / "log" if logged else None
    assert execute(Command([str(script)], log=log)).failure == told
