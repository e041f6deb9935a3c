"""The registry of puzzles, and a stranger's puzzle that arrives through an entry point."""

import json
import os
import sys
import textwrap

import pytest

from hrl_escape.env.puzzles.base import Puzzle, PuzzleConfig, get_puzzle_kind, list_puzzles, register_puzzle
from hrl_escape.env.puzzles.bit_flip import BitFlipConfig, BitFlipPuzzle
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ButtonsPuzzle
from hrl_escape.errors import ConfigError, UnknownNameError
from tests.forks import run_fork


def test_the_puzzles_that_ship_are_listed():
    assert {"bit-flip", "buttons", "push-block"} <= set(list_puzzles())


def test_an_unknown_puzzle_names_the_closest_one():
    with pytest.raises(UnknownNameError, match="did you mean 'buttons'"):
        get_puzzle_kind("butons")
    with pytest.raises(UnknownNameError, match="puzzle None"):
        get_puzzle_kind(None)


def test_registering_again_is_harmless_and_a_taken_name_is_refused():
    register_puzzle(ButtonsConfig, ButtonsPuzzle)

    class Other(ButtonsConfig):
        pass

    with pytest.raises(ConfigError, match="'buttons'.*no other puzzle"):
        register_puzzle(Other, ButtonsPuzzle)
    with pytest.raises(ConfigError, match="same name as its config's"):
        register_puzzle(BitFlipConfig, ButtonsPuzzle)
    assert get_puzzle_kind("bit-flip").puzzle_type is BitFlipPuzzle


def test_a_puzzle_whose_targets_have_no_names_is_refused_when_it_is_registered():
    class Nameless(Puzzle):
        kind = "nameless"

    class NamelessConfig(PuzzleConfig):
        kind = "nameless"

    with pytest.raises(ConfigError, match=r"Nameless\.fixed_names.*target_names"):
        register_puzzle(NamelessConfig, Nameless)
    assert "nameless" not in list_puzzles()


STRANGER = '''
"""A combination lock: targets must be pressed in one secret order; a wrong press starts again."""
import dataclasses
from typing import Annotated

from hrl_escape.env.puzzles.base import Panels, Puzzle, PuzzleConfig
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class LockConfig(PuzzleConfig):
    kind = "combination-lock"
    digits: Annotated[int, Range(1, 10)] = 3
    "Length of the code."

    @property
    def panels(self):
        return Panels(width=0.8)

    def make_puzzle(self, rng):
        return Lock(tuple(int(i) for i in rng.permutation(self.digits)))


@dataclasses.dataclass(frozen=True)
class Lock(Modelled, Puzzle):
    kind = "combination-lock"
    code: tuple[Annotated[int, Range(0, 9)], ...] = (0,)
    "Order in which the targets must be pressed."

    @property
    def target_names(self):
        return tuple(f"key-{i + 1}" for i in range(len(self.code)))

    @property
    def bounds(self):
        return ((0.0, float(len(self.code))),)

    def make_state(self):
        return 0

    def update(self, state, contacts):
        for key in contacts.pressed:
            state = state + 1 if state < len(self.code) and self.code[state] == key else 0
        return state

    def is_solved(self, state):
        return state == len(self.code)

    def observe(self, state):
        return (float(state),)

    def get_lit(self, state):
        return tuple(i in self.code[:state] for i in range(len(self.code)))

    def get_facts(self, state):
        return frozenset({f"at({state})"})

    def make_symbolic_model(self):
        operators = [Operator(f"press-{i}", self.target_names[key], "press", frozenset({f"at({i})"}), frozenset(),
                              frozenset({f"at({i + 1})"}), frozenset({f"at({i})"}))
                     for i, key in enumerate(self.code)]
        places = tuple(f"at({i})" for i in range(len(self.code) + 1))
        return SymbolicModel(places, tuple(operators), frozenset({places[-1]}))


PUZZLE = (LockConfig, Lock)
'''

PROGRAM = """
import json, sys
import numpy as np
from hrl_escape.checks import check_puzzle
from hrl_escape.env.bullet.engine import BulletRoom
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.puzzles.base import list_puzzles

config = RoomConfig.from_dict({"puzzle": {"kind": "combination-lock", "digits": 4}})
assert config.puzzle.digits == 4
check_puzzle(config.puzzle.make_puzzle(np.random.default_rng(0)))
instance = generate(config, 0)
assert RoomInstance.from_dict(json.loads(json.dumps(instance.to_dict()))) == instance
room = BulletRoom(instance)
for action in np.random.default_rng(0).integers(6, size=50).tolist():
    room.step(action)
room.close()
print(json.dumps([list_puzzles(), instance.puzzle.target_names, instance.id]))
"""


def install(folder, entry_point):
    """Lay out a package as an installer would: the module, and a dist-info that states its entry point."""
    (folder / "lock_puzzle.py").write_text(STRANGER)
    information = folder / "lock_puzzle-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: lock-puzzle\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[hrl_escape.puzzles]\ncombination-lock = {entry_point}\n")


def run_with(folder, program):
    path = os.pathsep.join([str(folder), *sys.path])
    return run_fork(program, environment=os.environ | {"PYTHONPATH": path})


def test_a_strangers_puzzle_is_found_played_and_saved_like_ours(tmp_path):
    install(tmp_path, "lock_puzzle:PUZZLE")
    done = run_with(tmp_path, PROGRAM)
    assert done.returncode == 0, done.stderr
    names, targets, _ = json.loads(done.stdout)
    assert "combination-lock" in names and {"bit-flip", "buttons", "push-block"} < set(names)
    assert targets == ["key-1", "key-2", "key-3", "key-4"]


def test_without_its_package_a_strangers_puzzle_is_unknown(tmp_path):
    done = run_with(tmp_path, PROGRAM)
    assert "unknown puzzle 'combination-lock'" in done.stderr


@pytest.mark.parametrize("entry_point", ["lock_puzzle:NOTHING", "no_such_module:PUZZLE", "lock_puzzle:Lock"])
def test_a_broken_entry_point_names_the_package_and_leaves_ours_usable(tmp_path, entry_point):
    install(tmp_path, entry_point)
    program = textwrap.dedent("""
        from hrl_escape.env.puzzles.base import get_puzzle_kind
        print(get_puzzle_kind("buttons").config_type.__name__)
        get_puzzle_kind("combination-lock")
    """)
    done = run_with(tmp_path, program)
    assert done.stdout == "ButtonsConfig\n"
    assert "PluginError" in done.stderr and "lock-puzzle" in done.stderr
