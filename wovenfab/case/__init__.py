"""From a case file to a frozen, validated case in SI units."""

from .boundary import Component, EdgeCondition
from .files import Samples
from .problems import CaseError, Problem
from .program import Cycles, Hold, Ramp, Segment, Table
from .read import dump_case, json_schema, problem_at, read_case
from .schema import Case, Discretisation, Output, Rectangle, SheetFile, Solver, Time

__all__ = [
    "Case",
    "CaseError",
    "Component",
    "Cycles",
    "Discretisation",
    "EdgeCondition",
    "Hold",
    "Output",
    "Problem",
    "Ramp",
    "Rectangle",
    "Samples",
    "Segment",
    "SheetFile",
    "Solver",
    "Table",
    "Time",
    "dump_case",
    "json_schema",
    "problem_at",
    "read_case",
]
