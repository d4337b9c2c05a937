"""From a case file, or from Python, to a frozen, validated case in SI units."""

from wovenfab.case.boundary import Boundary, Component, EdgeCondition, conditions_of
from wovenfab.case.case import Case, json_schema, read_case
from wovenfab.case.document import (
    Document,
    Place,
    existing_file,
    folder_of,
    parse_document,
    read_document,
)
from wovenfab.case.effects import SceneEffect, Value, acting
from wovenfab.case.errors import OVERRIDE, CaseError, Problem, problems_in, refusal
from wovenfab.case.formula import NUMPY_FUNCTIONS, REQUIRED_FUNCTIONS, Expression
from wovenfab.case.program import Cycles, Hold, Ramp, Samples, Segment, Table, Trapezoid
from wovenfab.case.quantities import OneOr, Section
from wovenfab.case.schema import Discretisation, Output, Rectangle, SheetFile, Solver, Time

__all__ = [
    "NUMPY_FUNCTIONS",
    "OVERRIDE",
    "REQUIRED_FUNCTIONS",
    "Boundary",
    "Case",
    "CaseError",
    "Component",
    "Cycles",
    "Discretisation",
    "Document",
    "EdgeCondition",
    "Expression",
    "Hold",
    "OneOr",
    "Output",
    "Place",
    "Problem",
    "Ramp",
    "Rectangle",
    "Samples",
    "SceneEffect",
    "Section",
    "Segment",
    "SheetFile",
    "Solver",
    "Table",
    "Time",
    "Trapezoid",
    "Value",
    "acting",
    "conditions_of",
    "existing_file",
    "folder_of",
    "json_schema",
    "parse_document",
    "problems_in",
    "read_case",
    "read_document",
    "refusal",
]
