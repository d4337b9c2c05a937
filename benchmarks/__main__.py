"""``python -m benchmarks [SECTION ...]`` prints all figures and fails where one is missed."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

from benchmarks.accuracy_cost import accuracy_cost
from benchmarks.assembly import assembly
from benchmarks.busy import busy
from benchmarks.checkpoints import checkpoints
from benchmarks.cold_start import cold_start
from benchmarks.default import default
from benchmarks.effects import cost_of_effects
from benchmarks.figure import Figure, Section
from benchmarks.gradients import gradients
from benchmarks.growth import growth
from benchmarks.plans import plans
from benchmarks.step_choice import step_choice
from benchmarks.step_cost import step_cost
from benchmarks.textbook import textbook

SECTIONS: Mapping[str, Section] = {
    "cold-start": cold_start,
    "effects": cost_of_effects,
    "default": default,
    "accuracy": accuracy_cost,
    "checkpoints": checkpoints,
    "gradients": gradients,
    "assembly": assembly,
    "step": step_cost,
    "step-choice": step_choice,
    "plans": plans,
    "textbook": textbook,
    "growth": growth,
    "busy": busy,
}


def main(names: Sequence[str], sections: Mapping[str, Section] = SECTIONS) -> int:
    """Measure the named sections, or all, and return the exit code."""
    if unknown := [name for name in names if name not in sections]:
        print(f"there is no section {unknown[0]!r}; there are {', '.join(sections)}")
        return 2
    figures: list[Figure] = []
    for name in names or sections:
        print(f"== {name}", flush=True)
        figures += sections[name]()
    print("== figures", *figures, sep="\n")
    return 0 if all(figure.kept for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
