"""Which children of a task may be called: primitives by the mask, tasks that are not over and can do something."""

from __future__ import annotations

import numpy as np

from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import maxq

HIERARCHY = maxq({"root": ["fetch", "put", 2], "fetch": ["walk"], "put": [1], "walk": [0]},
                 {"fetch": lambda seen: seen.observation == 3, "put": lambda seen: seen.observation == 0,
                  "walk": lambda seen: seen.observation == 7})
"""Three primitives; each task is over in a state of its own."""


def list_legal(observation: int, *legal: int) -> list[bool]:
    mask = np.isin(np.arange(3), legal)
    return HIERARCHY.root.legal(Seen(observation, mask), None).tolist()


def test_a_task_that_is_over_is_not_legal_for_it_would_take_no_primitive():
    assert list_legal(5, 0, 1, 2) == [True, True, True]
    assert list_legal(3, 0, 1, 2) == [False, True, True]
    assert list_legal(0, 0, 1, 2) == [True, False, True]


def test_a_task_whose_only_child_is_over_is_not_legal():
    assert list_legal(7, 0, 1, 2) == [False, True, True]


def test_a_task_is_legal_where_one_of_its_primitives_is():
    assert list_legal(5, 1) == [False, True, False]
    assert list_legal(5, 0, 2) == [True, False, True]
