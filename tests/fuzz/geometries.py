"""``python3 -m tests.fuzz.geometries [COUNT]``: mutated geometry files, checked by the command.

Geometries (.geo), meshes in all forms (.msh) and .step files get one to four mutations. Each must
be accepted or refused with a message, as in :mod:`tests.fuzz.__main__`. A geometry is a program
that may write what it likes: those here have no statements that do.
"""

from __future__ import annotations

import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path

from tests.fuzz import __main__ as cases
from tests.fuzz.__main__ import GOOD, SECONDS, Outcome, check

ROOT = Path(__file__).parents[2]
GEOMETRIES = sorted((ROOT / "meshes").glob("*.geo"))
STEP = ROOT / "tests" / "sheet" / "square.step"
COUNT = 1000
CASE = """\
sheet: {{file: sheet{suffix}, fibres: [45 deg, -45 deg]{edges}}}
effects: {{stretch: {{stiffness: 1e5 N/m}}, shear: {{stiffness: 1e3 N/m}}}}
boundary: {{left: clamp, right: {{displacement: [program, 0]}}}}
program: {{type: ramp, to: 1 mm, velocity: 1 mm/s}}
discretisation: {{degree: 2{size}}}
"""
#: What takes the place of a number in a text.
NUMBERS = (
    *("0", "-1", "1e9", "1e-9", "1e308", "nan", "inf", "99999999999", "0.3", "1e-300", "2.5", "x"),
    *("", "{", "}", ";", "1/0", "Sqrt(-1)", '"', "'", "//", "/*", "é", "\0"),
)


@cache
def mesh(version: float, binary: bool) -> bytes:
    """Return a mesh as gmsh writes it."""
    import gmsh

    with tempfile.TemporaryDirectory() as folder:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.open(str(ROOT / "meshes" / "rectangle.geo"))
        gmsh.model.mesh.generate(2)
        gmsh.write(f"{folder}/sheet.msh")
        gmsh.finalize()
        return Path(folder, "sheet.msh").read_bytes()


def numbers(data: bytes, generator: random.Random) -> bytes:
    """Put something else in the place of a number."""
    places = [m.span() for m in re.finditer(rb"\d+(\.\d+)?", data)]
    if not places:
        return data
    start, end = generator.choice(places)
    return data[:start] + generator.choice(NUMBERS).encode() + data[end:]


def lines(data: bytes, generator: random.Random) -> bytes:
    """Leave a line out, repeat it, or put it elsewhere."""
    parts = data.split(b"\n")
    line = parts.pop(generator.randrange(len(parts)))
    for _ in range(generator.randint(0, 2)):
        parts.insert(generator.randrange(len(parts) + 1), line)
    return b"\n".join(parts)


def octets(data: bytes, generator: random.Random) -> bytes:
    """Change some bytes."""
    changed = bytearray(data)
    for _ in range(generator.randint(1, 8)):
        if changed:
            changed[generator.randrange(len(changed))] = generator.randrange(256)
    return bytes(changed)


def cut(data: bytes, generator: random.Random) -> bytes:
    """Leave out the end, or a part."""
    start = generator.randrange(len(data) + 1)
    end = len(data) if generator.random() < 0.5 else start + generator.randint(1, 200)
    return data[:start] + data[end:]


MUTATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    *(numbers, numbers, numbers, lines, octets, cut),
)


def mutated(generator: random.Random) -> tuple[str, bytes]:
    """Return the ending of a file's name and its mutated content."""
    suffix = generator.choice((".geo", ".geo", ".msh", ".msh", ".step"))
    if suffix == ".geo":
        data = generator.choice(GEOMETRIES).read_bytes()
    elif suffix == ".msh":
        data = mesh(*generator.choice(list(product((2.2, 4.1), (False, True)))))
    else:
        data = STEP.read_bytes()
    for _ in range(generator.randint(1, 4)):
        data = generator.choice(MUTATIONS)(data, generator)
    return suffix, data


def checked(seed: int, seconds: float = SECONDS) -> tuple[str, Outcome]:
    """Return a mutated file and how ``wovenfab check`` of a case with it ends."""
    generator = random.Random(seed)
    suffix, data = mutated(generator)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / f"sheet{suffix}").write_bytes(data)
        size = "" if suffix == ".msh" else f", mesh_size: {generator.choice((20, 100))} mm"
        edges = ", edges: {left: 4, right: 2}" if suffix == ".step" else ""
        path = folder / "case.yaml"
        path.write_text(CASE.format(suffix=suffix, size=size, edges=edges))
        before = sorted(folder.iterdir())
        outcome = check(path, seconds)
        if sorted(folder.iterdir()) != before:
            outcome = Outcome("file written", outcome.words)
    return f"{suffix}\n{data.decode('latin-1')[:3000]}", outcome


def fuzz(seeds: range, seconds: float = SECONDS, jobs: int = 2) -> Counter[str]:
    """Check one mutated file a seed, print what went wrong, and return counts by outcome."""
    for version, binary in product((2.2, 4.1), (False, True)):
        mesh(version, binary)  # gmsh is for one thread
    return cases.fuzz(seeds, seconds, jobs, checked)


if __name__ == "__main__":
    result = fuzz(range(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT))
    cases.finish(result, GOOD)
