"""Cycles in which a frozen policy is caught."""

from __future__ import annotations

import pytest

from benchmarks.frozen_policies import find_cycle


@pytest.mark.parametrize(("choices", "length"), [
    ([3, 1, 2, 2, 2, 2], 1),
    ([5] * 40, 1),
    ([9, 0, 4, 10, 4, 10, 4, 10, 4, 10], 2),
    ([1, 1, 2] * 4, 3),
    ([1, 2, 2, 2], 0),
    ([2, 2, 2, 2, 1], 0),
    ([], 0),
    (list(range(13)) * 5, 0),
])
def test_a_cycle_is_what_comes_four_times_in_a_row_at_the_end(choices: list[int], length: int):
    assert find_cycle(choices) == length
