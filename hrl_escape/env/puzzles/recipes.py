"""A recipe game after Crafter (Hafner 2022), on panels: collect five materials, place two things, make three tools.

A press of a material's panel collects one unit, up to `MOST_KEPT`, once the required tool exists. A press of a thing's
panel places or makes it, once, in exchange for the materials of its recipe, once the required things exist. Amounts and
tools are taken from Crafter (`data.yaml`, table 2 wood, furnace 4 stone). There is no map and no survival, and
materials never run out. The exit opens once the goal exists. The state is a word: `COUNT_BITS` per material, then one
bit per thing.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, NamedTuple, get_args

from hrl_escape.env.puzzles.base import Contacts, Panels, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.mixins import Depicted, Graphed
from hrl_escape.env.puzzles.symbolic import Effect, Modelled, Operator, SymbolicModel

Craft = Literal["wood", "stone", "coal", "iron", "diamond", "table", "furnace", "wood-pickaxe", "stone-pickaxe",
               "iron-pickaxe"]
MOST_KEPT = 9
"""Largest stock of a material."""
COUNT_BITS = 4
MATERIALS = 5
"""Number of materials; they come first in `NAMES`."""
NAMES: tuple[str, ...] = get_args(Craft)
"""Names of materials, then of things."""
SHIFTS = tuple(COUNT_BITS * min(number, MATERIALS) + max(number - MATERIALS, 0) for number in range(len(NAMES) + 1))
"""First bit of each name's count in a state, and last the total number of bits."""


class Recipe(NamedTuple):
    """Requirements of a material or thing."""

    takes: tuple[str, ...] = ()  # things that must exist; they are not used up
    uses: tuple[tuple[str, int], ...] = ()  # materials that are used up, with their amounts


RECIPES: dict[str, Recipe] = {
    "wood": Recipe(),
    "stone": Recipe(("wood-pickaxe",)),
    "coal": Recipe(("wood-pickaxe",)),
    "iron": Recipe(("stone-pickaxe",)),
    "diamond": Recipe(("iron-pickaxe",)),
    "table": Recipe((), (("wood", 2),)),
    "furnace": Recipe(("table",), (("stone", 4),)),
    "wood-pickaxe": Recipe(("table",), (("wood", 1),)),
    "stone-pickaxe": Recipe(("table",), (("wood", 1), ("stone", 1))),
    "iron-pickaxe": Recipe(("table", "furnace"), (("wood", 1), ("coal", 1), ("iron", 1))),
}
"""All recipes by name."""


@dataclasses.dataclass(frozen=True)
class RecipesConfig(PuzzleConfig):
    """Configuration of the recipe game."""

    kind = "recipes"
    _takes_ranges = True
    goal: Craft = "diamond"
    """The material or thing that opens the exit."""
    buttons: Panels = Panels(width=1.0, height=1.0)
    """Sizes and places of the ten panels."""


@dataclasses.dataclass(frozen=True)
class RecipesPuzzle(Graphed, Depicted, Modelled, Puzzle):
    """The recipe game with one goal. Panels have the names of materials and things. The store starts empty."""

    kind = "recipes"
    fixed_names = NAMES
    goal: Craft = "diamond"
    """The material or thing that opens the exit."""

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Dependencies (parent, child): the child requires or uses up the parent."""
        return tuple((NAMES.index(needed), number) for number, name in enumerate(NAMES)
                     for needed in (*RECIPES[name].takes, *(material for material, _ in RECIPES[name].uses)))

    @property
    def goal_targets(self) -> tuple[int, ...]:
        """Index of the material or thing that opens the exit, as a tuple of one."""
        return (NAMES.index(self.goal),)

    def count(self, state: int, name: str) -> int:
        """Return the number of a material in store, or 1 or 0 for a thing."""
        number = NAMES.index(name)
        return state >> SHIFTS[number] & (2**COUNT_BITS - 1 if number < MATERIALS else 1)

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is a state: at most `MOST_KEPT` of each material."""
        in_word = type(state) is int and 0 <= state < 1 << SHIFTS[-1]
        return in_word and all(self.count(state, name) <= MOST_KEPT for name in NAMES[:MATERIALS])

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply presses in index order: collect, place or make."""
        for target in contacts.pressed:
            name = NAMES[target]
            recipe = RECIPES[name]
            most = MOST_KEPT if target < MATERIALS else 1
            if (self.count(state, name) < most and all(self.count(state, thing) for thing in recipe.takes)
                    and all(self.count(state, material) >= number for material, number in recipe.uses)):
                for material, number in recipe.uses:
                    state -= number << SHIFTS[NAMES.index(material)]
                state += 1 << SHIFTS[target]
        return state

    def is_solved(self, state: int) -> bool:
        """Return whether the goal was collected, placed or made."""
        return self.count(state, self.goal) > 0

    def observe(self, state: int) -> tuple[float, ...]:
        """Return the store as fractions of `MOST_KEPT`, then 1 for each thing that exists."""
        return tuple(self.count(state, name) / (MOST_KEPT if number < MATERIALS else 1)
                     for number, name in enumerate(NAMES))

    @property
    def light_numbers(self) -> tuple[int, ...]:
        """Index of each target's number, which is above 0 while the target is lit."""
        return tuple(range(len(NAMES)))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each panel is lit: a material in store, or an existing thing."""
        return tuple(self.count(state, name) > 0 for name in NAMES)

    def get_sign(self, state: int, target: int) -> str:
        """Return the number of a material in store as text; empty for none and for things."""
        count = self.count(state, NAMES[target]) if target < MATERIALS else 0
        return str(count) if count else ""

    # --- for planners ------------------------------------------------------------------

    def list_presses(self, state: int) -> list[str]:
        """List the fewest presses, by name, that reach the goal from a state.

        Each thing on the way is made once. Each material is collected once for each use that the store does not cover.
        A press does only one of these, and fewer presses are therefore not enough.
        """
        order: list[str] = []
        _list_things(self.goal, order)
        if self.count(state, self.goal):
            return []
        order = [name for name in order if name == self.goal or not self.count(state, name)]
        uses = [use for name in order for use in RECIPES[name].uses]
        presses: list[str] = []
        for name in order:
            for material, _ in RECIPES[name].uses:
                if material not in presses:  # append all presses of a material together
                    needed = sum(number for used, number in uses if used == material)
                    presses += [material] * max(needed - self.count(state, material), 0)
            presses.append(name)
        return presses

    def plan(self, state: int, place: int = -1) -> tuple[Operator, ...]:
        """Return the fewest presses in an order that is valid."""
        operators = {operator.target: operator for operator in self.make_symbolic_model().operators}
        return tuple(operators[name] for name in self.list_presses(state))

    def compute_progress(self, state: int) -> float:
        """Return the fraction of the presses of an optimal solution that are no longer needed."""
        return 1.0 - len(self.list_presses(state)) / len(self.list_presses(self.make_state()))

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `has(name,k)` for every k up to the amount of each name."""
        return frozenset(_name_fact(name, k) for name in NAMES for k in range(1, self.count(state, name) + 1))

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per press; conditional effects count materials up and down."""
        operators = []
        for number, name in enumerate(NAMES):
            recipe = RECIPES[name]
            needs = [*((thing, 1) for thing in recipe.takes), *recipe.uses]
            most = MOST_KEPT if number < MATERIALS else 1
            more = [Effect(frozenset({_name_fact(name, k - 1)}), add=frozenset({_name_fact(name, k)}))
                    for k in range(2, most + 1)]
            less = [Effect(frozenset({_name_fact(material, k)}), frozenset({_name_fact(material, k + used)})
                           if k + used <= MOST_KEPT else frozenset(), delete=frozenset({_name_fact(material, k)}))
                    for material, used in recipe.uses for k in range(1, MOST_KEPT + 1)]
            operators.append(Operator(
                f"press-{name}", name, "press", frozenset(_name_fact(*need) for need in needs),
                frozenset({_name_fact(name, most)}), frozenset({_name_fact(name, 1)}), when=(*more, *less)))
        facts = tuple(_name_fact(name, k) for number, name in enumerate(NAMES)
                      for k in range(1, (MOST_KEPT if number < MATERIALS else 1) + 1))
        return SymbolicModel(facts, tuple(operators), frozenset({_name_fact(self.goal, 1)}))


def _name_fact(name: str, count: int) -> str:
    return f"has({name},{count})"


def _list_things(name: str, order: list[str]) -> None:
    """Append what a thing requires and uses, recursively, before the thing itself; materials only as the goal."""
    recipe = RECIPES[name]
    for thing in (*recipe.takes, *(thing for material, _ in recipe.uses for thing in RECIPES[material].takes)):
        if thing not in order:
            _list_things(thing, order)
    order.append(name)


register_puzzle(RecipesConfig, RecipesPuzzle)
