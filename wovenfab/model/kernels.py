"""How kernels are written: with derivatives along constant directions, as small matrices.

FFCx writes a kernel for any form. What a sheet stores and dissipates depends on few derivatives of
placements, all along fibres. Two things make kernels of such forms smaller, which halves the time
to compile and to run them (``python3 -m benchmarks assembly``): a table holds the derivatives of
the shape functions along the fibres of a cell, where FFCx transforms products of those by reference
coordinates at each point; and tangents are products of small matrices.
"""

from __future__ import annotations

import gc
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count, product
from typing import Any

import dolfinx.jit
import ffcx.options
import numpy as np
import ufl
from ffcx.codegeneration import lnodes
from ffcx.ir.analysis.valuenumbering import ValueNumberer
from ffcx.ir.elementtables import get_ffcx_table_values, permute_quadrature_interval
from ufl.algorithms import apply_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import Dot, FormArgument, GeometricQuantity, Grad, Label, ReferenceGrad
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from wovenfab.compat import rule_of
from wovenfab.forms.kinematics import cross

try:
    from ffcx.codegeneration.C import integral as _integrals
except ImportError:  # 0.9
    from ffcx.codegeneration.C import integrals as _integrals

#: The module that writes the C code of integrals.
FFCX_KERNELS: Any = _integrals
#: UFL's module of that name, which its function of that name hides.
_ANALYSIS = importlib.import_module("ufl.algorithms.compute_form_data")

#: Doubles that a processor multiplies at once, at least.
LANES = 4


class SmallProducts(FFCX_KERNELS.IntegralGenerator):  # type: ignore[misc] # no types
    """Writes kernels of bilinear forms as products of small matrices.

    At a point, an element's matrix is a sum of blocks R^T C S: the rows of R and S are derivatives
    of the shape functions, C is what the energy says. FFCx writes out each product of a row of R
    and one of S, hundreds in a tangent.
    """

    def __init__(self, *parts: Any) -> None:
        """Take what FFCx knows of an integral."""
        super().__init__(*parts)
        self.numbers = count()

    def generate_quadrature_loop(self, *where: Any) -> list[Any]:
        """Return the code of a loop over points."""
        self.before: list[Any] = []
        self.after: list[Any] = []
        loop = super().generate_quadrature_loop(*where)
        return [*self.before, *loop, *self.after]

    def generate_block_parts(self, *block: Any) -> tuple[list[Any], list[Any]]:
        """Return the code that adds to an element's matrix, and that of its factors."""
        sections, factors = super().generate_block_parts(*block)
        return [*map(self._rewritten, sections)], factors

    def _rewritten(self, section: Any) -> Any:
        """Return a section with matrices where it has products in a loop over j and i."""
        over_j = section.statements[0]
        if lnodes.depth(over_j) != len("ij"):
            return section
        over_i = over_j.body.statements[0]
        bodies = [getattr(body, "statements", [body]) for body in over_i.body.statements]
        terms = [statement.expr for body in bodies for statement in body]
        if any(len(term.rhs.args) != len("CRS") for term in terms):
            return section
        blocks: dict[Any, list[Any]] = {}
        for term in terms:
            blocks.setdefault(tuple(term.lhs.indices[0].symbols), []).append(term)
        # The derivatives that a component of the test function has, and one of the trial function:
        tests: dict[Any, dict[Any, None]] = {}
        trials: dict[Any, dict[Any, None]] = {}
        for (row, column), own in blocks.items():
            for term in own:
                _, r, s = term.rhs.args
                tests.setdefault(row, {})[r] = trials.setdefault(column, {})[s] = None
        alike: dict[Any, list[list[Any]]] = {}
        for (row, column), own in blocks.items():
            alike.setdefault((tuple(tests[row]), tuple(trials[column])), []).append(own)
        code = [
            s for (r, c), own in alike.items() for s in self._product(over_i, over_j, r, c, own)
        ]
        return lnodes.Section(section.name, code, [], section.input, section.output)

    def _product(
        self, over_i: Any, over_j: Any, tests: Any, trials: Any, blocks: list[list[Any]]
    ) -> list[Any]:
        """Return the code that adds to blocks with the same derivatives."""
        scalar, integer = lnodes.DataType.SCALAR, lnodes.DataType.INT
        own = next(self.numbers)
        names = (f"{name}_{own}" for name in ("C", "R", "S", "CS", "sum"))
        c, r, s, cs, total = (lnodes.Symbol(name, scalar) for name in names)
        k, a = (lnodes.Symbol(name, integer) for name in "ka")
        i, rows, j = over_i.index, over_i.end.value, over_j.index
        columns = -(-over_j.end.value // LANES) * LANES  # with zeros to the next multiple
        derivatives, others = range(len(tests)), range(len(trials))

        def loop(index: Any, end: int, *body: Any) -> Any:
            return lnodes.ForRange(index, 0, end, list(body))

        def added(products: list[list[Any]]) -> Any:
            return lnodes.Sum([lnodes.Product(product) for product in products])

        sizes = (len(blocks), rows, columns)
        self.before.append(lnodes.ArrayDecl(total, sizes, [0]))
        entries = [
            lnodes.AssignAdd(block[0].lhs, total[number, i, j])
            for number, block in enumerate(blocks)
        ]
        self.after.append(loop(i, rows, loop(j, over_j.end.value, *entries)))
        factors = [
            lnodes.AssignAdd(c[number, tests.index(r_), trials.index(s_)], factor)
            for number, block in enumerate(blocks)
            for factor, r_, s_ in (term.rhs.args for term in block)
        ]
        return [
            lnodes.ArrayDecl(c, (len(blocks), len(tests), len(trials)), [0]),
            lnodes.ArrayDecl(r, (len(tests), rows), [0]),
            lnodes.ArrayDecl(s, (len(trials), columns), [0]),
            lnodes.ArrayDecl(cs, (len(tests), columns), [0]),
            *factors,
            loop(i, rows, *(lnodes.Assign(r[d, i], tests[d]) for d in derivatives)),
            loop(j, over_j.end.value, *(lnodes.Assign(s[d, j], trials[d]) for d in others)),
            loop(k, len(blocks),
                loop(a, len(tests), loop(j, columns,
                    lnodes.Assign(cs[a, j], added([[c[k, a, b], s[b, j]] for b in others])))),
                loop(i, rows, loop(j, columns,
                    lnodes.AssignAdd(
                        total[k, i, j], added([[r[d, i], cs[d, j]] for d in derivatives])))),
            ),
        ]  # fmt: skip


def directions_of(form: Any) -> tuple[Any, ...]:
    """Return the constant vectors along which a form has derivatives.

    There are none if it has other derivatives, such as those of coordinates, or more than two, or
    linear functions: FFCx has one table for these and for the shape of cells.
    """
    found: dict[Any, None] = {}
    for integral in form.integrals():
        for node in unique_pre_traversal(integral.integrand()):
            if _is_along(node):
                gradient, direction = node.ufl_operands
                if any(isinstance(p, GeometricQuantity) for p in unique_pre_traversal(gradient)):
                    return ()
                found[direction] = None
            elif any(isinstance(part, Grad) for part in node.ufl_operands):
                return ()
    domain = form.ufl_domain()
    if domain is None or not 0 < len(found) <= len("xy"):
        return ()
    functions = {f.ufl_element() for f in (*form.arguments(), *form.coefficients())}
    curved = domain.ufl_coordinate_element().embedded_superdegree > 1
    if curved or any(f.embedded_superdegree == 1 for f in functions):
        return ()
    return tuple(sorted(found, key=lambda constant: constant.count()))


def _is_along(node: Any) -> bool:
    """Return whether an expression is a derivative along a constant direction."""
    if not isinstance(node, Dot):
        return False
    gradient, direction = node.ufl_operands
    return isinstance(gradient, Grad) and isinstance(direction, ufl.Constant)


class _AsPartial(MultiFunction):  # type: ignore[misc] # no types
    """Makes the derivative along a direction the partial one by the coordinate of its number."""

    def __init__(self, directions: tuple[Any, ...]) -> None:
        super().__init__()
        self.directions = directions

    expr = MultiFunction.reuse_if_untouched

    def dot(self, node: Any, gradient: Any, direction: Any) -> Any:
        """Return the partial derivative."""
        if not _is_along(node):
            return self.reuse_if_untouched(node, gradient, direction)
        return gradient[..., self.directions.index(direction)]


class Writer:
    """Writes the kernels of one form."""

    def __init__(self) -> None:
        """Start without any direction."""
        self.directions: tuple[Any, ...] = ()

    def lower(self, usual: Any, form: Any) -> Any:
        """Return a form without abstractions, which UFL makes first of all.

        Args:
            usual: UFL's own way.
            form: The form.
        """
        self.directions = directions_of(form)
        if self.directions:
            form = map_integrand_dags(_AsPartial(self.directions), form)
        return usual(form)

    def gradient(self, usual: Any, function: Any, inverse: Any) -> Any:
        """Return a gradient by those of tables: along directions, or by reference coordinates.

        Args:
            usual: UFL's own way.
            function: What is differentiated.
            inverse: Of the Jacobian.
        """
        return ReferenceGrad(function) if self.directions else usual(function, inverse)

    def generator(self, ir: Any, backend: Any) -> Kernel:
        """Return the generator of an integral's kernel."""
        return Kernel(ir, backend, self.directions)


class Kernel(SmallProducts):
    """Writes tables of derivatives along directions, for each cell."""

    def __init__(self, ir: Any, backend: Any, directions: tuple[Any, ...]) -> None:
        """Take what FFCx knows of an integral.

        Args:
            ir: The integral.
            backend: FFCx's access to symbols.
            directions: Constants along which functions are differentiated.
        """
        super().__init__(ir, backend)
        self.directions = directions
        #: Own tables by FFCx's name and side of a facet, and what they are computed from.
        self.own: dict[tuple[str, Any], Any] = {}
        self.known: dict[Any, Any] = {}
        backend.access.table_access = partial(self._entry, backend.access.table_access)

    def generate_element_tables(self, *where: Any) -> list[Any]:
        """Return the code of all tables."""
        code: list[Any] = []
        for rule, term, table in self._derivatives() if self.directions else ():
            if (table.name, term.restriction) not in self.own:
                code += self._table(rule, term, table)
        return [*code, *super().generate_element_tables(*where)]

    def declare_table(self, name: str, table: Any) -> list[Any]:
        """Return the declaration of a table of FFCx, unless there is an own one."""
        mine = any(name == other for other, _ in self.own)
        return [] if mine else list(super().declare_table(name, table))

    def _entry(
        self, usual: Any, table: Any, entity: Any, side: Any, point: Any, function: Any
    ) -> tuple[Any, list[Any]]:
        """Return the code of an entry of a table, and the tables that it needs."""
        own = self.own.get((table.name, side))
        if own is None:
            code, needed = usual(table, entity, side, point, function)
            return code, needed
        row = lnodes.LiteralInt(0) if table.is_piecewise else point.global_index
        return own[row][function.global_index], [own]

    def _derivatives(self) -> Iterator[tuple[Any, Any, Any]]:
        """Yield derivatives of shape functions with their rules and FFCx's tables."""
        for key, integrand in self.ir.expression.integrand.items():
            rule = rule_of(key)
            for node in integrand["factorization"].nodes.values():
                term, table = node.get("mt"), node.get("tr")
                function = term is not None and isinstance(term.terminal, FormArgument)
                if function and term.local_derivatives and table.ttype != "zeros":
                    yield rule, term, table

    def _table(self, rule: Any, term: Any, table: Any) -> list[Any]:
        """Return the code of an own table of derivatives along directions.

        Each is a sum of those by reference coordinates X: d/ds = dX_k/ds d/dX_k.
        """
        code: list[Any] = []
        side, axes = term.restriction, term.local_derivatives
        own = lnodes.Symbol(table.name + SIDES[side], lnodes.DataType.REAL)
        self.own[table.name, side] = own
        symbols, expression = self.backend.symbols, self.ir.expression
        entity = 0 if table.is_uniform else symbols.entity(expression.entity_type, side)
        turned = symbols.quadrature_permutation[int(side == "-")] if table.is_permuted else 0
        point, function = (lnodes.Symbol(name, lnodes.DataType.INT) for name in ("iq", "ic"))
        sum_of: list[Any] = []
        for along in product((0, 1), repeat=len(axes)):
            rates = [self._rates(axis, side, code)[k] for axis, k in zip(axes, along, strict=True)]
            values = self._reference(rule, term, table, (along.count(0), along.count(1)), code)
            sum_of.append(lnodes.Product([*rates, values[turned][entity][point][function]]))
        points = 1 if table.is_piecewise else len(rule.weights)
        functions = table.values.shape[-1]
        body = lnodes.Assign(own[point][function], lnodes.Sum(sum_of))
        loop = lnodes.ForRange(function, 0, functions, [body])
        return [
            *code,
            lnodes.ArrayDecl(own, (points, functions)),
            lnodes.ForRange(point, 0, points, [loop]),
        ]

    def _rates(self, axis: int, side: Any, code: list[Any]) -> list[Any]:
        """Return the symbols of dX_k/ds along a direction; code is added where they are new."""
        if (axis, side) not in self.known:
            corner = partial(self.backend.symbols.domain_dof_access, gdim=2, num_scalar_dofs=3)
            edges = [
                [corner(k, d, restriction=side) - corner(0, d, restriction=side) for d in (0, 1)]
                for k in (1, 2)
            ]
            constant = self.directions[axis]
            along = [self.backend.symbols.constant_index_access(constant, d) for d in (0, 1)]

            area = cross(*edges)
            rates = [cross(along, edges[1]) / area, cross(edges[0], along) / area]
            names = [f"rate_{k}_{axis}{SIDES[side]}" for k in (0, 1)]
            self.known[axis, side] = [lnodes.Symbol(n, lnodes.DataType.REAL) for n in names]
            code += map(lnodes.VariableDecl, self.known[axis, side], rates)
        result: list[Any] = self.known[axis, side]
        return result

    def _reference(
        self, rule: Any, term: Any, table: Any, orders: tuple[int, int], code: list[Any]
    ) -> Any:
        """Return the symbol of a table by reference coordinates, which is added to the code.

        Args:
            rule: Points.
            term: A derivative of the same order.
            table: FFCx's table of it.
            orders: How often it is differentiated by each coordinate.
            code: To which the table is added where it is new.
        """
        element = term.terminal.ufl_function_space().ufl_element()
        key = (rule.id(), element, orders)
        if key not in self.known:
            kind, place = self.ir.expression.integral_type, self.ir.expression.entity_type
            points = [rule.points]
            if kind == "interior_facet":  # the other cell may go along the facet the other way
                points.append(permute_quadrature_interval(rule.points, 1))
            cell = ufl.domain.extract_unique_domain(term.terminal).ufl_cell()
            fixed = (element, term.averaged, place, orders, term.flat_component, 0)
            values = [get_ffcx_table_values(p, cell, kind, *fixed)["array"] for p in points]
            name = f"{table.name}_by_{orders[0]}{orders[1]}"
            self.known[key] = lnodes.Symbol(name, lnodes.DataType.REAL)
            code.append(lnodes.ArrayDecl(self.known[key], values=np.vstack(values), const=True))
        return self.known[key]


#: How names end on each side of a facet.
SIDES = {None: "_along", "+": "_along_plus", "-": "_along_minus"}


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute for a while."""
    usual = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, usual)


def _symbols_of(numbering: Any, expression: Any) -> Any:
    """Return the symbols of an expression; FFCx looks through all expressions one by one."""
    return numbering.V_symbols[numbering.G.e2i[expression]]


def _label_data(label: Any, numbering: dict[Any, int]) -> tuple[str, int]:
    """Return what stands for a variable's label in a signature.

    UFL takes how many labels there were before, so that no two expressions had the same kernel.
    """
    return "Label", numbering.setdefault(label, len(numbering))


def _no_files() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of the user's and of the current folder's file: none."""
    return {}, {}


@contextmanager
def own_kernels() -> Iterator[None]:
    """Let FFCx write kernels this way, one form at a time.

    Files of options (``ffcx_options.json``, ``dolfinx_jit_options.json``) are not read: those in
    the current folder may have come with a case, and any of them may be damaged.
    """
    writer, collects = Writer(), gc.isenabled()
    lower = partial(writer.lower, _ANALYSIS.apply_algebra_lowering)
    gradient = partial(writer.gradient, apply_derivatives.grad_to_reference_grad)
    with (
        replaced(_ANALYSIS, "apply_algebra_lowering", lower),
        replaced(apply_derivatives, "grad_to_reference_grad", gradient),
        replaced(FFCX_KERNELS, "IntegralGenerator", writer.generator),
        replaced(ValueNumberer, "get_node_symbols", _symbols_of),
        replaced(Label, "_ufl_signature_data_", _label_data),
        replaced(ffcx.options, "_load_options", _no_files),
        replaced(dolfinx.jit, "_load_options", _no_files),
    ):
        # UFL makes many small objects that stay: looking for garbage among them takes a third.
        gc.disable()
        try:
            yield
        finally:
            if collects:
                gc.enable()
