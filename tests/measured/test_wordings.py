"""The same numbers, worded otherwise, are the same curve or are refused, never other numbers."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import CaseError
from wovenfab.measured.curve import read_measured

Array = NDArray[np.float64]
SEEDS = 240
#: Names of displacement, force and time, by language and machine.
NAMES = (
    ("Extension", "Load", "Time"),
    ("Stroke", "Force", "Time"),
    ("Grip separation", "F", "t"),
    ("Traversenweg", "Standardkraft", "Prüfzeit"),
    ("Verlaengerung", "Last", "Zeit"),
    ("Längenänderung", "Kraft", "Zeit"),
    ("Déplacement", "Charge", "Temps"),
    ("Course", "Effort", "temps"),
    ("Spostamento", "Forza", "Tempo"),
    ("Desplazamiento", "Carga", "Tiempo"),
    ("u", "F", "t"),
)
LENGTHS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "µm": 1e-6, "um": 1e-6, "MM": 1e-3, "in": 0.0254}
FORCES = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "cN": 1e-2, "gf": 9.80665e-3, "daN": 10.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "min": 60.0, "sec": 1.0}
HEADS = (
    (),
    ("Prüfnorm{s}DIN EN ISO 13934-1", "Vorkraft{s}0,5{s}N", "Datum/Uhrzeit{s}14.03.2024 10:33:21"),
    ("Results Table 1", "{s}Maximum Load (N){s}Extension (mm)", "1{s}17.85{s}47.42", "2{s}1.5{s}4"),
    ("sep={s}", "Specimen{s}3", ""),
)


@dataclass
class Wording:
    """A file, with the curve that is in it to the last digit."""

    text: str
    encoding: str
    displacement: Array
    force: Array


def written(value: float, digits: int, decimal: str, group: str) -> str:
    whole, _, rest = f"{abs(value):.{digits}f}".partition(".")
    if group:
        whole = f"{int(whole):,}".replace(",", group)
    sign = "-" if value < 0 and float(f"{value:.{digits}f}") else ""
    return sign + whole + (decimal + rest if rest else "")


def worded(seed: int) -> Wording:
    """Return a random loop in a random wording."""
    rng, choose = np.random.default_rng(seed), random.Random(seed)
    n = int(rng.integers(30, 70))
    way = np.concatenate([np.linspace(0, 1, n), np.linspace(1, 0.1, n)[1:]])
    u = 10 ** rng.uniform(-3, -1) * way
    force = 10 ** rng.uniform(0, 4) * (way**2 + 0.1 * rng.uniform(-1, 1, way.size))
    decimal = choose.choice(".,")
    separator = choose.choice(("\t", ";", ";", ",", "|", " "))
    groups = ["", "", "'", " ", "\u00a0", "\u202f", "," if decimal == "." else "."]
    group = choose.choice(groups)
    if separator == " " and group == " ":
        group = ""
    names = choose.choice(NAMES)
    units = [choose.choice(tuple(kinds)) for kinds in (LENGTHS, FORCES, SECONDS)]
    factors = [LENGTHS[units[0]], FORCES[units[1]], SECONDS[units[2]]]
    columns, si = [], []
    for values, factor in zip((u, force, np.arange(u.size) * 0.5), factors, strict=True):
        largest = float(np.abs(values).max()) / factor
        digits = max(0, int(choose.choice((3, 4, 5)) - np.floor(np.log10(largest))))
        digits = choose.choice((digits, max(digits, 3)))
        columns.append([written(float(v) / factor, digits, decimal, group) for v in values])
        si.append(factor * np.array([float(f"{float(v) / factor:.{digits}f}") for v in values]))
    style = choose.choice(("brackets", "parentheses", "slash", "below", "underscore", "in"))
    forms = {
        "brackets": "{} [{}]", "parentheses": "{} ({})", "slash": "{} / {}", "below": "{}",
        "underscore": "{}_{}", "in": "{} in {}",
    }  # fmt: skip
    if separator == " ":
        style = choose.choice(("underscore", "below"))
        names = ("Extension", "Load", "Time")
    titles = [forms[style].format(*pair) for pair in zip(names, units, strict=True)]
    if choose.random() < 0.5:  # another column, which is none of them
        columns.append([written(i / 7, 4, decimal, "") for i in range(u.size)])
        titles.append("Strain" if separator == " " else "Strain [%]")
        units.append("%")
    if choose.random() < 0.3:
        columns.append([f"10:{i // 60:02d}:{i % 60:02d}" for i in range(u.size)])
        titles.append("Clock")
        units.append("hh:mm:ss")
    order = list(range(len(columns)))
    choose.shuffle(order)
    quoted = choose.random() < 0.3 or separator in (decimal, group)

    def line(cells: list[str]) -> str:
        cells = [f'"{c}"' if quoted and separator != " " else c for c in cells]
        return separator.join(cells)

    head = [h.format(s=separator) for h in choose.choice(HEADS)]
    lines = [*head, line([titles[i] for i in order])]
    if style == "below":
        lines.append(line([units[i] if separator == " " else f"[{units[i]}]" for i in order]))
    rows = [line([columns[i][k] for i in order]) for k in range(u.size)]
    lost = [line(["#WERT!" if i < 2 else columns[i][0] for i in order])]
    if separator != " " and choose.random() < 0.3:
        rows[20:20] = choose.choice((lost, [""], [lines[len(head)]], [line(["NaN"] * len(order))]))
    end = choose.choice(("\n", "\r\n", "\r"))
    text = end.join([*lines, *rows]) + end
    encoding = choose.choice(("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"))
    if encoding == "cp1252" and "\u202f" in text:
        encoding = "utf-8"
    return Wording(text, encoding, si[0], si[1])


@pytest.mark.parametrize("part", range(4))
def test_the_same_numbers_in_other_words_are_the_same_curve(part: int, tmp_path: Path) -> None:
    refused = []
    for seed in range(part, SEEDS, 4):
        wording = worded(seed)
        path = tmp_path / f"{seed}.csv"
        path.write_bytes(wording.text.encode(wording.encoding))
        try:
            curve = read_measured(path)
        except CaseError as error:
            refused.append(f"{seed}: {error}")
            continue
        assert curve.displacement.size == wording.displacement.size, seed
        scale = 1e-12 * np.abs(wording.displacement).max()
        np.testing.assert_allclose(
            curve.displacement, wording.displacement, rtol=1e-12, atol=scale, err_msg=f"{seed}"
        )
        np.testing.assert_allclose(curve.force, wording.force, rtol=1e-12, err_msg=f"{seed}")
    assert len(refused) <= 0.02 * SEEDS / 4, "\n".join(refused)
