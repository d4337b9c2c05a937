"""``python3 -m tests.fuzz [COUNT]``: mutated cases, each checked by the command as a user would.

A file must be accepted (exit code 0) or refused with a message (2), within 10 s of a processor and
500 MB, without a traceback, and nothing may be written. Every fourth that is accepted is run, too,
until it ends or is told to end: with a message, and without a traceback.
"""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parents[2]
CASES = sorted(p for p in (ROOT / "configs").rglob("*.yaml") if not p.stem.endswith("-fit"))
COUNT, SECONDS, BYTES = 2000, 10.0, 500e6
#: Which share of the accepted files is run, for how long (s), and how a run may end: done, refused,
#: a step that cannot be made, told to end (also after its last step).
SHARE, RUN, ENDS = 4, 12.0, (0, 2, 3, 143, -signal.SIGTERM)
#: How many times as long a command may take by the clock as by its processor.
CLOCK = 20
#: Time in which a run that is told to end must have done so (s).
PATIENCE = 20.0
#: What takes the place of a value.
VALUES = (
    *("nan", ".inf", "-.inf", "1e308", "5e-324", "-1", "0", "1e-40", "-0.0", "12 parsec", "40 kg"),
    *("''", "~", "true", "[]", "{}", "[[[]]]", "40mm 3", "1e999 m", "0x1F", "1_000", "1:30", "="),
    *("<<",),
    *("!!bool x", '!!int ""', "!!float z", "!!binary '%'", "!!python/object/apply:os.getcwd []"),
    *('"\\U00110000"', '"\\ud83d\\ude00"', '"\\ud83d"', "µm", "40 µm", "\u202e40 mm", "40 mm"),
    *("'\\0'",),
    *("1/0", "x/0 N/m", "x^x^x^x^x", "((((((((((x))))))))))", "sqrt(-1) m", "__import__('os')"),
    *("y + 1",),
    *("&a [*a]", "*nowhere", "{a: 1, a: 2}", "[" * 400 + "]" * 400, "x" * 3000, "9" * 400),
)
#: Words that take the place of a key.
KEYS = ("", "__class__", "file", "law", "from", "null", "true", "1", "é", "steps", "clamp", "type")
#: Geometries: one each that is open, crossing, empty, without names, or of another unit.
HEAD = "Point(1)={0,0,0}; Point(2)={1,0,0}; Point(3)={1,1,0}; Point(4)={0,1,0};\n"
LINES = "Line(1)={1,2}; Line(2)={2,3}; Line(3)={3,4}; Line(4)={4,1};\n"
LOOP = "Curve Loop(1)={1:4}; Plane Surface(1)={1}; Physical Surface('s')={1};\n".replace("'", '"')
NAMES = 'Physical Curve("left")={4}; Physical Curve("right")={2};\n'
GEOMETRIES = (
    "",
    "noise \x01",
    HEAD + LINES.replace("{4,1}", "{4,3}") + LOOP + NAMES,
    HEAD + LINES.replace("{1,2}", "{1,3}").replace("{3,4}", "{2,4}") + LOOP + NAMES,
    HEAD + LINES + LOOP,
    HEAD.replace("1,", "1000,") + LINES + LOOP + NAMES,
    HEAD + LINES + LOOP + NAMES,
    'SystemCall "touch written";\n',
    "Exit;\n",
    "For i In {1:2} EndFor For\n",
)
GOOD = {"accepted", "refused", "run"}
EFFECT = (ROOT / "docs" / "examples" / "my_effect.py").read_text(encoding="utf-8")
RETURN = 'return values["stiffness"] / 2 * gamma**2'
EFFECTS = (
    *(EFFECT, "", "def (", "raise KeyError", "import sys; sys.exit(0)", "EFFECT = 3"),
    *(
        EFFECT.replace(RETURN, new)
        for new in ("return gamma", "return None", "return point.f", "exit(0)", "return 1 / gamma")
    ),
    EFFECT.replace("N/m", "N*"),
    EFFECT.replace('"my_effect"', "7"),
    EFFECT.replace("parameters=(", "parameters=(1, "),
)


@dataclass(frozen=True)
class Outcome:
    """How the check of a file ended.

    Attributes:
        kind: ``accepted``, ``refused``, or what went wrong.
        words: The last line of what was said.
    """

    kind: str
    words: str = ""


def mutated(text: str, folder: Path, generator: random.Random) -> str:
    """Return a case with one to three mutations; files that it names are written beside it."""
    for _ in range(generator.randint(1, 3)):
        lines = text.split("\n")
        at = generator.randrange(len(lines))
        values = [m.span(1) for m in re.finditer(r"[:\[,] *([^\s,\[\]{}#:][^,\[\]{}#\n]*)", text)]
        keys = [m.span(1) for m in re.finditer(r"([A-Za-z_]+):", text)]
        choice = generator.randrange(8)
        if choice <= 2 and values:
            start, end = generator.choice(values)
            text = text[:start] + generator.choice(VALUES) + text[end:]
        elif choice == 3 and keys:
            start, end = generator.choice(keys)
            text = text[:start] + generator.choice(KEYS) + text[end:]
        elif choice == 4:
            text = "\n".join(
                lines[:at] + lines[at : at + 1] * generator.randint(0, 3) + lines[at + 1 :]
            )
        elif choice == 5:
            place = generator.randrange(len(text) + 1)
            text = (
                text[:place] + generator.choice("{}[]:,&*!|>'\"%@`#\t\x07é\u2028-?") + text[place:]
            )
        elif choice == 6:
            (folder / "sheet.geo").write_text(generator.choice(GEOMETRIES))
            sheet = "sheet: {file: sheet.geo, fibres: [45 deg, -45 deg]}"
            text = re.sub(r"^sheet:.*?(?=^\w)", sheet + "\n", text, count=1, flags=re.M | re.S)
        else:
            (folder / "own.py").write_text(generator.choice(EFFECTS))
            name = generator.choice(("my_effect", "_x", "shear", "a-b"))
            own = f"effects:\n  {name}: {{file: own.py, stiffness: 4 N/m}}\n"
            text = text.replace("effects:\n", own, 1)
    return text


def checked(seed: int, seconds: float = SECONDS) -> tuple[str, Outcome]:
    """Return a mutated case and how ``wovenfab check`` of it ends in so many seconds."""
    generator = random.Random(seed)
    origin = generator.choice(CASES)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = mutated(origin.read_text(encoding="utf-8"), folder, generator)
        for key in ("from", "file"):  # others in configs/ and meshes/ are still found
            text = text.replace(f"{key}: ../", f"{key}: {ROOT}/")
        text = re.sub(r"^from: (\w)", rf"from: {origin.parent}/\1", text, flags=re.M)
        path = folder / "case.yaml"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        before = sorted(folder.iterdir())
        outcome = check(path, seconds)
        if sorted(folder.iterdir()) != before:
            outcome = Outcome("file written", outcome.words)
        if outcome.kind == "accepted" and seed % SHARE == 0:
            outcome = _run(path, seconds)
    return text, outcome


def check(path: Path, seconds: float) -> Outcome:
    """Return how ``wovenfab check`` of a case ends in so many seconds."""
    code, text, memory = _ended(("check", str(path)), path.parent, seconds)
    words = (text.strip().splitlines() or [""])[-1]
    if code == -signal.SIGKILL:
        return Outcome("hang", words)
    if "Traceback" in text:
        return Outcome("traceback", words)
    if memory > BYTES:
        return Outcome("memory", f"{memory / 1e6:.0f} MB")
    if code not in (0, 2) or not words:
        return Outcome(f"exit code {code}", words)
    return Outcome("refused" if code else "accepted", words)


def _run(path: Path, seconds: float) -> Outcome:
    arguments = ("run", str(path), "-o", "results", "--set", "output.pictures=false")
    time_of_run = RUN * seconds / SECONDS
    code, text, _ = _ended(arguments, path.parent, time_of_run, asked=True)
    words = (text.strip().splitlines() or [""])[-1]
    if "Traceback" in text:
        return Outcome("traceback in a run", words)
    history = path.parent / "results" / "history.csv"
    if history.exists() and re.search(r"\b(nan|inf)\b", history.read_text(encoding="utf-8")):
        return Outcome("no number in the history of a run", words)
    return Outcome("run" if code in ENDS and words else f"exit code {code} of a run", words)


def _ended(
    arguments: tuple[str, ...], folder: Path, seconds: float, asked: bool = False
) -> tuple[int, str, int]:
    """Return exit code, output and largest memory (bytes) of a command that has so many seconds.

    They are those of a processor, for others may use it, too: by the clock it has more. At their
    end it is killed, or asked to end.
    """
    command = [sys.executable, "-P", "-m", "wovenfab", *arguments]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, cwd=folder, stdout=said, stderr=said)
        until, most = time.monotonic() + CLOCK * seconds, 0
        while process.poll() is None and time.monotonic() <= until:
            if processor_time(process.pid) > seconds:
                break
            most = max(most, _memory(process.pid))
            time.sleep(0.02)
        if process.poll() is None:
            process.send_signal(signal.SIGTERM if asked else signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE)
            process.kill()
            process.wait()
        said.seek(0)
        return process.returncode, said.read().decode(errors="replace"), most


def processor_time(process: int) -> float:
    """Return the processor time of a process and of those of its children that ended (s)."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _memory(process: int) -> int:
    """Return the largest memory of a process so far (bytes); what it got at its end may lack."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)


def fuzz(
    seeds: range,
    seconds: float = SECONDS,
    jobs: int = 2,
    checked: Callable[[int, float], tuple[str, Outcome]] = checked,
) -> Counter[str]:
    """Check one mutated case a seed, print what went wrong, and return counts by outcome."""
    counts: Counter[str] = Counter()
    with ThreadPoolExecutor(jobs) as pool:
        for seed, (text, outcome) in zip(
            seeds, pool.map(checked, seeds, repeat(seconds)), strict=True
        ):
            counts[outcome.kind] += 1
            if outcome.kind not in GOOD:
                print(f"== seed {seed}: {outcome.kind}: {outcome.words}\n{text}", flush=True)
    return counts


def finish(result: Counter[str], good: Collection[str]) -> NoReturn:
    """Print counts by outcome and end, with an error if one is not good."""
    print(", ".join(f"{kind}: {count}" for kind, count in sorted(result.items())))
    sys.exit(0 if result.keys() <= set(good) else 1)


if __name__ == "__main__":
    result = fuzz(range(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT))
    finish(result, GOOD)
