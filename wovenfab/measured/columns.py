"""Which column of a measured table is which quantity, and in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from wovenfab.case import units
from wovenfab.case.errors import case_error
from wovenfab.measured.layout import Layout
from wovenfab.measured.names import SI, MeasuredUnit, means, means_strain, name_of, units_in
from wovenfab.measured.table import MeasuredTable, short

#: What a curve is of: each is one of two quantities. The second one of a pair is that of a
#: laboratory which evaluates a shear test.
OVER, OF = ("displacement", "angle"), ("force", "shear_force")
#: Units that a remedy shows.
EXAMPLES = {"displacement": "mm", "angle": "deg", "force": "N", "shear_force": "N/mm", "time": "s"}
#: What an SI unit measures.
KINDS = {
    "m": "a length",
    "rad": "an angle",
    "N": "a force",
    "N/m": "a force per length",
    "s": "a time",
}


@dataclass(frozen=True)
class MeasuredColumn:
    """A column as it was understood.

    Attributes:
        number: From 1.
        title: As written, perhaps empty.
        unit: As written in the header or said by the user.
        factor: SI units of a number in it.
    """

    number: int
    title: str
    unit: str
    factor: float

    def __str__(self) -> str:
        """Return number, title and unit."""
        title = f" {short(self.title)!r}" if self.title else ""
        return f"column {self.number}{title} in {self.unit}"


def columns_of(table: MeasuredTable, layout: Layout) -> dict[str, MeasuredColumn]:
    """Return the columns of a curve by quantity: two, and the time if there is one.

    Args:
        table: The table.
        layout: What the user says of it.

    Raises:
        CaseError: A column is not known, or known by several titles, or has no unit.
    """
    columns: dict[str, MeasuredColumn] = {}
    for quantity in (_one_of(OVER, table, layout), _one_of(OF, table, layout), "time"):
        found = _column(quantity, table, layout, columns)
        if found is not None:
            columns[quantity] = found
    return columns


def _one_of(pair: tuple[str, str], table: MeasuredTable, layout: Layout) -> str:
    """Return which quantity of a pair is in a table: the first one, if both are."""
    for quantity in pair:
        if quantity in layout.columns:
            return quantity
    return next((q for q in pair if _candidates(q, table, layout, {})[1]), pair[0])


def _candidates(
    quantity: str, table: MeasuredTable, layout: Layout, others: Mapping[str, MeasuredColumn]
) -> tuple[list[int], list[int]]:
    """Return the columns, from 0, whose titles name a quantity, and those whose units fit."""
    taken = {c.number - 1 for c in others.values()}
    found = [i for i, t in enumerate(table.titles) if i not in taken and means(t, quantity)]
    kinds = {i: _unit(table, i, quantity) for i in found}
    said = layout.units.get(quantity)
    fitting = [i for i in found if said or _fits(kinds[i], quantity)]
    if len(fitting) > 1 and not said:  # one with a unit, if there is just one
        fitting = [i for i in fitting if kinds[i] is not None] or fitting
    return found, fitting


def _column(
    quantity: str, table: MeasuredTable, layout: Layout, others: dict[str, MeasuredColumn]
) -> MeasuredColumn | None:
    """Return the column of a quantity; None for a time that is not there."""
    given, unit = layout.columns.get(quantity), layout.units.get(quantity)
    path, titles = str(table.file), table.titles
    if given is not None:
        at = _given(quantity, given, table)
    else:
        found, fitting = _candidates(quantity, table, layout, others)
        if quantity == "time" and len(fitting) != 1:
            return None
        if not fitting and not any(titles) and table.width == 2:
            fitting = [_in_order(quantity, table)]
        if len(fitting) != 1:
            raise _unknown(quantity, table, found, fitting)
        at = fitting[0]
    if unit is not None:
        return MeasuredColumn(at + 1, titles[at], unit, _factor(quantity, unit, path))
    written = _unit(table, at, quantity)
    same = [u for u in units_in(titles[at], table.units[at]) if u.si == SI[quantity]]
    if len({u.factor for u in same}) > 1:
        texts = " and ".join(dict.fromkeys(repr(u.text) for u in same))
        remedy = f"Say which: {setting_text('units', quantity, same[0].text)}."
        raise case_error(path, f"the header has several units of the {quantity}, {texts}", remedy)
    if written is not None and written.si == SI[quantity]:
        return MeasuredColumn(at + 1, titles[at], written.text, written.factor)
    if quantity == "time":
        return None
    if written is not None:
        raise case_error(path, *_other_kind(quantity, titles[at], written), table.header)
    title = f"'{quantity}_{EXAMPLES[quantity]}'"
    raise case_error(
        path,
        f"the header has no unit of the {quantity}",
        f"Say it: {setting_text('units', quantity, EXAMPLES[quantity])}, or {title} in the header.",
        table.header,
    )


def _in_order(quantity: str, table: MeasuredTable) -> int:
    """Return which of two columns without names a quantity is: by units, or in their order."""
    for at in (0, 1):
        unit = _unit(table, at, quantity)
        if unit is not None and unit.si == SI[quantity]:
            return at
    return 0 if quantity == "displacement" else 1


def _given(quantity: str, given: str | int, table: MeasuredTable) -> int:
    """Return the number, from 0, of a column that the user names."""
    path = str(table.file)
    if isinstance(given, int):
        if not 1 <= given <= table.width:
            message = f"there is no column {given} for the {quantity}"
            raise case_error(path, message, table.names, table.header)
        return given - 1
    word = given.strip().casefold()
    for name in (str.casefold, lambda title: name_of(title).casefold()):
        found = [i for i, title in enumerate(table.titles) if name(title).strip() == word]
        if len(found) > 1:
            numbers = ", ".join(str(i + 1) for i in found)
            message = f"the columns {numbers} have the name {given!r}"
            remedy = f"Give a number: {setting_text('columns', quantity, str(found[0] + 1))}."
            raise case_error(path, message, remedy, table.header)
        if found:
            return found[0]
    message = f"there is no column {given!r} for the {quantity}"
    raise case_error(path, message, table.names, table.header)


def _unit(table: MeasuredTable, at: int, quantity: str) -> MeasuredUnit | None:
    """Return the unit of a column: of the kind of a quantity if there is one, else another."""
    found = list(units_in(table.titles[at], table.units[at]))
    return next((u for u in found if u.si == SI[quantity]), next(iter(found), None))


def _fits(unit: MeasuredUnit | None, quantity: str) -> bool:
    return unit is None or unit.si == SI[quantity]


def _factor(quantity: str, unit: str, path: str) -> float:
    """Return how many SI units a unit is that the user gives, perhaps with a number."""
    text = unit if unit.strip()[:1] in tuple("+-.0123456789") else f"1 {unit}"
    known = {"kp": "kgf"}
    text = " ".join(known.get(word, word) for word in text.split(" "))
    try:
        factor = units.parse(text, SI[quantity])
        if not text.strip(" +-.0123456789eE"):
            raise ValueError(f"{unit!r} without a unit")
    except ValueError as error:
        kind = units.kind(SI[quantity])
        raise case_error(path, f"the unit of the {quantity} must be {kind}, got {error}") from error
    if not factor:
        raise case_error(path, f"the unit of the {quantity} must not be zero, got {unit!r}")
    return factor


def _unknown(
    quantity: str, table: MeasuredTable, found: Sequence[int], fitting: Sequence[int]
) -> Exception:
    """Return the error of a quantity without a column, or with several."""
    path, titles = str(table.file), table.titles
    if not fitting and found:
        unit = _unit(table, found[0], quantity)
        assert unit is not None
        return case_error(path, *_other_kind(quantity, titles[found[0]], unit), table.header)
    if not fitting and quantity == "displacement":
        for at, title in enumerate(titles):
            unit = _unit(table, at, quantity)
            if means_strain(title) or (unit is not None and unit.si == "rad"):
                kind = unit or MeasuredUnit("", "a ratio", 0.0)
                return case_error(path, *_other_kind(quantity, title, kind), table.header)
    which = "more than one column may be" if fitting else "no column is known as"
    example = fitting[0] + 1 if fitting else min(table.width, 2)
    named = (
        f"{setting_text('columns', quantity, str(example))}, or '{quantity}_{EXAMPLES[quantity]}'"
    )
    remedy = f"Name it: {named} in the header. {table.names}"
    return case_error(path, f"{which} the {quantity}", remedy, table.header)


def _other_kind(quantity: str, title: str, unit: MeasuredUnit) -> tuple[str, str]:
    """Return message and remedy for a column whose unit does not measure its quantity."""
    kind = KINDS.get(unit.si, unit.si)
    wanted = KINDS[SI[quantity]].partition(" ")[2]
    message = f"{short(title)!r} is {kind}, and no {wanted}"
    match quantity, kind:
        case "displacement", "a ratio":
            remedy = (
                "A strain times the length of the sample is a displacement: for per cent of 230 mm "
                f"say {setting_text('units', quantity, '2.3 mm')}, and name the column."
            )
        case "displacement", "an angle":
            remedy = (
                "An angle is no displacement of the machine: give the travel of the grips, of a "
                "picture frame that of the crosshead, and its force."
            )
        case "force", "a force per length":
            factor = unit.factor
            if not factor:
                plain = unit.text.replace("gf", "force_gram").replace("kp", "kgf")
                factor = units.in_si(plain)[0]
            remedy = (
                f"Times the width of the sample it is a force: for 100 mm say "
                f"{setting_text('units', quantity, f'{0.1 * factor:.6g} N')}."
            )
        case "force", "a force per area":
            factor = units.in_si(unit.text)[0]
            remedy = (
                "Times the cross-section of the sample it is a force: for 100 mm by 0.5 mm say "
                f"{setting_text('units', quantity, f'{5e-5 * factor:.6g} N')}."
            )
        case "force", "a mass":
            weight = {"g": "gf", "gr": "gf", "kg": "kgf", "oz": "ozf"}.get(unit.text.casefold())
            weight = weight or "lbf"
            remedy = f"If its weight is meant, say {setting_text('units', quantity, weight)}."
        case _:
            say = setting_text("units", quantity, EXAMPLES[quantity])
            remedy = f"Name another column, or say the unit: {say}."
    return message, remedy


def setting_text(what: str, quantity: str, value: str) -> str:
    """Return how something is said of a file, in a fit file and on the command line."""
    option = f"--{what} {quantity}={value}"
    quoted = f"'{option}'" if " " in value else option
    return f"'{what}: {{{quantity}: {value}}}' in a fit file, {quoted}"
