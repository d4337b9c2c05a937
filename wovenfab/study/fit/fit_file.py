"""Fit files: measured tests, the parameters to find, and how well they are known."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError
from scipy.optimize import brentq

from wovenfab.case import Case, CaseError, read_case, units
from wovenfab.case.document import Document, existing_file, folder_of, read_document
from wovenfab.case.errors import (
    CaseProblem,
    FormulaError,
    describe,
    near_miss,
    problems_in,
    reason,
    value_error,
)
from wovenfab.case.fingerprint import fingerprint
from wovenfab.case.formula import Expression, coefficients, with_change, with_coefficient
from wovenfab.case.program import program_of_case
from wovenfab.case.quantities import Count, Length, Quantity, Section, Several
from wovenfab.case.specimen import shear_test_of, standard_tests_of
from wovenfab.forms.effect import Target
from wovenfab.measured.cloud import read_cloud
from wovenfab.measured.correction import Correction, corrected
from wovenfab.measured.curve import Measured, read_measured
from wovenfab.measured.layout import Layout, rows_of
from wovenfab.measured.replicates import Replicates, replicates_of
from wovenfab.measured.thinning import Thinning, thinned
from wovenfab.measured.workbook import SUFFIXES
from wovenfab.record.figures import PURE, StandardTest, figures_at_rest
from wovenfab.study.response import with_extra_times

Array = NDArray[np.float64]
#: What the names of parameters of the testing machine begin with.
MACHINE_NAME = "machine"
#: These parameters, with their units: a spring in series with the sample, and displacement and
#: force of the machine where the sample has none.
MACHINE = {"compliance": "m/N", "displacement": "m", "force": "N"}
#: Names of measured files.
MEASURED = (".csv", ".tsv", ".txt", ".dat", *SUFFIXES)
#: A parameter, perhaps of one family, or a coefficient of its formula.
_PARAMETER = re.compile(
    r"(?P<parameter>\w+)(?:\[(?P<family>[^]]*)\])?(?:#(?P<coefficient>[1-9]\d?))?"
)


def _text_file(*suffixes: str) -> Any:
    def read(value: Any, info: ValidationInfo) -> Path:
        return existing_file(value, folder_of(info), suffixes)

    return Annotated[Path, BeforeValidator(read, json_schema_input_type=str), PlainSerializer(str)]


def _share_or_force(value: Any) -> tuple[float, bool]:
    """Return an error and whether it is a share of the largest force."""
    if isinstance(value, str):
        for unit, share in (("", True), ("N", False)):
            try:
                number = units.parse(value, unit)
            except ValueError:
                continue
            if number > 0:
                return number, share
    raise value_error(f"expected an error such as 1 % or 0.1 N, got {describe(value)}")


def _lines(value: Any) -> tuple[int, int] | None:
    """Return the first and last line that a text such as 12-340 names."""
    if value is None or isinstance(value, tuple):
        return value
    try:
        return rows_of(str(value))
    except ValueError:
        remedy = "For example 'rows: 12-340', counted from 1 as an editor does."
        raise value_error(
            f"expected the first and last line, got {describe(value)}", remedy
        ) from None


_ShareOrForce = Annotated[
    tuple[float, bool],
    BeforeValidator(_share_or_force, json_schema_input_type=str),
    PlainSerializer(lambda e: f"{100 * e[0]:g} %" if e[1] else f"{e[0]!r} N"),
]
_Number = Annotated[int, Count(least=0, most=1_000_000)]
_Force = Annotated[float, Quantity(unit="N", least=0.0)]
_Rows = Annotated[
    tuple[int, int] | None,
    BeforeValidator(_lines, json_schema_input_type=str),
    PlainSerializer(lambda r: None if r is None else f"{r[0]}-{r[1]}"),
]


def _measured_files(value: Any, info: ValidationInfo) -> tuple[Path, ...]:
    """Return the paths of one measured file or of a list of them."""
    names = value if isinstance(value, list | tuple) else [value]
    return tuple(existing_file(name, folder_of(info), MEASURED) for name in names)


_Files = Annotated[
    tuple[Path, ...],
    BeforeValidator(_measured_files, json_schema_input_type=str | list[str]),
    PlainSerializer(lambda paths: [*map(str, paths)]),
]


class Columns(Section):
    """Columns of a measured file, where its header does not tell."""

    displacement: str | int | None = Field(default=None, examples=["Weg"])
    """Name or number (from 1)."""

    angle: str | int | None = Field(default=None, examples=["Scherwinkel"])
    """Name or number (from 1), in place of the displacement."""

    force: str | int | None = Field(default=None, examples=["Kraft"])
    """Name or number (from 1)."""

    shear_force: str | int | None = Field(default=None, examples=["normierte Scherkraft"])
    """Name or number (from 1), in place of the force."""

    time: str | int | None = Field(default=None, examples=["Zeit"])
    """Name or number (from 1)."""


class Units(Section):
    """Units of the columns, where the header does not tell; ``-1 N`` reverses the sign."""

    displacement: str | None = Field(default=None, examples=["mm"])
    """A length."""

    angle: str | None = Field(default=None, examples=["deg"])
    """An angle."""

    force: str | None = Field(default=None, examples=["N"])
    """A force."""

    shear_force: str | None = Field(default=None, examples=["N/mm"])
    """A force per length."""

    time: str | None = Field(default=None, examples=["s"])
    """A time."""


class FigureSpec(Section):
    """A measured figure of a standard test."""

    value: float | str = Field(examples=["1.5 gf/(cm*deg)"])
    """Its value."""

    error: str | None = Field(default=None, examples=["2 %"])
    """Its standard error, in its unit or as a share of its value; that of the test unless given."""


def _figure_spec(value: Any) -> Any:
    """Return a figure that is written as its value alone with its key."""
    return {"value": value} if isinstance(value, str | int | float) else value


class FieldSpec(Section):
    """A measured field of displacements, as digital image correlation gives it."""

    file: _text_file(*MEASURED) = Field(examples=["dic-20mm.csv"])  # type: ignore[valid-type]
    """Its cloud of points: columns x, y, ux and uy, in the sheet's coordinates at rest."""

    at: Length = Field(examples=["20 mm"])
    """Displacement of the program at which it was taken, on the first way there."""

    error: Annotated[float, Quantity(unit="m", above=0.0)] = Field(examples=["0.05 mm"])
    """Standard error of each component of a displacement."""

    subset: Annotated[float, Quantity(unit="m", least=0.0)] = Field(default=0.0, examples=["3 mm"])
    """Side of the squares that the correlation compares: the points of one square count as one, for
    their errors are not independent. Unless given, each point counts alone."""

    columns: Mapping[str, str | int] = Field(default={}, examples=[{"ux": "U [mm]"}])
    """Names or numbers (from 1) of columns, by x, y, ux, uy, where the header does not tell."""

    units: Mapping[str, str] = Field(default={}, examples=[{"x": "mm"}])
    """Their units, where the header does not tell."""


class Test(Section):
    """A test: the case that describes it, and what was measured: a curve, figures, fields."""

    case: _text_file(".yaml", ".yml") = Field(examples=["sample.yaml"])  # type: ignore[valid-type]
    """The case file."""

    fabric: _text_file(".yaml", ".yml") | None = Field(  # type: ignore[valid-type]
        default=None, examples=["../fabrics/glass-plain.yaml"]
    )
    """A fabric file, if the case is a test without one."""

    set: Mapping[str, Any] = Field(default={}, examples=[{"sheet.length": "230 mm"}])
    """Values that replace those of the case, by dotted key."""

    measured: _Files = Field(default=(), min_length=1, examples=["sample.csv"])
    """The measured file, or a list of those of several specimens, which replicate the test."""

    figures: Mapping[str, Annotated[FigureSpec, BeforeValidator(_figure_spec)]] = Field(
        default={}, min_length=1, examples=[{"G": "1.5 gf/(cm*deg)", "2HG": "2.4 gf/cm"}]
    )
    """Measured figures of the standard test that the case names in its own ``figures``, in place of
    a measured file."""

    fields: tuple[FieldSpec, ...] = Field(
        default=(),
        min_length=1,
        examples=[[{"file": "dic-20mm.csv", "at": "20 mm", "error": "0.05 mm"}]],
    )
    """Measured fields of displacements, beside a measured file or figures, or alone."""

    columns: Columns = Columns()
    """Its columns."""

    units: Units = Units()
    """Their units."""

    rows: _Rows = None
    """First and last line of the file with numbers to read, where it has several tables."""

    decimal: Literal["", ".", ","] = Field(default="", examples=[","])
    """Its decimal sign, where the numbers do not tell."""

    sheet: str = Field(default="", examples=["Specimen 1"])
    """Its sheet, if it is a workbook; that with the most rows of numbers unless given."""

    drift: _Number = Field(default=0, examples=[20])
    """Rows at each end of the record at which the sample is without force: in between the zero of
    the force drifts evenly."""

    zero: _Number = Field(default=0, examples=[20])
    """Rows at rest at the start, whose mean force and displacement become zero."""

    preload: _Force = 0.0
    """Displacements count from where the force first reaches this; rows before are left out."""

    cycle: _Number = Field(default=0, examples=[5])
    """The only cycle that counts, from 1; it is compared with the last one of the program."""

    thin: _ShareOrForce | None = Field(default=None, examples=["0.1 %"])
    """Distance, in N or of the largest force, within which straight lines between means of
    neighbouring rows follow the record, beyond its noise: the means take the place of the rows."""

    error: _ShareOrForce = Field(default=(0.01, True), examples=["1 %"])
    """Standard error of a measured force, in N or of the largest force; of replicates the least
    one of their mean; of figures that of each, of its value."""

    weight: float = Field(default=1.0, gt=0.0, examples=[2.0])
    """Weight of the test beside others."""

    toe: Length = 0.0
    """Measured points of a smaller displacement (slack, the toe of the curve) are left out."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Test:
        if (self.measured and self.figures) or not (self.measured or self.figures or self.fields):
            remedy = "Two tests of the list may have the same case, which is run once."
            raise value_error("a test has a file 'measured', or 'figures', or 'fields'", remedy)
        if self.figures and not self.error[1]:
            raise value_error("the error of figures is a share of each", "For example '1 %'.")
        return self


class ParameterSpec(Section):
    """A parameter to find."""

    start: float | str | None = Field(default=None, examples=["400 N/m"])
    """Where the search starts; from the case and the size of the forces unless given."""

    bounds: Annotated[tuple[float | str, float | str], Several()] | None = Field(
        default=None, examples=[["1 N/m", "1 kN/m"]]
    )
    """Smallest and largest value; a thousandth and a thousand times the start unless given."""

    scale: Literal["log", "linear"] | None = None
    """Steps by factors or by differences; by factors where all values are positive."""


class FitFile(Section):
    """A fit."""

    title: str = ""
    """One line for people."""

    refine: bool = True
    """Whether cells and steps become smaller than those of the cases where their error is more than
    a tenth of the misfit."""

    tests: tuple[Test, ...] = Field(min_length=1)
    """The tests."""

    parameters: Mapping[str, ParameterSpec | None] = Field(
        min_length=1, examples=[{"shear.stiffness": {"start": "4 N/m"}}]
    )
    """What is sought: effect.parameter, effect.parameter[1] of one family, effect.parameter#2 for
    the second number in its formula, or one of the machine: machine.compliance,
    machine.displacement, machine.force."""

    profiles: tuple[str, ...] = Field(default=(), examples=[["shear.stiffness"]])
    """Parameters over which the misfit is found with all others free: exact intervals, at the price
    of about fifteen coarse runs each."""


@dataclass(frozen=True)
class FitParameter:
    """A parameter with its bounds, in its unit.

    Attributes:
        name: As in the fit file.
        unit: SI unit; as written for a coefficient of a formula.
        target: The material parameter; None for one of the machine.
        start: Where the search starts.
        scaled: Whether all strength and stiffness are multiplied for a start.
        bounds: Smallest and largest value.
        by_factors: Whether the search steps by factors.
    """

    name: str
    unit: str
    target: Target | None
    start: float
    scaled: bool
    bounds: tuple[float, float]
    by_factors: bool

    def slope(self, value: float) -> float:
        """Return the derivative of a value by the scaled parameter, in the unit."""
        return value if self.by_factors else self.bounds[1] - self.bounds[0]


@dataclass(frozen=True)
class MeasuredTest:
    """A measured curve as it is fitted.

    Attributes:
        case: Its case.
        replicates: Its curves.
        error: Standard error of a force, N; of replicates the least one of their mean.
        weight: Its weight.
        toe: Displacement (m) below which points are left out.
        thinning: What became of the rows of the record; None if all are there.
    """

    case: Case
    replicates: Replicates
    error: float
    weight: float
    toe: float
    thinning: Thinning | None = None

    share: ClassVar[float] = 1.0

    @property
    def name(self) -> str:
        """Name of its file."""
        return self.measured.file.name

    @property
    def specimens(self) -> tuple[Measured, ...]:
        """The curves of each specimen."""
        return self.replicates.specimens

    @property
    def measured(self) -> Measured:
        """The curve that is fitted: the mean of replicates."""
        return self.replicates.mean

    @cached_property
    def errors(self) -> Array:
        """Standard error of each force, N, shape (rows,).

        That of the mean of replicates, and the stated error at least: the scatter of a few
        specimens is small by chance at some rows, which would then outweigh all others, and what
        the machine errs is the same in all specimens. Where rows are means of a record's rows, each
        weighs as many of these as it stands for.
        """
        errors = np.maximum(self.replicates.error, self.error)
        return np.asarray(errors / np.sqrt(self.replicates.shares))

    @property
    def factors(self) -> Array:
        """What makes a residual of the distance of a force, 1/N, shape (rows,)."""
        factors: Array = np.sqrt(self.weight) / self.errors
        return factors


@dataclass(frozen=True)
class MeasuredFigure:
    """A figure of a standard test as it is fitted.

    Attributes:
        name: As in ``figures.json``.
        unit: SI unit, of ``record.figures.LABORATORY``.
        value: In that unit.
        error: Its standard error, in that unit.
    """

    name: str
    unit: str
    value: float
    error: float


@dataclass(frozen=True)
class FigureTest:
    """Measured figures of a standard test, as they are fitted.

    Attributes:
        case: Its case.
        standard: Its standard test.
        figures: Those that were measured.
        weight: Its weight.
    """

    case: Case
    standard: StandardTest
    figures: tuple[MeasuredFigure, ...]
    weight: float
    specimens: ClassVar[tuple[Measured, ...]] = ()
    share: ClassVar[float] = 1.0

    @property
    def name(self) -> str:
        """Name of the standard test."""
        return self.standard.name

    @property
    def errors(self) -> Array:
        """Standard error of each figure, in SI units, shape (figures,)."""
        return np.array([figure.error for figure in self.figures])

    @property
    def factors(self) -> Array:
        """What makes a residual of the distance of a figure, in SI units, shape (figures,)."""
        factors: Array = np.sqrt(self.weight) / self.errors
        return factors


@dataclass(frozen=True)
class FieldTest:
    """A measured field of displacements, as it is fitted.

    Attributes:
        case: Its case, a step of which ends at ``time``.
        file: Where it is from.
        points: Reference positions, shape (n, 2), m.
        displacements: Measured there, shape (n, 2), m.
        at: Displacement of the program, m.
        time: When the program first reaches it, s.
        error: Standard error of each component, m.
        subset: Side of the squares whose points count as one, m; zero if all count.
        weight: Its weight.
    """

    case: Case
    file: Path
    points: Array
    displacements: Array
    at: float
    time: float
    error: float
    subset: float
    weight: float
    specimens: ClassVar[tuple[Measured, ...]] = ()

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.file.name

    @property
    def errors(self) -> Array:
        """Standard error of each component of each point, m, shape (2n,)."""
        return np.full(2 * len(self.points), self.error)

    @property
    def factors(self) -> Array:
        """What makes a residual of the distance of a component, 1/m, shape (2n,)."""
        factors: Array = np.sqrt(self.weight) / self.errors
        return factors

    @cached_property
    def share(self) -> float:
        """Number of squares that hold a point over that of points: the part that is independent."""
        if not self.subset:
            return 1.0
        squares = np.floor((self.points - self.points.min(axis=0)) / self.subset)
        return len(np.unique(squares, axis=0)) / len(self.points)

    @cached_property
    def key(self) -> str:
        """What its computed field depends on, beside the case."""
        return sha256(self.points.tobytes() + repr(self.time).encode()).hexdigest()[:16]


#: What is fitted.
FittedTest = MeasuredTest | FigureTest | FieldTest


@dataclass(frozen=True)
class Fit:
    """A fit that can be made.

    Attributes:
        title: One line for people.
        name: Name of the file without its suffix.
        tests: The tests.
        unknowns: The parameters.
        refine: Whether runs may be finer than the cases say.
        profiles: Names of parameters whose profiles are wanted.
    """

    title: str
    name: str
    tests: tuple[FittedTest, ...]
    unknowns: tuple[FitParameter, ...]
    refine: bool = True
    profiles: tuple[str, ...] = ()


def read_fit(path: Path, leave_out: bool = False) -> Fit:
    """Return what a fit file asks for.

    Args:
        path: The file.
        leave_out: Whether each experiment is to be left out: there must be several.

    Raises:
        CaseError: With everything that is wrong in it, in its cases or measured files.
    """
    document = read_document(path)
    try:
        given = FitFile.model_validate(document.data, context={"folder": path.parent})
    except ValidationError as error:
        raise CaseError(problems_in(error, document, FitFile.model_json_schema())) from error
    # Each with the number of its test in the file: fields are tests of their own.
    numbered = [
        (number, one)
        for number, test in enumerate(given.tests)
        for one in _tests(test, document, number)
    ]
    tests = tuple(one for _, one in numbered)
    problems: list[CaseProblem] = [
        test.case.problem("accuracy", "a fit chooses cells and steps itself", "Leave it out.")
        for test in tests
        if test.case.accuracy is not None
    ]
    unknowns = []
    for name, sought in given.parameters.items():
        try:
            unknowns.append(_unknown(name, sought or ParameterSpec(), tests[0].case))
        except PydanticCustomError as error:
            problems.append(document.problem(("parameters", name), *reason(error)))
    problems += [
        document.problem(("profiles", i), f"{name!r} is none of the parameters to find")
        for i, name in enumerate(given.profiles)
        if name not in given.parameters
    ]
    unknowns = [_keeping_ratio(unknown, tests) for unknown in unknowns]
    for unknown in unknowns:
        for number, test in numbered:
            if unknown.target and unknown.target.effect not in test.case.effects:
                message = f"the case of tests.{number} has no effect {unknown.target.effect!r}"
                problems.append(document.problem(("parameters", unknown.name), message))
            elif unknown.target:
                try:  # the same number must be there in each case
                    meaning_of(unknown.target, test.case)
                except PydanticCustomError as error:
                    message, remedy = reason(error)
                    message = f"in the case of tests.{number} {message}"
                    problems.append(document.problem(("parameters", unknown.name), message, remedy))
    if leave_out and len(experiments(tests)) == 1:
        message = "there is one experiment: without it nothing is left to be fitted"
        remedy = "Add a test of another size, kind or rate, or fit without --leave-out."
        problems.append(document.problem(("tests",), message, remedy))
    if problems:
        raise CaseError(problems)
    return Fit(given.title, path.stem, tests, tuple(unknowns), given.refine, given.profiles)


def experiments(tests: Sequence[FittedTest]) -> tuple[tuple[int, ...], ...]:
    """Return the numbers, from 0, of the tests of each experiment: those of one case are one."""
    numbers: dict[str, list[int]] = {}
    for number, test in enumerate(tests):
        numbers.setdefault(fingerprint(test.case), []).append(number)
    return tuple(map(tuple, numbers.values()))


def _tests(test: Test, document: Document, number: int) -> tuple[FittedTest, ...]:
    """Return a test as it is fitted, and its fields; ``number`` is its place in the fit file.

    Raises:
        CaseError: With everything that is wrong in its case, measured files or figures.
    """
    case = read_case(test.case, dict(test.set), test.fabric)
    times, problems = [], []
    for k, one in enumerate(test.fields):
        try:
            times.append(_time_at(one.at, case))
        except PydanticCustomError as error:
            path = ("tests", number, "fields", k, "at")
            problems.append(document.problem(path, *reason(error)))
    if problems:
        raise CaseError(problems)
    case = with_extra_times(case, sorted({*case.time.extra_times, *times})) if times else case
    tests: list[FittedTest] = []
    if test.figures:
        tests.append(_figure_test(test, case, document, number))
    elif test.measured:
        tests.append(_curve_test(test, case))
    for one, time in zip(test.fields, times, strict=True):
        cloud = read_cloud(one.file, Layout(one.columns, one.units))
        place = (one.at, time, one.error, one.subset, test.weight)
        tests.append(FieldTest(case, one.file, cloud.points, cloud.displacements, *place))
    return tuple(tests)


def _time_at(displacement: float, case: Case) -> float:
    """Return the time (s) at which the program of a case first reaches a displacement (m).

    Raises:
        PydanticCustomError: With message and remedy.
    """
    program = program_of_case(case)
    if program.changes:
        raise value_error("a field at a displacement needs a program of displacements")
    for before, after in pairwise(program.milestones):
        if min(before.value, after.value) <= displacement <= max(before.value, after.value):
            found = brentq(lambda time: program.value(time) - displacement, before.time, after.time)
            if found > 0:
                return float(found)
    values = [1e3 * milestone.value for milestone in program.milestones]
    remedy = f"It moves from {min(values):.4g} to {max(values):.4g} mm."
    raise value_error(f"the program does not reach {1e3 * displacement:.4g} mm", remedy)


def _figure_test(test: Test, case: Case, document: Document, number: int) -> FigureTest:
    standards = standard_tests_of(case)
    if len(standards) != 1:
        message = "a test with measured figures names one standard test, and is a rectangle"
        raise CaseError([case.problem("figures", message, "For example 'figures: kes-shear'.")])
    units_of = {name: figure.unit for name, figure in figures_at_rest(standards[0]).items()}
    figures, problems = [], []
    for name, spec in test.figures.items():
        try:
            figures.append(_figure(name, spec, units_of, test.error[0]))
        except PydanticCustomError as error:
            problems.append(document.problem(("tests", number, "figures", name), *reason(error)))
    if problems:
        raise CaseError(problems)
    return FigureTest(case, standards[0], tuple(figures), test.weight)


def _figure(
    name: str, spec: FigureSpec, units_of: Mapping[str, str], share: float
) -> MeasuredFigure:
    """Return a measured figure; ``share`` is the error of its value unless it has its own.

    Raises:
        PydanticCustomError: With message and remedy.
    """
    if name not in units_of:
        known = f"It has {', '.join(units_of)}."
        raise value_error(f"the test has no figure {name!r}", near_miss(name, units_of) or known)
    unit = units_of[name]
    written = "" if unit in PURE else unit
    value = _si(spec.value, written)
    if not value:
        raise value_error("a figure of zero has no relative error", "Leave it out.")
    error = share * abs(value)
    if spec.error is not None:
        of_value = units.measures(spec.error, "")
        error = units.parse(spec.error, "") * abs(value) if of_value else _si(spec.error, written)
    if not error > 0:
        raise value_error("expected a positive error", "For example '2 %'.")
    return MeasuredFigure(name, unit, value, error)


def _curve_test(test: Test, case: Case) -> MeasuredTest:
    columns, units = (s.model_dump(exclude_none=True) for s in (test.columns, test.units))
    layout = Layout(columns, units, test.rows, test.decimal, test.sheet)
    specimen = shear_test_of(case)
    correction = Correction(test.drift, test.zero, test.preload, test.cycle)
    curves = [corrected(read_measured(f, layout, specimen), correction) for f in test.measured]
    replicates = replicates_of(curves)
    size, thinning = float(abs(replicates.mean.force).max()), None
    error, within = (
        number * size if share else number for number, share in (test.error, test.thin or (0.0, 1))
    )
    if test.thin:
        replicates, thinning = thinned(replicates, within)
    return MeasuredTest(case, replicates, error, test.weight, test.toe, thinning)


def _unknown(name: str, sought: ParameterSpec, case: Case) -> FitParameter:
    """Return a parameter with its bounds.

    Raises:
        PydanticCustomError: With message and remedy.
    """
    effect, _, rest = name.partition(".")
    if effect == MACHINE_NAME:
        if rest not in MACHINE:
            raise value_error(f"the machine has no {rest!r}", f"It has {', '.join(MACHINE)}.")
        unit, target, value, least = MACHINE[rest], None, 0.0, -inf
        if rest == "compliance":
            least = 0.0
    else:
        target = target_of(name, case)
        unit, value, least = meaning_of(target, case)
    start = _si(sought.start, unit) if sought.start is not None else value
    if sought.bounds is not None:
        low, high = (_si(b, unit) for b in sought.bounds)
    elif target is None:
        remedy = "For example 'bounds: [0 mm, 2 mm]'."
        raise value_error("a parameter of the machine needs bounds", remedy)
    else:
        low, high = max(least, start * 1e-3), start * 1e3
    if not low < high or low < least:
        raise value_error(f"the bounds must increase from {least:g} on, got {low:g} and {high:g}")
    if not low <= start <= high:
        raise value_error(f"the start {start:g} {unit} is outside of the bounds")
    by_factors = sought.scale == "log" or (sought.scale is None and low > 0)
    if by_factors and low <= 0:
        raise value_error("a search by factors needs positive bounds", "Take 'scale: linear'.")
    scaled = sought.start is None and target is not None and not target.coefficient
    return FitParameter(name, unit, target, start, scaled, (low, high), by_factors)


def _keeping_ratio(unknown: FitParameter, tests: Sequence[FittedTest]) -> FitParameter:
    """Return an unknown by a common factor if it stands for both families of an unequal pair."""
    if (target := unknown.target) is None or target.coefficient or len(target.families) == 1:
        return unknown
    given = [t.case.effects.get(target.effect, {}).get(target.parameter) for t in tests]
    unequal = any(isinstance(pair, tuple) and pair[0] != pair[1] for pair in given)
    return replace(unknown, target=replace(target, relative=unequal))


def target_of(name: str, case: Case) -> Target:
    """Return the parameter of a case that a name means, such as ``bending.stiffness[1]``.

    Raises:
        PydanticCustomError: With message and remedy.
    """
    effect, _, rest = name.partition(".")
    match = _PARAMETER.fullmatch(rest)
    parameter = match["parameter"] if match else rest
    if effect not in case.effects:
        known = f"The effects are {', '.join(case.effects)}."
        raise value_error(
            f"the case has no effect {effect!r}", near_miss(effect, case.effects) or known
        )
    if parameter not in case.effects[effect]:
        known = f"It has {', '.join(case.effects[effect])}."
        raise value_error(f"{effect} has no parameter {parameter!r}", known)
    family, coefficient = (match["family"], match["coefficient"]) if match else (None, None)
    if family not in (None, "1", "2"):
        raise value_error("the families are [1] and [2]")
    families = (0, 1) if family is None else (int(family) - 1,)
    target = Target(effect, parameter, families, int(coefficient or 0))
    value = case.effects[effect][parameter]
    formula = value[families[0]] if isinstance(value, tuple) else value
    if isinstance(formula, Expression) and 0 < target.coefficient <= len(coefficients(formula)):
        try:
            with_change(formula, target.coefficient)
        except FormulaError as error:  # the exponent of a length, which the unit depends on
            number = coefficients(formula)[target.coefficient - 1][0]
            message = f"the number {number:g} of the formula {formula.text!r} must stay"
            raise value_error(message, f"With another one {error}.") from error
    return target


def meaning_of(target: Target, case: Case) -> tuple[str, float, float]:
    """Return a parameter's unit, its value in the case and its least value."""
    value = case.effects[target.effect][target.parameter]
    if isinstance(value, tuple):
        if target.coefficient and value[0] != value[1] and len(target.families) == 2:
            raise value_error("each family has a formula of its own", "Say which: [1] or [2].")
        chosen = [value[f] for f in target.families]
        if not target.coefficient and any(isinstance(v, Expression) for v in chosen):
            raise value_error(
                "the case gives this parameter by a formula of each family",
                f"Seek one family, or a coefficient of one, such as {target}[1]#1.",
            )
        if len(chosen) == 2 and chosen[0] != chosen[1] and 0.0 in chosen:
            raise value_error(
                "a pair of which one value is zero has no ratio", "Say which: [1] or [2]."
            )
        value = chosen[0]
    elif len(target.families) == 1:
        raise value_error("both families have the same value", "Give the case a pair of values.")
    numbers = coefficients(value)
    if target.coefficient:
        if target.coefficient > len(numbers):
            remedy = "They are the numbers of a formula, counted from 1."
            raise value_error(f"the value has {len(numbers)} coefficients", remedy)
        number, unit = numbers[target.coefficient - 1]
        return unit, number, -inf
    if isinstance(value, Expression):
        remedy = f"Seek its coefficients: {target}#1 to {target}#{len(numbers)}, in their order."
        raise value_error("the case gives this parameter by a formula", remedy)
    term = next(e for e in case.scene if e.name == target.effect)
    parameter = next(p for p in term.effect.parameters if p.name == target.parameter)
    return parameter.unit, float(value), 0.0 if parameter.above is None else parameter.above


def _si(value: float | str, unit: str) -> float:
    try:
        number = units.parse(value, unit) if isinstance(value, str) else float(value)
        if not isfinite(number):
            raise ValueError(value)
    except ValueError as error:
        raise value_error(f"expected {units.kind(unit)}, got {error}") from error
    return number


def with_values(
    case: Case, unknowns: tuple[FitParameter, ...], values: Mapping[str, float]
) -> Case:
    """Return a case with other values of its material parameters, by name and in their units."""
    for unknown in unknowns:
        if unknown.target is not None:
            case = with_value(case, unknown.target, values[unknown.name], unknown.unit)
    return case


def with_value(case: Case, target: Target, value: float, unit: str) -> Case:
    """Return a case with another value of a parameter, in its unit."""
    old = case.effects[target.effect][target.parameter]
    pair = old if isinstance(old, tuple) else (old,)
    new: list[Any] = [v.text if isinstance(v, Expression) else units.write(v, unit) for v in pair]
    families = target.families if len(pair) == 2 else (0,)
    for family in families:
        old_value, first = pair[family], pair[families[0]]
        if isinstance(old_value, Expression):
            new[family] = with_coefficient(old_value, target.coefficient, value)
        else:  # the second family keeps its ratio to the first
            if isinstance(first, Expression) or old_value == first:
                ratio = 1.0
            else:
                ratio = old_value / first
            new[family] = units.write(value * ratio, unit)
    key = f"effects.{target.effect}.{target.parameter}"
    return case.changed({key: new if len(pair) == 2 else new[0]})
