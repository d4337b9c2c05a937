"""``python3 -m tests.fuzz.results [COUNT]``: damaged results directories, each used by commands.

``report``, ``export`` and ``resume`` end with exit code 0, 2 or 3 and no traceback, in 120 s of a
processor. What is printed has no control characters. Reading executes nothing. The files of the run
are those before, but for what a resumed run adds; a refused one changes nothing.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from tests.fuzz.__main__ import CLOCK, EFFECT, VALUES, finish, mutated, processor_time
from wovenfab.record.field_file import newest_checkpoint
from wovenfab.record.history import REACTIONS, read_history
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import NothingToResumeError
from wovenfab.record.summary import read_cycles
from wovenfab.report.run_data import open_run_data, stored_of

COUNT, SECONDS = 300, 120.0
#: How many directories are read only, for each that is given to commands.
READ = 20
#: How a command may end: done, refused, a step that cannot be made.
ENDS = (0, 2, 3)
GOOD = {"good", "read", "refused", "went on"}
CASE = """\
title: small
sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
discretisation: {degree: 2, mesh_size: 100 mm}
effects:
  stretch: {stiffness: 100 kN/m}
  shear: {stiffness: 50 N/m}
  coupling: {stiffness: 1e6 N/m^3}
  slip_friction: {strength: 100 kN/m^2, slope: 70 s/m}
  my_effect: {file: my_effect.py, stiffness: 4 N/m}
boundary:
  left: clamp
  right: {displacement: [program, 0]}
program: {type: cycles, amplitudes: [5 mm, 10 mm], max_velocity: 10 mm/s}
time: {steps_per_cycle: 6}
output: {every: 2, pictures: false, fields: [displacement, shear_angle], checkpoint: 2}
"""
#: Notes that the file of the effect was run.
NOTE = "\nimport pathlib\npathlib.Path(__file__).with_name('executed').touch()\n"
#: Files that belong to a run, and are damaged.
FILES = (
    *("history.csv", "reactions.csv", "summary.json", "case.yaml", "cycles.csv"),
    *("fields.h5", "fields.xdmf", "checkpoint.h5", "checkpoint-earlier.h5", ".wovenfab"),
    *("fields/mesh.h5", "fields/000000.h5", "fields/000004.h5"),
)
#: What each command reads, by parts of the names of files.
COMMANDS = {
    "report": ("history", "summary", "case", "cycles", "fields", "mesh", "0000"),
    "export": ("history", "summary", "case", "fields", "mesh", "0000"),
    "resume": ("history", "reactions", "case", "checkpoint", "fields", "mesh", "0000", ".wovenfab"),
}
FOREIGN = (
    *(b"", b"\n", b"{}", b"[]", b"null", b"a,b\n1,2\n", b"step,time_s\n0,0\n0,0\n", b"\x00" * 99),
    *(b"\x89HDF\r\n\x1a\n", b"<html>", b"[" * 5000, b'{"outcome": "finished"}', b"\xff\xfe1\x00"),
    *(
        b"title: a\ntitle: b\n",
        b"&a [*a, *a]",
        b"sheet: [1]\n",
        b"- 1\n",
        b"title: '\x1b]0;x\x07'\n",
    ),
    *(b'title: "\\e]0;x\\a $\\\\frac{$ [/b]"\n', b"sheet: {fibres: [45 deg]}\n"),
    *(b"sheet: {fibres: [9**9**9**9, 1]}\n", b"sheet: {fibres: [.nan, 45 kg]}\n"),
)


@dataclass(frozen=True)
class Outcome:
    """How commands ended: ``good``, one of them ``read``, ``refused`` or ``went on``, or badly."""

    kind: str
    words: str = ""


def make(folder: Path) -> list[Path]:
    """Return results directories: of a run that was stopped, and of one that has ended."""
    folder.mkdir(exist_ok=True)
    (folder / "my_effect.py").write_text(EFFECT + NOTE, encoding="utf-8")
    (folder / "case.yaml").write_text(CASE, encoding="utf-8")
    made = []
    for name, more in (("stopped", ("--until", "3.5 s")), ("ended", ())):
        code, said = run(("run", "case.yaml", "-o", name, *more), folder)
        if code:
            raise RuntimeError(said)
        if (ended := run(("report", name), folder))[0]:
            raise RuntimeError(ended[1])
        made.append(folder / name)
    return made


def _values(text: str, generator: random.Random) -> str:
    """Return a text with one of its values replaced."""
    spans = [m.span() for m in re.finditer(r"[^\s,:{}\[\]\"]+", text)]
    start, end = generator.choice(spans) if spans else (0, 0)
    return text[:start] + generator.choice((*VALUES, "-1", "1e300")) + text[end:]


def _data(path: Path, generator: random.Random) -> str:
    """Change a data set, an attribute or a link of an HDF5 file; return what was done."""
    with h5py.File(path, "r+", locking=False) as file:
        names: list[str] = list(file)
        for name in list(names):
            if file.get(name, getclass=True, getlink=True) is h5py.HardLink and isinstance(
                file[name], h5py.Group
            ):
                names += [f"{name}/{child}" for child in file[name]]
        name = generator.choice(names)
        choice = generator.randrange(6)
        if choice == 5 and file.attrs:
            attribute = generator.choice(list(file.attrs))
            file.attrs[attribute] = generator.choice((-1, "x", np.nan, 10**9))
            return f"attribute {attribute}"
        values = file[name][()] if name in file and isinstance(file[name], h5py.Dataset) else None
        del file[name]
        if choice == 0:
            file[name] = h5py.ExternalLink("/proc/version", "/")
        elif choice == 1:
            file[name] = h5py.SoftLink(f"/{name}")
        elif choice == 2 and isinstance(values, np.ndarray):
            file[name] = generator.choice((values[:-1], values.ravel(), values[:0], -values - 1))
        elif choice == 3 and isinstance(values, np.ndarray):
            file[name] = np.full(values.shape, generator.choice((np.nan, np.inf, -1, 2**40)))
        elif choice == 4:
            file[name] = "text"
        return f"{name}, change {choice}"


def damage(directory: Path, generator: random.Random) -> str:
    """Change a results directory in one or two places; return what was done."""
    done = []
    for _ in range(generator.choice((1, 1, 1, 2))):
        path = directory / generator.choice(FILES)
        choice = generator.randrange(11)
        content = path.read_bytes() if path.is_file() else b""
        said = f"{path.name}: change {choice}"
        if choice == 0:
            path.unlink(missing_ok=True)
        elif choice == 1:
            path.write_bytes(content[: generator.randrange(len(content) + 1)])
        elif choice == 2:
            path.write_bytes(generator.randbytes(generator.randrange(1, 4000)))
        elif choice == 3 and content:
            changed = bytearray(content)
            for _ in range(generator.randint(1, 20)):
                changed[generator.randrange(len(changed))] ^= 1 << generator.randrange(8)
            path.write_bytes(changed)
        elif choice == 4:
            path.write_bytes(generator.choice(FOREIGN))
        elif choice == 5:
            other = directory / generator.choice(FILES)
            path.write_bytes(other.read_bytes() if other.is_file() else b"")
        elif choice == 6:
            path.unlink(missing_ok=True)
            path.mkdir()
        elif choice == 7:
            path.unlink(missing_ok=True)
            path.symlink_to("nowhere")
        elif path.suffix == ".h5" and path.is_file():
            try:
                said = f"{path.name}: {_data(path, generator)}"
            except (OSError, KeyError, ValueError, RuntimeError, TypeError):
                said += " failed"
        elif path.is_file():
            text = content.decode("utf-8", errors="replace")
            is_case = path.suffix == ".yaml"
            text = mutated(text, directory, generator) if is_case else _values(text, generator)
            path.write_bytes(text.encode("utf-8", errors="replace"))
        done.append(said)
    return "; ".join(done)


def contents(directory: Path) -> dict[str, str]:
    """Return a digest of each file of a run."""
    files = [directory / name for name in FILES]
    files += sorted((directory / "fields").glob("*")) if (directory / "fields").is_dir() else []
    return {
        str(p.relative_to(directory)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in files
        if p.is_file()
    }


def _enter(arguments: tuple[str, ...], folder: str, said: str) -> None:
    """Be the command in a process of its own, which prints into a file."""
    os.chdir(folder)
    out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    sys.argv = ["wovenfab", *arguments]
    from wovenfab.cli.app import main

    main()


def run(arguments: tuple[str, ...], folder: Path) -> tuple[int | None, str]:
    """Return exit code (None after a time without an end) and output of a command."""
    with tempfile.NamedTemporaryFile() as said:
        process = _CONTEXT.Process(target=_enter, args=(arguments, str(folder), said.name))
        process.start()
        until = time.monotonic() + CLOCK * SECONDS
        while process.exitcode is None and time.monotonic() <= until:
            process.join(0.1)
            if process.pid and processor_time(process.pid) > SECONDS:
                break
        code = process.exitcode
        if code is None:
            process.kill()
            process.join()
        return code, Path(said.name).read_text(encoding="utf-8", errors="replace")


#: Processes are forked from one that has loaded the commands, but not MPI.
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["wovenfab.cli.app", "wovenfab.report.pages"])


def checked(seed: int, bases: list[Path]) -> tuple[str, Outcome]:
    """Return what was damaged, and how the commands end."""
    generator = random.Random(seed)
    base = generator.choice(bases)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        directory = folder / "run"
        shutil.copytree(base, directory)
        effect = folder / "my_effect.py"
        effect.write_text(EFFECT + NOTE, encoding="utf-8")
        case = directory / "case.yaml"
        text = re.sub(r"file: \S*my_effect.py", f"file: {effect}", case.read_text())
        case.write_text(text)
        done = f"{base.name}: {damage(directory, generator)}"
        ended = []
        for command, files in COMMANDS.items():
            if not any(name in done for name in files):
                continue
            outcome = _judged((command, "run", *(["--last"] * (command == "export"))), folder)
            if outcome.kind not in GOOD:
                return done, Outcome(f"{command}: {outcome.kind}", outcome.words)
            ended.append(f"{command} {outcome.kind} ({outcome.words[:160]})")
        return done, Outcome("good", ", ".join(ended))


def _judged(command: tuple[str, ...], folder: Path) -> Outcome:
    directory = folder / "run"
    before, rows = contents(directory), _rows(directory)
    code, text = run(command, folder)
    words = (text.strip().splitlines() or [""])[-1]
    if code is None:
        return Outcome("no end", words)
    if "Traceback" in text or "fault of the program" in text:
        return Outcome("traceback", words)
    if any((ord(c) < 32 and c != "\n") or "\x7f" <= c < "\xa0" for c in text):
        return Outcome("control characters", repr(text))
    if code not in ENDS or (code and not words):
        return Outcome(f"exit code {code}", words)
    executed = (folder / "executed").exists()
    if executed and (command[0] != "resume" or "my_effect.py" not in text):
        return Outcome("something was executed", words)
    after = contents(directory)
    if command[0] != "resume" or code == 2:
        if changed := [name for name in before if after.get(name) != before[name]]:
            return Outcome("files changed", f"{', '.join(changed)} by: {words}")
    elif any(new != old for new, old in zip(_rows(directory), rows, strict=False)):
        return Outcome("other rows", words)
    done = "went on" if command[0] == "resume" else "read"
    return Outcome("refused" if code == 2 else done, words)


def _rows(directory: Path) -> list[str]:
    """Return the rows of the history that a resumed run keeps: those up to the checkpoint."""
    try:
        with h5py.File(directory / "checkpoint-earlier.h5", "r", locking=False) as file:
            step = int(json.loads(file["state"][()])["step"])
        return (directory / "history.csv").read_text().splitlines()[: step + 2]
    except (OSError, KeyError, ValueError, TypeError, RuntimeError):
        return []


def misread(seed: int, bases: list[Path]) -> tuple[str, str]:
    """Return what was damaged, and what readers raise although it names no file; empty if none."""
    generator = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name) / "run"
        shutil.copytree(generator.choice(bases), directory)
        done = damage(directory, generator)
        before = contents(directory)
        for read in (open_run_data, read_cycles, _read_fields, _read_rows, newest_checkpoint):
            try:
                read(directory)
            except (OSError, UnreadableResultsError, NothingToResumeError) as error:
                if str(directory) not in str(error):
                    return done, f"{read.__name__}: no file in {error!r}"
            except ValueError as error:
                if "without a single step" not in str(error):
                    return done, f"{read.__name__}: {error!r}"
            except Exception as error:
                return done, f"{read.__name__}: {error!r}"
        return done, "" if contents(directory) == before else "files changed"


def _read_fields(directory: Path) -> None:
    stored = stored_of(directory)
    if stored is not None:
        stored.triangles(), stored.corners()
        for index in range(len(stored.times)):
            for name in stored.units:
                stored.field(name, index)


def _read_rows(directory: Path) -> None:
    read_history(directory, REACTIONS)


def fuzz(seeds: range, jobs: int = 2, show: Callable[[str], None] = print) -> Counter[str]:
    """Damage a directory for each seed, show what went wrong, and return counts by outcome."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(jobs) as pool:
        bases = make(Path(name) / "bases")
        for seed in range(seeds.start, seeds.start + READ * len(seeds)):
            done, problem = misread(seed, bases)
            counts["misread" if problem else "good"] += 1
            if problem:
                show(f"== seed {seed} (read): {done}: {problem}")
        for seed, (done, outcome) in zip(
            seeds, pool.map(lambda seed: checked(seed, bases), seeds), strict=True
        ):
            counts[outcome.kind] += 1
            if outcome.kind not in GOOD:
                show(f"== seed {seed}: {done}: {outcome.kind}: {outcome.words}")
            elif os.environ.get("SHOW"):
                show(f"{seed}: {done}: {outcome.words}")
    return counts


if __name__ == "__main__":
    first, _, last = (sys.argv[1] if len(sys.argv) > 1 else str(COUNT)).rpartition(":")
    result = fuzz(range(int(first or 0), int(last)), jobs=int(os.environ.get("JOBS", "2")))
    finish(result, GOOD)
