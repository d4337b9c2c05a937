"""From a case file to a frozen, validated case in SI units."""

from .boundary import Boundary, EdgeCondition, conditions_of
from .component import Component
from .expression import NUMPY_FUNCTIONS, REQUIRED_FUNCTIONS, Expression
from .files import Samples
from .own_trial import blame_own
from .problems import CaseError, Problem
from .program import Cycles, Hold, Ramp, Segment, Table
from .published import published_schema
from .read import case_data, dump_case, json_schema, problem_at, read_case
from .reference import effects_page
from .scene import SceneEffect, Value
from .schema import Case, Discretisation, Output, Solver, Time
from .sheet import Rectangle, SheetFile

__all__ = [
    "NUMPY_FUNCTIONS",
    "REQUIRED_FUNCTIONS",
    "Boundary",
    "Case",
    "CaseError",
    "Component",
    "Cycles",
    "Discretisation",
    "EdgeCondition",
    "Expression",
    "Hold",
    "Output",
    "Problem",
    "Ramp",
    "Rectangle",
    "Samples",
    "SceneEffect",
    "Segment",
    "SheetFile",
    "Solver",
    "Table",
    "Time",
    "Value",
    "blame_own",
    "case_data",
    "conditions_of",
    "dump_case",
    "effects_page",
    "json_schema",
    "problem_at",
    "published_schema",
    "read_case",
]
