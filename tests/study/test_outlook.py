"""What finer cells would take and bring, on errors that follow a known law."""

from __future__ import annotations

from math import inf

import pytest

from wovenfab.study.errors.meshes import (
    Limits,
    Trial,
    next_cells,
    out_of_reach,
    over_limits,
)


def tried(cells: int, order: float = 3.0, work: float = 1.0) -> Trial:
    """A trial whose unknowns grow like the area, and work like their power 1.2."""
    unknowns = 400 * cells**2
    return Trial(cells, unknowns, work * (cells / 2) ** 2.4, 0.1 * (2 / cells) ** order)


@pytest.mark.parametrize("order", [2.0, 3.0, 4.0])
def test_the_cells_that_are_tried_next_are_enough_but_not_many_more(order: float) -> None:
    made = [tried(8, order), tried(16, order)]
    for cells in range(17, 32):
        wanted = 0.1 * (2 / cells) ** order / 0.8  # is aimed at with room for 20 %
        assert next_cells(made, wanted) in (cells, cells + 1)


def test_cells_are_not_multiplied_at_once() -> None:
    assert next_cells([tried(2)], 1e-9) == 4
    assert next_cells([tried(2)], 0.09) == 3
    assert next_cells([Trial(3, 1000, 1.0, None)], 1e-9) == 4


def test_nothing_is_out_of_reach_by_one_mesh_alone() -> None:
    assert out_of_reach([tried(2)], 1e-12, Limits(0.0, 0.0)) == ("", 0.0)
    assert over_limits(10, [], Limits(0.0, inf)) != ""


@pytest.mark.parametrize("order", [3.0, 4.0])
def test_an_accuracy_that_needs_too_many_unknowns_is_out_of_reach(order: float) -> None:
    made = [tried(4, order), tried(8, order)]
    wanted = 0.1 * (2 / 80) ** order
    need = 400 * 80**2
    assert out_of_reach(made, wanted, Limits(1.01 * need, 1e15)) == ("", 0.0)
    reason, reachable = out_of_reach(made, wanted, Limits(0.99 * need, 1e15))
    assert "2600000 unknowns" in reason
    assert 1 < reachable / wanted < 1.25


def test_an_accuracy_that_takes_too_much_work_is_out_of_reach() -> None:
    made = [tried(4), tried(8)]
    wanted = 0.1 * (2 / 80) ** 3
    takes = made[0].work + made[1].work * (1 + 10**2.4)
    assert out_of_reach(made, wanted, Limits(1e15, 1.01 * takes)) == ("", 0.0)
    reason, reachable = out_of_reach(made, wanted, Limits(1e15, 0.99 * takes))
    assert "trials take" in reason
    assert 1 < reachable / wanted < 1.25


def test_slow_convergence_is_hoped_to_become_better_before_something_is_refused() -> None:
    made = [tried(4, order=1.0), tried(8, order=1.0)]
    enough = 400 * 16**2
    assert out_of_reach(made, 0.11 * made[-1].error, Limits(1.02 * enough, 1e15))[0]
    assert not out_of_reach(made, 0.13 * made[-1].error, Limits(1.02 * enough, 1e15))[0]
