"""State declared by name is saved under those names, comes back to the bit, and is refused where it does not fit."""

from typing import NamedTuple

import numpy as np
import pytest
import torch

from hrl_escape.agents.state import Columns, Kept, Stateful
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.errors import CheckpointError


class Counter(Stateful):
    STATE = ("_steps", "rate")

    def __init__(self, steps=0, rate=0.5):
        self._steps, self.rate = steps, rate


class Memory(NamedTuple):
    seen: np.ndarray
    count: int


class Learner(Stateful):
    STATE = ("counter", "named", "_rng", "_draws", "weights", "values", "_memory", "places", "name", "chosen",
             "is_done", Kept("table", "cells", lambda table: [list(item) for item in table.items()], dict),
             Kept("counter.rate", "pace"), Kept("extra", is_left_out=True), "helper")

    def __init__(self, seed):
        self.counter, self.named = Counter(seed), {"low": Counter(1 + seed), "high": Counter(2 + seed)}
        self._rng, self._draws = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
        self.weights, self.values = torch.full((2, 3), float(seed)), np.full(4, seed, np.float32)
        self._memory = Memory(np.full(2, seed, np.int16), seed)
        self.places, self.name, self.chosen, self.is_done = [seed, [seed]], str(seed), (seed, seed), bool(seed)
        self.table, self.extra, self.helper = {seed: 1.5}, None, None
        self.loads = 0

    def after_load(self):
        self.loads += 1


class Tables(Stateful):
    STATE = (Columns({"values": "_values", "counts": "_counts"}, are_literal=True), "parts", "weights")

    def __init__(self, start):
        self._values, self._counts = {("a", 1): 0.5 + start, None: 2.0}, {("a", 1): 3, None: 4 + start}
        self.parts = [Counter(start), Counter(1 + start)]
        self.weights = {"low": torch.full((2,), float(start))}


class Further(Learner):
    STATE = ("last",)
    last: int | None = None


def through_a_file(state, tmp_path):
    save_checkpoint(tmp_path / "state.npz", state)
    return load_checkpoint(tmp_path / "state.npz")


def test_keys_are_names_without_underscores_those_of_the_base_first():
    assert list(Further(0).state_dict()) == ["counter", "named", "rng", "draws", "weights", "values", "memory",
                                             "places", "name", "chosen", "is_done", "cells", "pace", "helper", "last"]
    assert Counter(3).state_dict() == {"steps": 3, "rate": 0.5}


def test_tables_lists_of_parts_and_tensors_by_name_come_back_the_last_two_in_place(tmp_path):
    one, other = Tables(1), Tables(2)
    weights, parts = other.weights["low"], list(other.parts)
    state = through_a_file(one.state_dict(), tmp_path)
    assert state["keys"] == ["('a', 1)", "None"] and state["counts"].tolist() == [3, 5]
    other.load_state_dict(state)
    assert (other._values, other._counts) == (one._values, one._counts)
    assert all(type(each) is int for each in other._counts.values())
    assert other.parts == parts and [part._steps for part in parts] == [1, 2]
    assert other.weights["low"] is weights and weights.tolist() == [1.0, 1.0]
    with pytest.raises(CheckpointError, match="no 'keys' of Tables"):
        other.load_state_dict({})


def test_every_kind_of_value_comes_back_through_a_file_with_its_type(tmp_path):
    made, fresh = Further(7), Further(1)
    made.last, made.counter.rate = 4, 0.25
    weights, part = fresh.weights, fresh.named["low"]
    fresh.load_state_dict(through_a_file(made.state_dict(), tmp_path))
    assert fresh.counter.state_dict() == {"steps": 7, "rate": 0.25}
    assert fresh.named["low"] is part and part._steps == 8 and fresh.named["high"]._steps == 9
    assert fresh.weights is weights and torch.equal(weights, made.weights)
    assert fresh.values.dtype == np.float32 and fresh.values.tolist() == [7.0] * 4
    assert isinstance(fresh._memory, Memory) and fresh._memory.seen.dtype == np.int16 and fresh._memory.count == 7
    assert (fresh.places, fresh.name, fresh.chosen, fresh.is_done) == ([7, [7]], "7", (7, 7), True)
    assert fresh.table == {7: 1.5} and fresh.last == 4 and fresh.loads == 1
    assert fresh._rng.random() == made._rng.random()
    assert torch.rand((), generator=fresh._draws) == torch.rand((), generator=made._draws)


def test_what_was_loaded_is_a_copy_of_the_tree():
    state, fresh = Learner(7).state_dict(), Learner(1)
    fresh.load_state_dict(state)
    fresh.values[0], fresh.places[1][0] = 5, 5
    assert state["values"][0] == 7 and state["places"] == [7, [7]]


def test_a_value_that_is_none_is_kept_as_none_or_left_out():
    plain, other = Learner(0), Learner(0)
    assert plain.state_dict()["helper"] is None and "extra" not in plain.state_dict()
    other.extra, other.helper = 3, Counter(5)
    assert other.state_dict()["extra"] == 3 and other.state_dict()["helper"] == {"steps": 5, "rate": 0.5}
    plain.load_state_dict(other.state_dict())
    assert plain.extra == 3 and plain.helper is None  # no part here that the saved one belongs to
    helper = other.helper
    other.load_state_dict(Learner(1).state_dict())
    assert other.helper is helper and helper._steps == 5


def test_a_tree_that_does_not_fit_is_refused_by_name():
    state, fresh = Learner(7).state_dict(), Learner(1)
    with pytest.raises(CheckpointError, match="has weights of Learner of shape \\(3,\\); here it is \\(2, 3\\)"):
        fresh.load_state_dict(state | {"weights": np.zeros(3, np.float32)})
    del state["values"]
    with pytest.raises(CheckpointError, match="has no 'values' of Learner"):
        fresh.load_state_dict(state)


def test_a_class_that_declares_nothing_and_a_value_without_a_form_are_errors_with_the_fix():
    class Forgetful(Stateful):
        pass

    class Odd(Stateful):
        STATE = ("things",)
        things = frozenset((1,))

    with pytest.raises(TypeError, match="Forgetful declares no state: give it STATE"):
        Forgetful().state_dict()
    with pytest.raises(TypeError, match="Odd.things is a frozenset.*pack="):
        Odd().state_dict()
