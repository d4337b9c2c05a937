"""A user's own effects, each a Python file beside the case that names it.

Such a file is run only because a case names it, and leaves nothing behind: the
effect is passed on as an object, so that two cases may each have their own effect
of the same name.
"""

from __future__ import annotations

import re
import signal
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from types import ModuleType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

import ufl
from pydantic_core import PydanticCustomError

from wovenfab import forms
from wovenfab.case import units
from wovenfab.case.document import FILE, LAW, existing_file
from wovenfab.case.effects import RESISTIBLE, CustomEffect, CustomEffects, Scene
from wovenfab.case.errors import one_of, refusal, wrong
from wovenfab.forms.balance import Balance, Rate
from wovenfab.forms.effect import Effect, Term
from wovenfab.forms.friction import components_of
from wovenfab.forms.kinematics import point_of
from wovenfab.lacking import LackingError
from wovenfab.plain_text import in_brief

#: Keys of an effect that are no parameters.
RESERVED = (FILE, LAW)
#: Seconds that the file of an effect, or its forms, may take.
PATIENCE = 5.0
_NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")


def custom_effects(files: Mapping[str, Any], folder: Path) -> CustomEffects:
    """Return the effects that a case in a folder names by (perhaps invalid) files, in its order."""
    effects: dict[str, CustomEffect | PydanticCustomError] = {}
    for key, file in files.items():
        try:
            effects[key] = _custom_effect(key, file, folder)
        except PydanticCustomError as error:
            effects[key] = error
    return effects


def _custom_effect(key: str, value: Any, folder: Path) -> CustomEffect:
    path = existing_file(value, folder, (".py",))
    if key in forms.effects():
        raise wrong(f"there is an effect '{key}' already", "Give yours another name.")
    if not _NAME.fullmatch(key):
        raise wrong("the name of an effect is a letter, then letters, digits and '_'")
    effect = _loaded(path, value)
    if effect.name != key:
        raise wrong(
            f"{value} defines the effect '{effect.name}', not '{key}'",
            f"Use '{effect.name}' as the key here, or set name=\"{key}\" there.",
        )
    resisted = frozenset().union(*(law.resists for law in effect.all_laws))
    if unknown := sorted(resisted - set(RESISTIBLE)):
        raise wrong(
            f"{value}: the effect resists '{unknown[0]}', which is not known",
            f"It may be {one_of(RESISTIBLE)}.",
        )
    for law in effect.all_laws:
        _check_parameters(law, value)
        _check_forms(law, path, value)
    return CustomEffect(effect, path)


def _loaded(path: Path, value: str) -> Effect:
    """Return ``EFFECT`` of a file, which is run for that."""
    # As if it lay in forms/, so that it can be moved there as it is.
    module = ModuleType(f"wovenfab.forms.custom:{path}")
    module.__package__, module.__file__ = "wovenfab.forms", str(path)
    sys.modules[module.__name__] = module  # dataclasses look themselves up there
    try:
        with _limited():
            exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), module.__dict__)
    except SyntaxError as error:
        line = error.lineno if error.filename == str(path) else _line(error, path)
        raise wrong(f"{value}:{line}: {error.msg}", "This is not valid Python.") from error
    except (Exception, SystemExit) as error:
        old = isinstance(error, ImportError) and (error.name or "").partition(".")[0] == "forms"
        remedy = "Import from wovenfab.forms in place of forms." if old else ""
        raise wrong(f"{value}:{_line(error, path)}: {in_brief(error)}", remedy) from error
    finally:
        sys.modules.pop(module.__name__)
    if "EFFECT" not in module.__dict__:
        raise wrong(f"{value} defines no EFFECT", "It must end with 'EFFECT = Effect(...)'.")
    effect = module.__dict__["EFFECT"]
    if not isinstance(effect, Effect):
        raise wrong(
            f"EFFECT in {value} is of type {type(effect).__name__}, not Effect",
            "It must be an Effect of wovenfab.forms.effect.",
        )
    if unfit := next(_unfit(effect, "EFFECT"), None):
        raise wrong(f"{value}: {unfit}")
    return effect


def _unfit(item: Any, where: str) -> Iterator[str]:
    """Yield what in a dataclass is not of the type that it says, in words."""
    for name, hint in get_type_hints(type(item)).items():
        part, place = getattr(item, name), f"{where}.{name}"
        kinds = [get_origin(kind) or kind for kind in get_args(hint) or [hint]]
        if get_origin(hint) is not UnionType:
            kinds = [get_origin(hint) or hint]
        if not isinstance(part, tuple(int | float if k is float else k for k in kinds)):
            expected = " or ".join(k.__name__.replace("NoneType", "None") for k in kinds)
            yield f"{place} is of type {type(part).__name__}, not {expected}"
        elif isinstance(part, tuple):
            wanted = get_args(hint)[0]
            for i, one in enumerate(part):
                if isinstance(one, wanted):
                    yield from _unfit(one, f"{place}[{i}]")
                else:
                    kind = type(one).__name__
                    yield f"{place}[{i}] is of type {kind}, not {wanted.__name__}"
        elif is_dataclass(part):
            yield from _unfit(part, place)


def _check_forms(effect: Effect, path: Path, value: str) -> None:
    problem = ""
    try:
        with _limited():
            try_forms(effect)
    except (Exception, SystemExit) as error:
        line = "".join(f":{line}" for line in _lines(error, path)[-1:])
        problem = f"{value}{line}: {in_brief(error)}"
    if problem:  # raised out here, where nothing holds the symbols any more
        raise wrong(problem, REMEDY)


@contextmanager
def _limited() -> Iterator[None]:
    """End what takes too long, such as a loop without an end.

    Raises:
        TimeoutError: After some seconds.
    """

    def end(*_: object) -> None:
        raise TimeoutError(f"it was not ready after {PATIENCE:g} s")

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)


def _line(error: BaseException, path: Path) -> int | None:
    """Return the last line of a file that led to an error, or its first."""
    return [1, *_lines(error, path)][-1]


def _lines(error: BaseException, path: Path) -> list[int | None]:
    frames = traceback.extract_tb(error.__traceback__)
    return [frame.lineno for frame in frames if frame.filename == str(path)]


def _check_parameters(effect: Effect, value: str) -> None:
    named: list[tuple[Any, str]] = [(p, "parameter") for p in effect.parameters]
    named += [(v, "internal variable") for v in effect.memory]
    times = Counter(one.name for one, _ in named)
    for one, kind in reversed(named):
        if not _NAME.fullmatch(one.name) or one.name in RESERVED or times[one.name] > 1:
            article = "an" if kind[0] in "aeiou" else "a"
            raise wrong(
                f"{value}: {article} {kind} cannot be named {one.name!r}",
                f"Names are unique, of letters, digits and '_', and not {one_of(RESERVED)}.",
            )
    for one, kind in named:
        try:
            factor, _ = units.in_si("" if one.unit == "1" else one.unit)
        except ValueError as error:
            raise wrong(f"{value}: the {kind} '{one.name}' has {error}") from error
        if factor != 1:
            raise wrong(
                f"{value}: the unit '{one.unit}' of '{one.name}' is not an SI unit",
                "Write it in m, kg, s, N, J or rad; a case may use any other.",
            )


DEGREE = 2
#: What is asked of the functions of an effect.
REMEDY = (
    "Its functions return one number in J/m^2 (an energy), W/m^2 (a dissipation) or the unit of "
    "an internal variable (its update), made of what they are given by Python's operators and the "
    "functions of UFL."
)


@contextmanager
def custom_effect_errors(scene: Scene) -> Iterator[None]:
    """Take what fails inside, where a scene is built, for a fault of the user's own effects.

    Raises:
        CaseError: If the scene has any, with their files and the cause.
    """
    try:
        yield
    except (OSError, MemoryError, LackingError):
        raise
    except (Exception, SystemExit) as error:
        files = ", ".join(e.file.name for e in scene if e.file)
        if not files:
            raise
        raise refusal(files, f"the effect cannot be compiled: {in_brief(error)}", REMEDY) from error


def try_forms(effect: Effect) -> None:
    """Form potential, residual and tangent of an effect on a sheet of symbols.

    Raises:
        ValueError: If an energy is not one number at each point.
        Exception: Whatever the functions of the effect, or UFL about them, raise.
    """
    term, balance = _balance(effect)
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    if effect.energy is not None:
        _require_scalar("energy", effect.energy(point, term.values))
    if effect.strains is not None:
        for strain in effect.strains(point, term.values):
            _require_scalar("the measure of a strain", strain.measure)
            _require_scalar("the stiffness of a strain", strain.stiffness)
    if effect.dissipation is not None and effect.measure is not None:
        rate = ufl.variable(effect.measure(point))
        _require_scalar("dissipation", effect.dissipation(rate, term.values))
    for variable in effect.memory:
        updated = variable.update(point, point, term.values, 1.0)
        _require_scalar(f"the update of '{variable.name}'", updated)
    space = balance.field.ufl_function_space()
    test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
    balance.potential()
    balance.power()
    balance.residual(test)
    balance.jacobian(trial, test, ufl.Coefficient(space))
    if effect.bound is not None:
        _try_bound(term, balance, trial, test)


def _try_bound(term: Term, balance: Balance, trial: Any, test: Any) -> None:
    """Form what a friction with carried stress consists of."""
    import basix.ufl  # not for those without effects of their own

    from wovenfab.model.friction_stress import FrictionStress  # loads dolfinx

    size, degree = components_of(term, balance), DEGREE
    element = basix.ufl.quadrature_element("triangle", value_shape=(size,), degree=degree)
    space = ufl.FunctionSpace(balance.field.ufl_function_space().ufl_domain(), element)
    carried = FrictionStress(term, balance, ufl.Coefficient(space), ufl.Coefficient(space), degree)
    _require_scalar("the strength of a bound", carried.strength())
    carried.jacobian(trial, test)
    carried.residual(test)
    carried.creep()
    carried.loss()


def _require_scalar(what: str, given: Any) -> None:
    try:
        value = ufl.as_ufl(given)
    except (TypeError, ValueError):
        value = None
    if not isinstance(value, ufl.classes.Expr) or isinstance(value, ufl.classes.Condition):
        raise ValueError(f"{what} gives {type(given).__name__}, not a number")
    if value.ufl_shape != ():
        raise ValueError(f"{what} gives a value of shape {value.ufl_shape}, not one number")


def _balance(effect: Effect) -> tuple[Term, Balance]:
    """Return the effect and the balance of it alone, with nothing but symbols in it."""
    import basix.ufl  # not for those without effects of their own

    def element(degree: int, size: int) -> Any:
        return basix.ufl.element("Lagrange", "triangle", degree, shape=(size,))

    mesh = ufl.Mesh(element(1, 2))
    space = ufl.FunctionSpace(mesh, element(DEGREE, 2 * effect.needs.placements))
    fibres = (ufl.Constant(mesh, shape=(2,)), ufl.Constant(mesh, shape=(2,)))
    values = {
        p.name: (ufl.Constant(mesh), ufl.Constant(mesh)) if p.per_family else ufl.Constant(mesh)
        for p in effect.parameters
    } | {v.name: ufl.Constant(mesh) for v in effect.memory}
    rate = Rate((ufl.Constant(mesh), ufl.Constant(mesh)), (ufl.Coefficient(space),))
    term = Term(effect, values, 1)
    return term, Balance(
        terms=() if effect.set_valued else (term,),
        fibres=fibres,
        field=ufl.Coefficient(space),
        rate=rate if effect.needs.history else None,
        degree=DEGREE,
        quadrature=2 * DEGREE,
        held_edges=(ufl.ds(0), ufl.ds(0)),
    )
