"""``python -m benchmarks.layer_scenes [COUNT] [SEED]``: stated errors where layers are thin.

Sheets whose yarns bend sharply beside their grips: wide and short ones that are sheared, ones whose
grips approach, and bias extension of families of which one hardly resists bending. Coarse cells are
many times as long as these layers, and low degrees then agree by chance. Each scene is run for
1 % and compared as those of ``benchmarks.random_scenes``; the command fails where a true error is
above the stated one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.random_scenes import ACCURACY, compare, rows_for, table
from wovenfab.study.runner import Store

RESULTS = Path("results") / "layers"
COUNT, SEED = 20, 1
#: Kinds of scenes, one after another.
KINDS = ("sheared", "compressed", "unbalanced", "sheared with friction")


def scene(number: int, seed: int, folder: Path, accuracy: float = ACCURACY) -> Path:
    """Write the case of a scene into a folder; return the file.

    Args:
        number: Of the scene; it and the seed decide on everything.
        seed: Of all scenes.
        folder: An existing folder.
        accuracy: That is wanted.
    """
    draw = np.random.default_rng([seed, number])

    def value(low: float, high: float) -> float:
        return float(f"{np.exp(draw.uniform(np.log(low), np.log(high))):.4g}")

    kind = KINDS[number % len(KINDS)]
    length, wider = value(0.02, 0.08), value(2, 5)
    tilt = draw.uniform(-8, 8)
    first = tilt if kind.startswith("sheared") else 45.0
    effects: dict[str, Any] = {
        "stretch": {"stiffness": value(1e4, 2e5)},
        "shear": {"stiffness": value(5, 50)},
        "bending": {"stiffness": value(1e-4, 1e-2)},
    }
    clamp: Any = {"clamp": "rotation"}
    right: dict[str, Any] = {"displacement": [0, "program"], "rotation": "held"}
    travel = value(0.05, 0.15) * length
    if kind == "compressed":
        right["displacement"], travel = ["-program", 0], 0.3 * travel
    elif kind == "unbalanced":
        length, wider = length * wider, value(0.3, 0.6)
        effects["bending"]["stiffness"] = [1e-2, 1e-5]
        clamp, right, travel = "clamp", {"displacement": ["program", 0]}, 0.1 * length
    elif kind == "sheared with friction":
        effects["spin_friction"] = {"law": "coulomb", "strength": value(0.5, 3)}
    case = {
        "title": kind,
        "sheet": {
            "length": float(f"{length:.4g}"),
            "width": float(f"{length * wider:.4g}"),
            "fibres": [f"{first:.1f} deg", f"{first - 90:.1f} deg"],
        },
        "effects": effects,
        "boundary": {"left": clamp, "right": right},
        "program": {"type": "ramp", "to": float(f"{travel:.4g}"), "duration": "1 s", "steps": 20},
        "accuracy": f"{100 * accuracy:g} %",
        "output": {"pictures": False, "fields": []},
    }
    path = folder / f"layers-{seed}-{number}.yaml"
    path.write_text(json.dumps(case, indent=1), encoding="utf-8")
    return path


def main(count: int, seed: int) -> None:
    """Run the scenes, then their references; fail where an error is understated."""
    store = Store(RESULTS.resolve())
    rows = rows_for(store, count, seed, ACCURACY, scene)
    compare(store, rows, seed, ACCURACY, scene)
    made = list(rows.values())
    print("\n" + table(made))
    known = [r for r in made if r.true is not None and r.stated is not None]
    understated = [r.scene for r in known if r.true > r.stated]
    print(f"understated: {understated or 'none'} of {len(known)}")
    sys.exit(1 if understated else 0)


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:3]]
    main(*(given + [COUNT, SEED][len(given) :]))
