"""``python -m benchmarks.random_scenes [COUNT] [SEED] [FINER]``: 1 % on fabrics drawn at random.

Each scene is run as a user would run it, on two ranks and with an empty cache of compiled forms;
the first FINER ones for 0.3 %, too. Then the results of each are compared with those of finer
cells of another degree and of shorter steps, also where the accuracy was not reached. These
references are not timed: two are run at once. Rows are stored: a command that is repeated goes on.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.case import Case, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.record.results import markdown, this_process
from wovenfab.record.summary import read_summary
from wovenfab.study.response import NOTHING
from wovenfab.study.runner import (
    Command,
    Ended,
    Store,
    execute,
    execute_all,
    here,
)
from wovenfab.study.target_accuracy.choice import slowness
from wovenfab.study.target_accuracy.time_steps import ALMOST

ROOT = Path(__file__).parents[1]
RESULTS = Path("results") / "random"
COUNT, SEED, FINER_COUNT = 100, 1, 100
ACCURACY, FINER_ACCURACY, RANKS = 0.01, 0.003, 2
#: Seconds in which 1 % is wanted, and after which a run (0.3 % is wanted in that time) and its
#: reference are ended.
WANTED, LIMIT, REFERENCE_LIMIT = 60.0, 300.0, 900.0
#: Error (%) that may be larger than what is said.
MORE = 0.1
#: Size of the reference's cells over that of the run, with a degree more and with a degree less,
#: which it has where the run has the largest.
FINER, FINER_BY_FAR, LARGEST_DEGREE = 0.6, 0.4, 5
#: Steps of the reference over those of the run: where these do not resolve how friction lets go,
#: twice as many halve the error at best.
SHORTER = 4
#: What a row says whose reference failed.
NO_REFERENCE = "no reference"
#: Effects that all scenes have.
IN_ALL = "stretch, shear, bending, "
#: Writes the case of a scene of a number and seed into a folder, for an accuracy.
Scenes = Callable[[int, int, Path, float], Path]
FIGURES = ("peak_force_N", "dissipated_J")


@dataclass(frozen=True)
class Row:
    """A scene's errors and cost.

    Attributes:
        scene: Its number.
        kind: Its effects and shape in words.
        unknowns, steps: Of the run for the accuracy.
        seconds: Its wall time with all trials and compiling.
        pilot: Part of it that all trials took.
        stated, true: Largest relative error of the figures, as said and against the reference;
            None where there is none, or not yet.
        reason: Why it fell short or failed; empty if not.
        slowness: Of the machine then, over that of the machine of ``check``.
        commit: Commit of the code; empty if unknown.
    """

    scene: int
    kind: str
    unknowns: int
    steps: int
    seconds: float
    pilot: float
    stated: float | None
    true: float | None
    reason: str
    slowness: float = 1.0
    commit: str = ""

    @property
    def fell_short(self) -> bool:
        """Whether it failed or says that its accuracy is not reached; a reference may lack."""
        return bool(self.reason.partition(NO_REFERENCE)[0])

    def reaches(self, accuracy: float, seconds: float) -> bool:
        """Return whether an accuracy was reached in a time (s), as far as is known."""
        errors = [e for e in (self.stated, self.true) if e is not None]
        reached = bool(errors) and max(errors) <= ALMOST * accuracy and not self.fell_short
        return reached and self.seconds <= seconds

    @property
    def is_good(self) -> bool:
        """Whether the usual accuracy was reached in the time that is wanted."""
        return self.reaches(ACCURACY, WANTED)

    @property
    def lacks_reference(self) -> bool:
        """Whether it has results that were not compared yet."""
        return self.true is None and self.unknowns > 0 and NO_REFERENCE not in self.reason

    @property
    def is_honest(self) -> bool:
        """Whether the true error is not much above what is said."""
        if self.true is None or self.stated is None:
            return True
        return 100 * (self.true - self.stated) <= MORE


def scene(number: int, seed: int, folder: Path, accuracy: float = ACCURACY) -> Path:
    """Write the case of a scene into a folder; return the file.

    Args:
        number: Of the scene; it and the seed decide on everything.
        seed: Of all scenes.
        folder: An existing folder.
        accuracy: That is wanted.
    """
    draw = np.random.default_rng([seed, number])

    def value(low: float, high: float, unit: str = "") -> str | float:
        drawn = float(f"{np.exp(draw.uniform(np.log(low), np.log(high))):.4g}")
        return f"{drawn:g} {unit}" if unit else drawn

    width = float(value(0.05, 0.4))
    length = float(f"{width * draw.uniform(1.5, 4.0):.4g}")
    sheet, shape = _sheet(draw, length, width, folder)
    if draw.random() < 0.5:
        first, between = 45.0, 90.0
    else:
        first, between = draw.uniform(30, 60), draw.uniform(70, 110)
    sheet["fibres"] = [f"{first:.1f} deg", f"{first - between:.1f} deg"]
    effects: dict[str, Any] = {
        "stretch": {"stiffness": value(1e5, 1.6e8, "N/m")},
        "shear": {"stiffness": value(3, 1e3, "N/m")},
        "bending": {"stiffness": value(1e-3, 3e2, "N*m")},
    }
    if draw.random() < 0.6:
        effects["coupling"] = {"stiffness": value(1e5, 3e8, "N/m^3")}
        if draw.random() < 0.8:
            strength = value(1e3, 3e5, "N/m^2")
            effects["slip_friction"] = _friction(draw, strength, value(10, 1e3, "s/m"))
    if draw.random() < 0.4:
        strength = value(1, 60, "N/m")
        effects["spin_friction"] = _friction(draw, strength, value(3, 100, "s"))
    pulled = f"{1e3 * length * draw.uniform(0.01, 0.06):.4g} mm"
    velocity = value(1e-3, 0.1, "m/s")
    if draw.random() < 0.5:
        program = {"type": "cycles", "amplitudes": [pulled], "max_velocity": velocity}
    else:
        program = {"type": "ramp", "to": pulled, "steps": 20, "velocity": velocity}
    case = {
        "title": f"{shape}, {', '.join(effects)}, {program['type']}",
        "sheet": sheet,
        "effects": effects,
        "boundary": {"left": "clamp", "right": {"displacement": ["program", 0]}},
        "program": program,
        "accuracy": f"{100 * accuracy:g} %",
        "output": {"pictures": False},
    }
    path = folder / f"scene-{seed}-{number}.yaml"
    path.write_text(json.dumps(case, indent=1), encoding="utf-8")
    return path


def _sheet(
    draw: np.random.Generator, length: float, width: float, folder: Path
) -> tuple[dict[str, Any], str]:
    """Return the sheet's section and its shape: mostly rectangles, also holes and dog-bones."""
    kind = draw.random()
    if kind < 0.8:
        return {"shape": "rectangle", "length": length, "width": width}, "rectangle"
    if kind < 0.9:
        shape = "hole"
        sizes = {"length": length, "width": width, "radius": width * draw.uniform(0.1, 0.25)}
    else:
        shape = "dogbone"
        narrow = width * draw.uniform(0.6, 0.9)
        sizes = {"grip_length": 0.2 * length, "grip_width": width, "gauge_width": narrow}
        sizes["gauge_length"] = 0.6 * length - (width - narrow)
    text = (ROOT / "meshes" / f"{shape}.geo").read_text(encoding="utf-8")
    for name, size in {**sizes, "size": width / 8}.items():
        text = re.sub(rf"\b{name} = {{[^}}]*}}", f"{name} = {{{size:.5g}}}", text)
    (folder / f"{shape}.geo").write_text(text, encoding="utf-8")
    return {"file": f"{shape}.geo"}, shape


def _friction(draw: np.random.Generator, strength: str | float, slope: str | float) -> Any:
    if draw.random() < 0.25:
        return {"law": "coulomb", "strength": strength}
    return {"strength": strength, "slope": slope}


def row(
    number: int, seed: int, folder: Path, accuracy: float = ACCURACY, drawn: Scenes = scene
) -> Row:
    """Run a scene.

    Args:
        number: Of the scene.
        seed: Of all scenes.
        folder: For its files and results.
        accuracy: That is wanted.
        drawn: Writes scenes.
    """
    path, out, cache = drawn(number, seed, folder, accuracy), folder / "run", folder / "cache"
    kind = read_case(path).title
    shutil.rmtree(cache, ignore_errors=True)  # of a run that was broken off
    slow, commit = slowness(), this_process().commit
    ended = execute(_run(path, out, LIMIT, {"XDG_CACHE_HOME": str(cache)}))
    shutil.rmtree(cache, ignore_errors=True)
    if ended.failure:
        return Row(
            number,
            kind,
            0,
            0,
            ended.seconds,
            ended.seconds,
            None,
            None,
            _cause(ended),
            slow,
            commit,
        )
    summary = read_summary(out)
    said = summary["accuracy"]
    errors = [f["relative_error"] for f in said.get("figures", {}).values()]
    stated = None if None in errors else max(errors, default=None)
    return Row(
        number, kind, summary["unknowns"], summary["steps"], ended.seconds,
        summary["wall_time_s"]["pilot"], stated, None, said["shortfall"],
        slow, commit,
    )  # fmt: skip


def _cause(ended: Ended) -> str:
    """Return why a run failed, without what can be done and where its results are."""
    return ended.failure.partition(";")[0]


def compare(
    store: Store, rows: dict[str, Row], seed: int, accuracy: float, drawn: Scenes = scene
) -> None:
    """Give rows their true errors, by runs with finer cells and shorter steps.

    Args:
        store: Has the results of the rows.
        rows: By their names; those that are compared already stay as they are.
        seed: Of all scenes.
        accuracy: For which the rows were made.
        drawn: Writes scenes.
    """
    names = [name for name, made in rows.items() if made.lacks_reference]

    def keep(index: int, ended: Ended) -> None:
        name = names[index]
        folder = store.folder / name
        rows[name] = compared(rows[name], folder, ended)
        _keep(store, name, key_of(rows[name].scene, seed, folder, accuracy, drawn), rows[name])

    execute_all([_reference(store.folder / name) for name in names], here(RANKS), keep)


def _reference(folder: Path) -> Command:
    """Return the command that runs the reference of a run in a folder."""
    path = folder / "reference.yaml"
    finer = finer_case(read_case(folder / "run" / "case.yaml"))
    path.write_text(finer.to_yaml(), encoding="utf-8")
    return replace(_run(path, folder / "reference", REFERENCE_LIMIT, {}), ranks=1)


def compared(made: Row, folder: Path, ended: Ended) -> Row:
    """Return a row with its true error.

    Args:
        made: A row of a scene that was run.
        folder: Where that and its reference were.
        ended: How the reference ended.
    """
    if ended.failure:
        words = f"{NO_REFERENCE}: {_cause(ended)}"
        return replace(made, reason=f"{made.reason}; {words}" if made.reason else words)
    summary, exact = read_summary(folder / "run"), read_summary(folder / "reference")
    nothing = NOTHING * abs(exact["peak_force_N"] * exact["peak_force_at_m"])
    errors = [abs(summary[f] / exact[f] - 1) for f in FIGURES if abs(exact[f]) > nothing]
    shutil.rmtree(folder / "reference", ignore_errors=True)
    return replace(made, true=max(errors))


def finer_case(case: Case) -> Case:
    """Return the case of a run with finer cells of another degree, and with shorter steps.

    Those of an elastic sheet have no error, and stay as they are.
    """
    d, time = case.discretisation, case.time
    degree, size = d.degree + 1, FINER
    if d.degree == LARGEST_DEGREE:
        degree, size = d.degree - 1, FINER_BY_FAR
    changes: dict[str, Any] = {"discretisation.degree": degree}
    if d.mesh_size is not None:
        changes["discretisation.mesh_size"] = size * d.mesh_size
    if not case.needs.history:
        return case.changed(changes)
    changes["time.steps_per_cycle"] = SHORTER * time.steps_per_cycle
    if time.tolerance is not None:
        changes["time.tolerance"] = time.tolerance / SHORTER**2
    if steps := getattr(case.program[0], "steps", None):
        changes["program.steps"] = SHORTER * steps
    return case.changed(changes)


def _run(path: Path, out: Path, limit: float, cache: Mapping[str, str]) -> Command:
    arguments = ["-m", "wovenfab", "run", str(path), "-o", str(out), "--overwrite"]
    return Command(arguments, RANKS, limit=limit, environment=cache)


def list_of(rows: list[Row]) -> str:
    """Return the rows as a table."""

    def percent(share: float | None) -> str:
        return "" if share is None else f"{100 * share:.2g} %"

    cells = [
        [str(r.scene), r.kind.replace(IN_ALL, ""), str(r.unknowns), str(r.steps),
         f"{r.seconds:.0f} s", percent(r.stated), percent(r.true), r.reason]
        for r in rows
    ]  # fmt: skip
    head = ["scene", "what it has", "unknowns", "steps", "time", "stated", "true", "fell short"]
    return markdown(head, cells, (1, 7))


def honesty(rows: list[Row], accuracy: float) -> str:
    """Return in a sentence which of the rows for an accuracy have a larger error than they say."""
    known = [r for r in rows if r.true is not None]
    dishonest = [str(r.scene) for r in known if not r.is_honest]
    return (
        f"For {100 * accuracy:g} %, numbers of the scenes whose true error is more than {MORE:g} % "
        "above the stated one: "
        f"{', '.join(dishonest) or 'none'} of {len(known)} with a reference."
    )


def commits(rows: list[Row]) -> str:
    """Return in a sentence which commits made the rows."""
    known = sorted({row.commit for row in rows if row.commit})
    return f"Code of these figures: commit {', '.join(f'`{c}`' for c in known) or 'unknown'}."


def table(rows: list[Row], accuracy: float = ACCURACY, wanted: float = WANTED) -> str:
    """Return the rows for an accuracy as a table, and what they amount to."""
    good = sum(r.reaches(accuracy, wanted) for r in rows)
    words = f"{good} of {len(rows)} within {100 * accuracy:g} % and {wanted:g} s on {RANKS} ranks."
    return "\n".join([list_of(rows), "", words, honesty(rows, accuracy), commits(rows)])


def name_of(number: int, seed: int, accuracy: float) -> str:
    """Return the name under which a scene is stored."""
    return f"{seed}-{number}" + (f"-{accuracy:g}" if accuracy != ACCURACY else "")


def rows_for(
    store: Store, count: int, seed: int, accuracy: float, drawn: Scenes = scene
) -> dict[str, Row]:
    """Return the rows of so many scenes by their names, of which those that lack are run."""
    rows = {}
    for number in range(1, count + 1):
        name = name_of(number, seed, accuracy)
        folder = store.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        key = key_of(number, seed, folder, accuracy, drawn)
        known = store.load(name, key)
        rows[name] = Row(**known) if known else row(number, seed, folder, accuracy, drawn)
        if not known:
            _keep(store, name, key, rows[name])
    return rows


def key_of(number: int, seed: int, folder: Path, accuracy: float, drawn: Scenes = scene) -> str:
    """Return a mark of what a row depends on: the scene and the code."""
    return fingerprint(read_case(drawn(number, seed, folder, accuracy)))


def _keep(store: Store, name: str, key: str, made: Row) -> None:
    store.save(name, key, asdict(made))
    print(made, flush=True)


def main(count: int, seed: int, finer: int) -> None:
    """Run the scenes, then their references; print each row, and the tables."""
    store = Store(RESULTS.resolve())
    wanted = ((ACCURACY, count, WANTED), (FINER_ACCURACY, finer, LIMIT))
    made = [rows_for(store, number, seed, accuracy) for accuracy, number, _ in wanted]
    for rows, (accuracy, _, seconds) in zip(made, wanted, strict=True):
        compare(store, rows, seed, accuracy)
        print("\n" + table(list(rows.values()), accuracy, seconds))


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:4]]
    main(*(given + [COUNT, SEED, FINER_COUNT][len(given) :]))
