"""What has failed is tried again the more rarely the more often it failed."""

from __future__ import annotations

from wovenfab.solver.back_off import LONGEST_WAIT, BackOff


def test_after_each_failure_twice_as_many_occasions_are_passed_over() -> None:
    back_off, waits = BackOff("this"), []
    for _ in range(8):
        waited = 0
        while back_off.waits:
            back_off.skip()
            waited += 1
        back_off.fail()
        waits.append(waited)
    assert waits == [0, 1, 2, 4, 8, 16, LONGEST_WAIT, LONGEST_WAIT]


def test_a_success_ends_the_waiting() -> None:
    back_off = BackOff("this")
    for _ in range(3):
        back_off.fail()
    back_off.reset()
    assert not back_off.waits
    back_off.fail()
    back_off.skip()
    assert not back_off.waits
