"""``python -m benchmarks.accuracy_page`` writes docs/accuracy.md with its pictures.

Everything in the page is printed by ``wovenfab accuracy``; finished runs are stored in results/.
"""

from __future__ import annotations

import os
import shlex
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import typer
from PIL import Image

from wovenfab.cli.studies import study_accuracy
from wovenfab.record.results import COMMAND, this_process
from wovenfab.report.style import write_png

ROOT = Path(__file__).parents[1]
RESULTS = Path("results") / "accuracy"
PICTURES = Path("docs") / "pictures"
PAGE = Path("docs") / "accuracy.md"
#: The picture of a study that README.md shows, too.
SHOWN, README = "slip", PICTURES / "accuracy.png"


@dataclass(frozen=True)
class Shown:
    """A study of the page.

    Attributes:
        name: Of its results directory and in the name of its picture.
        title: Its heading.
        case: The case file.
        settings: Values that replace those of the file.
    """

    name: str
    title: str
    case: str
    settings: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """The command that makes it."""
        chosen = [word for setting in self.settings for word in ("--set", setting)]
        output = ["-o", str(RESULTS / self.name)]
        return shlex.join(["env/enter", "wovenfab", "accuracy", self.case, *chosen, *output])


LEVELS = 2
_CYCLE = ("program={type: cycles, amplitudes: 40 mm, max_velocity: 0.5 m/s}",)
_SPIN = "effects.spin_friction={strength: 30 N/m, slope: 40 s}"
_BONDED = "configs/bonded-1x3.yaml"
STUDIES = (
    Shown("bonded", "One placement, elastic", _BONDED),
    Shown("bonded-spin", "One placement, spin friction", _BONDED, (*_CYCLE, _SPIN)),
    Shown("elastic", "Two placements, elastic", "configs/elastic-1x3.yaml"),
    Shown("slip", "Two placements, slip friction", "configs/bias-1x3.yaml", _CYCLE),
    Shown("slip-spin", "Two placements, slip and spin friction", "configs/spin-1x3.yaml", _CYCLE),
)


def write_page() -> None:
    """Make the studies that have not been made and write the page about all."""
    os.chdir(ROOT)
    for shown in STUDIES:
        print(f"\n{shown.title}: {shown.command}", flush=True)
        os.environ[COMMAND] = shown.command  # which pictures name
        if code := study_accuracy(Path(shown.case), RESULTS / shown.name, shown.settings, LEVELS):
            raise typer.Exit(code)
    text = (Path(__file__).parent / "accuracy_page.md").read_text(encoding="utf-8")
    text += f"\nCode of these figures: commit `{this_process().commit or 'unknown'}`.\n"
    text += "".join(map(_section, STUDIES))
    PAGE.write_text(text, encoding="utf-8")
    with Image.open(RESULTS / SHOWN / "accuracy.png") as picture:  # the README names this command
        write_png(picture.convert("RGB"), README, replace(this_process(), command="make accuracy"))
    print(f"\npage: {PAGE}")


def _section(shown: Shown) -> str:
    """Return a study's part of the page, and put its picture beside it."""
    made, copy = RESULTS / shown.name, PICTURES / f"accuracy-{shown.name}.png"
    shutil.copyfile(made / "accuracy.png", copy)
    answers = (made / "accuracy.md").read_text(encoding="utf-8").strip()
    picture = f"![Error against seconds]({copy.relative_to(PAGE.parent)})"
    return f"\n## {shown.title}\n\n```sh\n{shown.command}\n```\n\n{answers}\n\n{picture}\n"


if __name__ == "__main__":
    typer.run(write_page)  # which ends without a traceback where it is interrupted
