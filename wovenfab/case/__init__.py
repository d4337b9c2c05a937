"""From a case file, or from Python, to a frozen, validated case in SI units."""

from wovenfab.case.boundary import Component, EdgeCondition, conditions_of
from wovenfab.case.case import Case, json_schema, read_case
from wovenfab.case.errors import CaseError, refusal
from wovenfab.case.formula import Expression
from wovenfab.case.program import Cycles, Hold, Ramp, Segment, Table, Trapezoid
from wovenfab.case.samples import Samples
from wovenfab.case.schema import Discretisation, Output, Rectangle, SheetFile, Solver, Time

__all__ = [
    "Case",
    "CaseError",
    "Component",
    "Cycles",
    "Discretisation",
    "EdgeCondition",
    "Expression",
    "Hold",
    "Output",
    "Ramp",
    "Rectangle",
    "Samples",
    "Segment",
    "SheetFile",
    "Solver",
    "Table",
    "Time",
    "Trapezoid",
    "conditions_of",
    "json_schema",
    "read_case",
    "refusal",
]
