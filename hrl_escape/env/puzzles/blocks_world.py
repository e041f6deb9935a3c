"""Blocks World with a gripper: take towers apart and build them, block by block, until the goal holds.

Each block has its own place, a panel. The tower whose lowest block it is, if that block is on the table, is at that
place. `grip` while touching a place takes the top block of its tower. `release` puts the held block on the tower; an
empty place accepts only its own block. This is exactly the domain with four operators (pick-up, put-down, stack,
unstack), because every block has one place on the table. The state is a word of four bits per block: the block below
it, itself if on the table, or `IN_HAND`. Problems are drawn at random, or read from PDDL.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from hrl_escape.env.puzzles.base import Contacts, Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Depicted, Graphed
from hrl_escape.env.puzzles.symbolic import Modelled, Operator, SymbolicModel
from hrl_escape.errors import ConfigError
from hrl_escape.names import join_words
from hrl_escape.search import find_cheapest_steps
from hrl_escape.settings import Range

IN_HAND = 15
"""Value for the hand as the support of a held block."""
MOST_BLOCKS = 12

Towers: TypeAlias = tuple[int, ...]
"""Number of the block below each block; blocks are numbered from 0."""


class TowersGoal(NamedTuple):
    """Requirements on towers."""

    on: tuple[tuple[int, int], ...]  # pairs of a block and its support; a block on the table supports itself
    clear: tuple[int, ...] = ()  # blocks that must have nothing on them and must not be held
    is_free: bool = False  # whether the hand must be empty


class Problem(NamedTuple):
    """A problem of Blocks World: names of the blocks, the initial towers, and the goal."""

    names: tuple[str, ...]
    start: Towers
    goal: TowersGoal


def list_tower(towers: Towers, base: int) -> list[int]:
    """Return the blocks of the tower above `base`, from the table up; empty if `base` is not on the table."""
    above = {below: block for block, below in enumerate(towers) if below != block}
    tower = [base] if towers[base] == base else []
    while tower and tower[-1] in above:
        tower.append(above[tower[-1]])
    return tower


def list_moves(towers: Towers) -> Iterator[tuple[int, int, Towers]]:
    """List the moves of a gripper, as (1 to grip or -1 to release, lowest block of the tower, towers after it)."""
    held = towers.index(IN_HAND) if IN_HAND in towers else None
    for base in range(len(towers)):
        tower = list_tower(towers, base)
        if held is None and tower:
            yield 1, base, (*towers[:tower[-1]], IN_HAND, *towers[tower[-1] + 1:])
        elif held is not None and (tower or base == held):
            yield -1, base, (*towers[:held], tower[-1] if tower else base, *towers[held + 1:])


def meets_goal(towers: Towers, goal: TowersGoal) -> bool:
    """Return whether towers meet the goal."""
    return (all(towers[block] == below for block, below in goal.on)
            and not any(towers[block] == IN_HAND for block in goal.clear)
            and not any(below in goal.clear and below != block for block, below in enumerate(towers))
            and not (goal.is_free and IN_HAND in towers))


def _count_least(towers: Towers, goal: TowersGoal) -> int:
    """Lower bound on the moves to the goal: each block that must move is gripped and released once."""
    wanted, known = dict(goal.on), dict[int, bool]()

    def must_move(block: int) -> bool:
        if block not in known:
            below = towers[block]
            known[block] = wanted.get(block, below) != below or (below not in (block, IN_HAND) and must_move(below))
        return known[block]

    if IN_HAND in towers:
        return 2 * sum(map(must_move, range(len(towers)))) - must_move(towers.index(IN_HAND))
    return 2 * sum(map(must_move, range(len(towers))))


def find_fewest_moves(towers: Towers, goal: TowersGoal) -> tuple[tuple[int, int], ...] | None:
    """Return the fewest moves to a goal, as (1 to grip or -1 to release, lowest block), or None if there are none.

    Uses A* with the number of blocks that must move. After 10,000 states the search continues greedily.
    """
    return find_cheapest_steps(
        towers, lambda state: meets_goal(state, goal),
        lambda state: (((grip, base), 1, then) for grip, base, then in list_moves(state)),
        lambda state: _count_least(state, goal))


# --- problems ------------------------------------------------------------------------------


@lru_cache(maxsize=1024)
def _count_towers(loose: int, placed: int) -> int:
    """Number of ways to place `loose` towers, given the number that are already on the table."""
    if loose == 0:
        return 1
    return _count_towers(loose - 1, placed) * (loose - 1 + placed) + _count_towers(loose - 1, placed + 1)


def sample_towers(count: int, rng: np.random.Generator) -> Towers:
    """Sample towers uniformly (Slaney and Thiebaux 2001).

    Towers are placed one after another, on the table or on another tower.
    """
    towers = list(range(count))
    loose, placed = [(block, block) for block in range(count)], list[int]()  # lowest and top block, top block
    while loose:
        base, top = loose.pop()
        everywhere = _count_towers(len(loose) + 1, len(placed))
        number = int(rng.integers(everywhere)) - _count_towers(len(loose), len(placed) + 1)
        if number < 0:
            placed.append(top)
            continue
        number //= _count_towers(len(loose), len(placed))
        if number < len(loose):
            towers[base], loose[number] = loose[number][1], (loose[number][0], top)
        else:
            towers[base], placed[number - len(loose)] = placed[number - len(loose)], top
    return tuple(towers)


def read_towers(text: str) -> Problem:
    """Read a PDDL problem of the domain with four operators: pick-up, put-down, stack and unstack.

    Raises:
        ConfigError: the text is not PDDL, or not a problem of that domain.
    """
    parts = {str(part[0]): part[1:] for part in _read_list(text)[1:] if isinstance(part, list) and part}
    if not {":objects", ":init", ":goal"} <= parts.keys():
        raise ConfigError("puzzle.problem", text, "a PDDL problem with :objects, :init and :goal")
    names = _list_blocks(parts[":objects"])
    if not 1 <= len(names) <= MOST_BLOCKS or len(set(names)) < len(names):
        raise ConfigError("puzzle.problem", names, f"1 to {MOST_BLOCKS} blocks, each named once")
    init = [_read_fact(fact, names) for fact in parts[":init"]]
    (wanted,) = parts[":goal"] if len(parts[":goal"]) == 1 else ([],)
    goals = wanted[1:] if wanted and wanted[0] == "and" else [wanted]
    goal = [_read_fact(fact, names) for fact in goals]
    below = {fact[1]: fact[-1] for fact in init if fact[0] in ("on", "ontable")}
    if sorted(below) != list(range(len(names))) or ("handempty",) not in init:
        raise ConfigError("puzzle.problem", text, "an :init with handempty, and on or ontable once for each block")
    return Problem(names, tuple(below[block] for block in range(len(names))), TowersGoal(
        tuple((fact[1], fact[-1]) for fact in goal if fact[0] in ("on", "ontable")),
        tuple(fact[1] for fact in goal if fact[0] == "clear"), ("handempty",) in goal))


def _read_list(text: str) -> list:
    """Nested lists of the words of an expression in parentheses, in lower case, without comments."""
    words = re.findall(r"[()]|[^\s()]+", re.sub(r";[^\n]*", "", text.lower()))
    open_lists: list[list] = [[]]
    for word in words:
        if word == "(":
            open_lists.append([])
        elif word != ")":
            open_lists[-1].append(word)
        elif len(open_lists) > 1:
            done = open_lists.pop()
            open_lists[-1].append(done)
    if len(open_lists) != 1 or len(open_lists[0]) != 1 or not isinstance(open_lists[0][0], list):
        raise ConfigError("puzzle.problem", text, "one PDDL expression, all parentheses closed")
    return open_lists[0][0]


def _list_blocks(objects: list) -> tuple[str, ...]:
    """Names of the objects that are blocks. Some versions of the domain have a robot as well."""
    blocks, untyped, words = list[str](), list[str](), iter(map(str, objects))
    for word in words:
        if word != "-":
            untyped.append(word)
        else:
            blocks += untyped if next(words, "") != "robot" else []
            untyped = []
    return (*blocks, *untyped)


def _read_fact(fact: object, names: tuple[str, ...]) -> tuple:
    """A fact with numbers for blocks. A block that is on the table is on itself."""
    counts = {"on": 2, "ontable": 1, "clear": 1, "handempty": 0}
    if isinstance(fact, list) and fact and fact[0] == "handempty":
        return ("handempty",)
    if not isinstance(fact, list) or not fact or counts.get(fact[0]) != len(fact) - 1 or not set(fact[1:]) <= {*names}:
        raise ConfigError("puzzle.problem", fact, f"a fact of {', '.join(counts)} and the blocks {', '.join(names)}")
    return (fact[0], *(names.index(name) for name in fact[1:]))


Block = Annotated[int, Range(0, MOST_BLOCKS - 1)]
_LETTERS = "abcdefghijkl"


@dataclasses.dataclass(frozen=True)
class BlocksWorldConfig(PuzzleConfig):
    """Configuration of Blocks World. The instance seed draws the initial towers and the goal's, uniformly."""

    kind = "blocks-world"
    _takes_ranges = True
    count: Annotated[int, Range(2, MOST_BLOCKS)] = 4
    """Number of blocks; ignored if `problem` is given. More blocks need longer plans."""
    problem: str | None = None
    """A PDDL problem of the domain with four operators, instead of random towers."""
    places: Panels = Panels(gap=1.0)
    """Sizes and places of the panels, one per block."""

    def count_targets(self) -> int:
        """Return the number of blocks."""
        return self.count if self.problem is None else len(read_towers(self.problem).names)

    def make_puzzle(self, rng: np.random.Generator) -> BlocksWorldPuzzle:
        """Read the problem, or sample one that is not solved yet."""
        if self.problem is not None:
            names, start, goal = read_towers(self.problem)
            return BlocksWorldPuzzle(names, start, goal.on, goal.clear, goal.is_free)
        start = wanted = sample_towers(self.count, rng)
        while wanted == start:
            wanted = sample_towers(self.count, rng)
        return BlocksWorldPuzzle(tuple(_LETTERS[: self.count]), start, tuple(enumerate(wanted)))


@dataclasses.dataclass(frozen=True)
class BlocksWorldPuzzle(Graphed, Depicted, Modelled, Puzzle):
    """A concrete problem. The name of block `a`'s place is `place-a`."""

    kind = "blocks-world"
    about = ("Blocks stand in towers on places. Grip takes the top block of a tower into the hand, release puts it on "
             "top of another. The exit opens once the blocks stand as wanted.")
    names: tuple[str, ...] = ("a", "b")
    """Names of the blocks."""
    start: tuple[Block, ...] = (0, 1)
    """Number of the initial support of each block; its own number for the table."""
    goal: tuple[tuple[Block, Block], ...] = ((0, 1),)
    """Pairs of a block and its required support."""
    clear: tuple[Block, ...] = ()
    """Blocks that must be clear at the end."""
    free_hand: bool = False
    """True if the hand must be empty at the end."""

    def check(self) -> None:
        """Check that the towers are valid, and that the goal is reachable."""
        count = len(self.names)
        if not 1 <= count <= MOST_BLOCKS or len(set(self.names)) < count:
            raise ConfigError("puzzle.names", self.names, f"1 to {MOST_BLOCKS} different names")
        self._check_towers("puzzle.start", self.start)
        wanted = dict(self.goal)
        if len(wanted) < len(self.goal) or not {*wanted, *wanted.values(), *self.clear} <= set(range(count)):
            raise ConfigError("puzzle.goal", self.goal, f"at most one support for each of {count} blocks")
        self._check_towers("puzzle.goal", tuple(wanted.get(block, block) for block in range(count)))
        if any(below in self.clear and below != block for block, below in self.goal):
            raise ConfigError("puzzle.clear", self.clear, "blocks on which the goal puts nothing")

    def _check_towers(self, field: str, towers: Towers) -> None:
        count = len(towers)
        if count != len(self.names) or sum(len(list_tower(towers, base)) for base in range(count)) < count:
            raise ConfigError(field, towers, f"towers of {len(self.names)} blocks, one on another from the table up")

    @cached_property
    def wanted(self) -> TowersGoal:
        """Requirements on the towers."""
        return TowersGoal(self.goal, self.clear, self.free_hand)

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of the panels, `place-<block>`."""
        return tuple(f"place-{name}" for name in self.names)

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Places with a tower at the end, as far as the goal determines them."""
        return tuple(block for block, below in self.goal if block == below)

    # --- states ------------------------------------------------------------------------

    def encode(self, towers: Towers) -> int:
        """Return the state of given towers: four bits per block."""
        return sum(below << 4 * block for block, below in enumerate(towers))

    def decode(self, state: int) -> Towers:
        """Return the towers that a state encodes."""
        return tuple(state >> 4 * block & 15 for block in range(len(self.names)))

    def make_state(self) -> int:
        """Return the state of the initial towers."""
        return self.encode(self.start)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state: valid towers, and at most one block in the hand."""
        if type(state) is not int or not 0 <= state < 1 << 4 * len(self.names):
            return False
        towers = self.decode(state)
        standing = tuple(block if below == IN_HAND else below for block, below in enumerate(towers))
        try:
            self._check_towers("puzzle.state", standing)
        except ConfigError:
            return False
        held = [block for block, below in enumerate(towers) if below == IN_HAND]
        return not held or len(held) == 1 and towers.count(held[0]) == 0

    def update(self, state: int, contacts: Contacts) -> int:
        """Take the top block of the touched tower, or put the held block there. Of several places, the first counts."""
        if not contacts.grip or not contacts.touching:
            return state
        towers = self.decode(state)
        wanted = contacts.grip, contacts.touching[0]
        return next((self.encode(then) for grip, base, then in list_moves(towers) if (grip, base) == wanted), state)

    def is_solved(self, state: int) -> bool:
        """Return whether the goal holds."""
        return meets_goal(self.decode(state), self.wanted)

    def observe(self, state: int) -> tuple[float, ...]:
        """Return n + 1 numbers per block: 1 for its support (itself: the table), the last for the hand.

        The same for the support that the goal requires follows. These are all 0 without a requirement; the last is 1 if
        the block must be clear.
        """
        count, numbers, wanted = len(self.names), list[float](), dict(self.goal)
        for below in self.decode(state):
            numbers += [float(below == other) for other in (*range(count), IN_HAND)]
        for block in range(count):
            numbers += [*(float(wanted.get(block) == other) for other in range(count)), float(block in self.clear)]
        return tuple(numbers)

    def describe(self, state: int) -> tuple[str, ...]:
        """Return sentences about the block in the hand and the goal."""
        held = [self.names[block] for block, below in enumerate(self.decode(state)) if below == IN_HAND]
        wanted = [f"{self.names[block]} on {'the table' if below == block else self.names[below]}"
                  for block, below in self.goal] + [f"nothing on {self.names[block]}" for block in self.clear]
        return f"In the hand: {held[0] if held else 'nothing'}.", f"Wanted: {join_words(wanted)}."

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each place has a tower."""
        return tuple(below == block for block, below in enumerate(self.decode(state)))

    def get_sign(self, state: int, target: int) -> str:
        """Return the names of the blocks in the tower on a place, from the table up."""
        return " ".join(self.names[block] for block in list_tower(self.decode(state), target))

    # --- for planners ------------------------------------------------------------------

    def get_facts(self, state: int) -> frozenset[str]:
        """Return PDDL's facts (`on(a,b)`, `ontable(a)`, `clear(a)`, `holding(a)`, `handempty`) and `at(a,place)`."""
        towers, names, facts = self.decode(state), self.names, set[str]()
        for block, below in enumerate(towers):
            name = names[block]
            if below == IN_HAND:
                facts.add(f"holding({name})")
                continue
            facts.add(f"ontable({name})" if below == block else f"on({name},{names[below]})")
            if all(other == block or under != block for other, under in enumerate(towers)):
                facts.add(f"clear({name})")
            while towers[below] != below:
                below = towers[below]
            facts.add(f"at({name},{names[below]})")
        return frozenset(facts if IN_HAND in towers else facts | {"handempty"})

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: the four operators of PDDL; those on towers once per place where they apply."""
        return self._model

    @cached_property
    def _model(self) -> SymbolicModel:
        hand, names = frozenset({"handempty"}), self.names
        operators = list[Operator]()
        for name in names:
            held, lies = frozenset({f"holding({name})"}), {f"clear({name})", f"ontable({name})"}
            lies_here = hand | lies | {f"at({name},{name})"}
            operators.append(Operator(f"pick-up-{name}", f"place-{name}", "grip", hand | lies, add=held,
                                      delete=lies_here))
            operators.append(Operator(f"put-down-{name}", f"place-{name}", "release", held, add=lies_here,
                                      delete=held))
        for (name, other), base in itertools.product(itertools.permutations(names, 2), names):
            if name == base:
                continue
            held, under = frozenset({f"holding({name})"}), frozenset({f"clear({other})"})
            stands = hand | {f"clear({name})", f"on({name},{other})"}
            here, place = frozenset({f"at({name},{base})"}), frozenset({f"at({other},{base})"})
            operators.append(Operator(f"unstack-{name}-from-{other}-at-{base}", f"place-{base}", "grip",
                                      stands | place, add=held | under, delete=stands | here))
            operators.append(Operator(f"stack-{name}-on-{other}-at-{base}", f"place-{base}", "release",
                                      held | under | place, add=stands | here, delete=held | under))
        pairs = [f"{word}({name},{other})" for word in ("on", "at") for name in names for other in names
                 if word == "at" or name != other]
        singles = [f"{word}({name})" for word in ("ontable", "clear", "holding") for name in names]
        goal = {f"ontable({names[block]})" if block == below else f"on({names[block]},{names[below]})"
                for block, below in self.goal} | {f"clear({names[block]})" for block in self.clear}
        return SymbolicModel((*pairs, *singles, "handempty"), tuple(operators),
                             frozenset(goal) | (hand if self.free_hand else frozenset()))

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...] | None:
        """Return the fewest operators to the goal, by search over towers."""
        moves = find_fewest_moves(self.decode(state), self.wanted)
        if moves is None:
            return None
        found = list[Operator]()
        for grip, base in moves:
            facts, wanted = self.get_facts(state), (f"place-{self.names[base]}", "grip" if grip == 1 else "release")
            found.append(next(op for op in self._model.operators
                              if (op.target, op.action) == wanted and op.is_applicable(facts)))
            state = self.update(state, self.make_contacts(found[-1]))
        return tuple(found)


register_puzzle(BlocksWorldConfig, BlocksWorldPuzzle)
