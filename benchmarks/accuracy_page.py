"""``python -m benchmarks.accuracy_page`` writes docs/accuracy.md with its pictures.

Everything in the page is printed by ``wovenfab accuracy``; finished runs are stored in results/.
"""

from __future__ import annotations

import os
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

import typer

from benchmarks.accuracy_picture import PICTURE, draw
from wovenfab.cli.studies import study_accuracy
from wovenfab.record.results import COMMAND, this_process

ROOT = Path(__file__).parents[1]
RESULTS = Path("results") / "accuracy"
PICTURES = Path("docs") / "pictures"
PAGE = Path("docs") / "accuracy.md"


@dataclass(frozen=True)
class Shown:
    """A study of the page.

    Attributes:
        name: Of its results directory and in the names of its pictures.
        title: Its heading.
        case: The case file.
        settings: Values that replace those of the file.
        minutes: Time for its runs.
        pictures: Stages whose diagrams the page shows; its tables have all.
    """

    name: str
    title: str
    case: str
    settings: tuple[str, ...]
    minutes: float
    pictures: tuple[str, ...] = ("space", "time", "both")

    @property
    def command(self) -> str:
        """The command that makes it."""
        chosen = [word for setting in self.settings for word in ("--set", setting)]
        time = ["--minutes", f"{self.minutes:g}", "-o", str(RESULTS / self.name)]
        return shlex.join(["env/enter", "wovenfab", "accuracy", self.case, *chosen, *time])


_MESH = "discretisation={degree: 3, mesh_size: 50 mm}"
#: One cycle; studies in space have a fourth of its steps.
_CYCLE = (
    "program={type: cycles, amplitudes: 40 mm, max_velocity: 0.5 m/s}",
    "time.steps_per_cycle=40",
)
_SPIN = "effects.spin_friction={strength: 30 N/m, slope: 40 s}"
_BONDED, _ELASTIC = "configs/bonded-1x3.yaml", "configs/elastic-1x3.yaml"
_SLIP, _BOTH = "configs/bias-1x3.yaml", "configs/spin-1x3.yaml"
STUDIES = (
    Shown("bonded", "One placement, elastic", _BONDED, (_MESH,), 1.5),
    Shown("bonded-spin", "One placement, spin friction", _BONDED, (_MESH, *_CYCLE, _SPIN), 7.0, ()),
    Shown("elastic", "Two placements, elastic", _ELASTIC, (), 1.5),
    Shown("slip", "Two placements, slip friction", _SLIP, _CYCLE, 6.0, ("space", "both")),
    Shown("slip-spin", "Two placements, slip and spin friction", _BOTH, _CYCLE, 6.0),
)

_STAGES = {
    "space": "Methods in space, with coarse steps",
    "time": "Schemes in time, on a coarse mesh",
    "both": "Meshes and steps together",
}


def write_page() -> None:
    """Make the studies that have not been made and write the page about all."""
    os.chdir(ROOT)
    for shown in STUDIES:
        print(f"\n{shown.title}: {shown.command}", flush=True)
        os.environ[COMMAND] = shown.command  # which pictures name
        output = RESULTS / shown.name
        if code := study_accuracy(Path(shown.case), output, shown.settings, shown.minutes):
            raise typer.Exit(code)
    text = (Path(__file__).parent / "accuracy_page.md").read_text(encoding="utf-8")
    text += f"\nCode of these figures: commit `{this_process().commit or 'unknown'}`.\n"
    text += "".join(map(_section, STUDIES))
    PAGE.write_text(text, encoding="utf-8")
    os.environ[COMMAND] = "make accuracy"
    draw(text, PICTURE)
    print(f"\npage: {PAGE}")


def _section(shown: Shown) -> str:
    """Return a study's part of the page, and put its pictures beside it."""
    made = RESULTS / shown.name
    answers, tables = (made / "accuracy.md").read_text(encoding="utf-8").split("\n\n**", 1)
    pictures = []
    for stage, title in _STAGES.items():
        if stage in shown.pictures and (picture := made / f"accuracy-{stage}.png").is_file():
            copy = PICTURES / f"accuracy-{shown.name}-{stage}.png"
            shutil.copyfile(picture, copy)
            pictures.append(f"![{title}]({copy.relative_to(PAGE.parent)})")
    parts = [f"## {shown.title}", f"```sh\n{shown.command}\n```", answers, *pictures]
    every = f"<details><summary>All runs</summary>\n\n**{tables.strip()}\n\n</details>"
    return "\n" + "\n\n".join([*parts, every]) + "\n"


if __name__ == "__main__":
    typer.run(write_page)  # which ends without a traceback where it is interrupted
