"""A page on the effects that there are, from what their files say."""

from __future__ import annotations

from forms import catalogue
from forms.effect import Effect, Parameter

_HEAD = """\
# The effects and their parameters

Written by `make docs` from the files in [forms/](../forms). Energies and potentials are in
[the model](model.md); units are those in which results are given, a case may use any other.

| effect | what it is | parameters | what it needs |
|---|---|---|---|
"""


def effects_page() -> str:
    """Return the page in Markdown."""
    known = catalogue.effects().values()
    return _HEAD + "".join(_row(law, law is effect) for effect in known for law in effect.all_laws)


def _row(effect: Effect, default: bool) -> str:
    name = f"`{effect.name}`" if default else f"`{effect.name}` with `law: {effect.law}`"
    parameters = "; ".join(map(_parameter, effect.parameters))
    needs = (
        (effect.needs.placements == 2, "two placements"),
        (effect.needs.second_gradient, "second gradients"),
        (effect.needs.rate, "rates"),
        (effect.needs.increment, "history"),
    )
    needed = ", ".join(what for is_needed, what in needs if is_needed)
    cells = (name, effect.summary, parameters, needed)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |\n"


def _parameter(p: Parameter) -> str:
    unit = "a number" if p.unit == "1" else p.unit
    bound = "" if p.zero_allowed else ", above 0"
    bound = bound if p.above is None else f", above {p.above:g}"
    default = "" if p.default is None else f", {p.default:g} unless given"
    family = ", may differ between the families" if p.per_family else ""
    return f"`{p.name}` ({unit}{bound}{default}{family}): {p.meaning}"
