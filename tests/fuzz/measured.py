"""``python3 -m tests.fuzz.measured [COUNT]``: mutated measured files, clouds and fit files.

Each is read as ``wovenfab measured``, ``report --lab``, ``export --compare`` and ``fit`` do: it
must be accepted or refused with a message, within some seconds, and without a traceback. What is
accepted has finite numbers, a displacement that changes, and branches that hold all rows.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from openpyxl import Workbook

from tests.fuzz.__main__ import VALUES, finish, mutated
from wovenfab.case import CaseError
from wovenfab.measured.cloud import read_cloud
from wovenfab.measured.curve import Measured, describe_reading, read_measured
from wovenfab.measured.layout import Layout
from wovenfab.study.fit.fit_file import read_fit

ROOT = Path(__file__).parents[2]
COUNT, SECONDS = 2000, 20.0
LAB = ROOT / "configs" / "lab"
LOOP = [*range(21), *range(19, 4, -1), *range(6, 31)]
CURVES = (
    (LAB / "glass-plain-115x230.csv").read_text(encoding="utf-8"),
    "Prüfnorm;DIN\n\nWeg [µm];Kraft [mN]\n"
    + "".join(f"{u}.{abs(u * 37) % 1000:03d},50;{u * 3},25\n" for u in LOOP),
    '"Results"\n"1","17.85","47.4"\n\n"Time","Extension","Load"\n"(s)","(mm)","(N)"\n'
    + "".join(f'"{i}","{u}.5","1,{u:03d}.25"\n' for i, u in enumerate(LOOP)),
    "u_mm F_N\n" + "".join(f"{u / 7:.5f} {u**2 / 9:.4e}\n" for u in LOOP),
)
CLOUDS = (
    "# GOM\nid;x [mm];y [mm];displacement x [mm];displacement y [mm]\n"
    + "".join(f"{u};{u},5;{u % 7},25;0,{u:02d};-0,{u:02d}\n" for u in LOOP),
    "x,y,u,v\nmm,mm,mm,mm\n" + "".join(f"{u},{u % 5},.{u},NaN\n{u},1,2,3\n" for u in LOOP),
)
FITS = sorted(LAB.glob("*-fit.yaml"))
#: What takes the place of a cell, or of a line.
CELLS = (
    *("", "NaN", "#WERT!", "---", "inf", "-inf", "1e308", "-1e308", "5e-324", "1e999", "9" * 400),
    *("0", "-0", "1.234", "1,234", "1.234,5", "1,234.5", "1 234", "1'234", "1.2.3", "1,2,3", "1_0"),
    *("10:00:02", "14.03.2024", "x", "é", "\u22125", "٣", "5 mm", "1d5", "0x10", '"', '"1', "'"),
    *("[N]", "[mm]", "(Mm)", "N/mm", "%", "Kraft", "Weg [mm]", "[[[[", "]" * 300, "/" * 300),
    *("[red]", "[/b]", "$\\frac$", "a" * 5000, "\0", "\u2028", "\ufeff", "m" * 40, "N*" * 30),
    *("1/0", "\x1b[31m"),
)  # fmt: skip
#: Keys of a test that are added to fit files, and some of their values.
MORE = ("rows", "decimal", "columns", "units", "sheet", "drift", "zero", "preload", "cycle", "thin")
GIVEN = ("1-9", "{force: 2}", "{force: -1 N}", "','", "1", "5", "1 N")
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-be", "utf-32", "cp1252", "latin-1")
LAYOUTS = (
    *(Layout(),) * 8,
    Layout({"displacement": 2, "force": 1}),
    Layout({"force": "Kraft", "time": 9}, {"force": "-1 kN"}, None, ","),
    Layout({"displacement": 1}, {"displacement": "2.3 mm", "force": "9^9^9 N"}, (3, 30), "."),
    Layout({}, {"x": "mm", "y": "mm", "ux": "1e999 m", "force": "degC"}, (30, 10**9)),
)


def worded(text: str, generator: random.Random) -> bytes:
    """Return a measured file with one to four mutations, in an encoding."""
    for _ in range(generator.randint(1, 4)):
        lines = text.split("\n")
        at = generator.randrange(len(lines))
        separator = next((s for s in ";,\t" if s in lines[at]), " ")
        cells = lines[at].split(separator)
        match generator.randrange(10):
            case 0 | 1 | 2:
                cells[generator.randrange(len(cells))] = generator.choice(CELLS)
                lines[at] = separator.join(cells)
            case 3:
                lines[at : at + 1] = [lines[at]] * generator.choice((0, 2, 3, 40))
            case 4:
                lines.insert(at, generator.choice(CELLS))
            case 5:
                generator.shuffle(lines)
            case 6:
                old, new = generator.choice(("..", ",.", ";,", ",;", "; ", ";\t", ",|", " \u00a0"))
                lines = [line.replace(old, new) for line in lines]
            case 7:
                lines = lines[: at + 1]
                lines[-1] = lines[-1][: generator.randint(0, len(lines[-1]))]
            case 8:
                place = generator.randrange(len(lines[at]) + 1)
                lines[at] = lines[at][:place] + generator.choice(CELLS) + lines[at][place:]
            case 9:
                column, cell = generator.randrange(4), generator.choice(CELLS)
                lines = [
                    separator.join(c if i != column else cell for i, c in enumerate(x))
                    for x in (line.split(separator) for line in lines)
                ]
        text = "\n".join(lines)
    raw = text.encode(generator.choice(ENCODINGS), errors="replace")
    if generator.randrange(8) == 0:
        place = generator.randrange(len(raw) + 1)
        raw = raw[:place] + generator.randbytes(generator.randint(1, 9)) + raw[place:]
    return raw


def curve(folder: Path, generator: random.Random) -> None:
    """Read a mutated curve."""
    path = folder / "curve.csv"
    path.write_bytes(worded(generator.choice(CURVES), generator))
    is_sound(read_measured(path, generator.choice(LAYOUTS)))


def is_sound(found: Measured) -> None:
    """Make sure of finite numbers, of branches that hold all rows, and of plain words."""
    assert np.isfinite([found.displacement, found.force]).all() and np.ptp(found.displacement) > 0
    rows = np.concatenate([rows[1:] for rows in found.branches()])
    assert np.array_equal(rows, np.arange(1, found.force.size))
    assert "\x1b" not in "\n".join(describe_reading(found.reading))


def workbook(folder: Path, generator: random.Random) -> None:
    """Read a mutated workbook: cells, parts of the archive, or bytes of it."""
    book, raw = Workbook(), BytesIO()
    for u in LOOP:
        cells: list[object] = [u / 7, u**2 / 9, u]
        if generator.randrange(4) == 0:
            cells[generator.randrange(3)] = plain_cell(generator.choice(CELLS))
        book.active.append(cells)
    book.active.insert_rows(1)
    for at, title in enumerate(("Weg [mm]", "Kraft [N]", "t [s]"), start=1):
        book.active.cell(1, at).value = title
    book.save(raw)
    with ZipFile(raw) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    if generator.randrange(2):
        name = generator.choice(sorted(parts))
        place = generator.randrange(len(parts[name]))
        parts[name] = parts[name][:place] + generator.randbytes(3) + parts[name][place + 3 :]
    path = folder / "curve.xlsx"
    with ZipFile(path, "w") as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    if generator.randrange(4) == 0:
        whole = path.read_bytes()
        place = generator.randrange(len(whole))
        path.write_bytes(whole[:place] + generator.randbytes(generator.randrange(9)))
    is_sound(read_measured(path, generator.choice(LAYOUTS)))


def plain_cell(cell: str) -> str:
    """Return a cell without the characters that no workbook can hold."""
    return "".join(c for c in cell if c.isprintable())[:100]


def cloud(folder: Path, generator: random.Random) -> None:
    """Read a mutated cloud."""
    path = folder / "cloud.csv"
    path.write_bytes(worded(generator.choice(CLOUDS), generator))
    found = read_cloud(path, generator.choice(LAYOUTS))
    points, moved = found.points, found.displacements
    assert points.shape == moved.shape and np.isfinite([points, moved]).all()


def fit(folder: Path, generator: random.Random) -> None:
    """Read a mutated fit file with its cases and measured files, one of them mutated, too."""
    origin = generator.choice(FITS)
    for file in LAB.iterdir():
        if file.suffix in (".yaml", ".csv"):
            (folder / file.name).write_bytes(file.read_bytes())
    more = f"    {generator.choice(MORE)}: "
    more += (
        generator.choice((*VALUES, "1-9", "{force: 2}", "{force: -1 N}", "','", "1", "5", "1 N"))
        + "\n"
    )
    text = origin.read_text(encoding="utf-8")
    if generator.randrange(2):
        text = text.replace("    measured:", f"{more}    measured:", 1)
    text = mutated(text, folder, generator) if generator.randrange(4) else text
    path = folder / "a-fit.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    if generator.randrange(2):
        (folder / "glass-plain-115x230.csv").write_bytes(worded(CURVES[0], generator))
    read_fit(path)


KINDS: tuple[Callable[[Path, random.Random], None], ...] = (curve, curve, cloud, fit, workbook)


def outcome(seed: int) -> tuple[str, str]:
    """Return how the reading of one mutated file ends, and what was said."""
    generator, kind = random.Random(seed), KINDS[seed % len(KINDS)]
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            with warnings.catch_warnings(action="error", category=RuntimeWarning):
                kind(Path(folder), generator)
            end = "accepted", ""
        except CaseError as error:
            end = ("refused" if str(error).strip() else "no message"), str(error)
        except Exception:
            end = "traceback", traceback.format_exc()
    if time.process_time() - started > SECONDS:
        return "hang", kind.__name__
    return end


def fuzz(seeds: range) -> Counter[str]:
    """Read one mutated file a seed, print what went wrong, and return counts by outcome."""
    counts: Counter[str] = Counter()
    for seed in seeds:
        kind, words = outcome(seed)
        counts[kind] += 1
        if kind not in ("accepted", "refused"):
            print(f"== seed {seed}: {kind}: {words}", flush=True)
    return counts


if __name__ == "__main__":
    result = fuzz(range(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT))
    finish(result, {"accepted", "refused"})
