"""From a case file, or from Python, to a frozen, validated case in SI units."""

from wovenfab.case.boundary import Component, EdgeCondition, conditions_of
from wovenfab.case.case import Case, json_schema, read_case
from wovenfab.case.errors import CaseError, case_error
from wovenfab.case.formula import Expression
from wovenfab.case.program import (
    CyclesSection,
    HoldSection,
    RampSection,
    SegmentSection,
    TableSection,
    TrapezoidSection,
)
from wovenfab.case.samples import Samples
from wovenfab.case.schema import Discretisation, OutputSection, Rectangle, SheetFile, Solver, Time

__all__ = [
    "Case",
    "CaseError",
    "Component",
    "CyclesSection",
    "Discretisation",
    "EdgeCondition",
    "Expression",
    "HoldSection",
    "OutputSection",
    "RampSection",
    "Rectangle",
    "Samples",
    "SegmentSection",
    "SheetFile",
    "Solver",
    "TableSection",
    "Time",
    "TrapezoidSection",
    "case_error",
    "conditions_of",
    "json_schema",
    "read_case",
]
