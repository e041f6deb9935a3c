"""Potions with hidden effects, after Alchemy (Wang et al. 2021): the effects of potions change with every episode.

A stone has features, each on or off. Each potion, a panel, turns one feature on or off. Which feature and which
direction is hidden, constant in an episode, and redrawn for the next. A stone with all features on ends the trial, and
the next stone has all features off. The exit opens after the last trial. Agents that remember the effects of potions
therefore improve over the trials of an episode. The state is a word: the stone, the finished trials, and the number of
the hidden rule.
"""

from __future__ import annotations

import dataclasses
import itertools
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

from hrl_escape.env.puzzles.base import Contacts, Puzzle, PuzzleConfig, register_puzzle
from hrl_escape.env.puzzles.places import Panels
from hrl_escape.env.puzzles.symbolic import Effect, Modelled, Operator, SymbolicModel
from hrl_escape.settings import Range

TRIAL_SHIFT, RULE_SHIFT = 3, 8
"""First bits of the number of trials and of the number of the rule in a state."""

Features = Annotated[int, Range(1, 3)]
Trials = Annotated[int, Range(1, 31)]


class Brew(NamedTuple):
    """Decoded state of the puzzle."""

    stone: int  # bit i is 1 while feature i is on
    trials: int  # number of finished trials
    rule: int  # index of the hidden rule in `list_rules`


@dataclasses.dataclass(frozen=True)
class PotionsConfig(PuzzleConfig):
    """Configuration of the potions, two panels per feature of the stone."""

    kind = "potions"
    features: Features = 2
    """Number of features of a stone, each with two potions. More features mean more hidden rules."""
    trials: Trials = 5
    """Number of stones to complete before the exit opens. More trials reward memory more."""
    bottles: Panels = Panels(width=1.0)
    """Sizes and places of the potions' panels."""


@dataclasses.dataclass(frozen=True)
class PotionsPuzzle(Modelled, Puzzle):
    """Concrete potions. The name of potion i is `potion-<i+1>`."""

    kind = "potions"
    features: Features = 1
    """Number of features of a stone, each with two potions."""
    trials: Trials = 1
    """Number of stones to complete before the exit opens."""

    @property
    def target_names(self) -> tuple[str, ...]:
        """`potion-1` to `potion-<2 features>`."""
        return tuple(f"potion-{i + 1}" for i in range(2 * self.features))

    def encode(self, brew: Brew) -> int:
        """Return the state of a brew."""
        return brew.stone | brew.trials << TRIAL_SHIFT | brew.rule << RULE_SHIFT

    def decode(self, state: int) -> Brew:
        """Return the brew of a state."""
        return Brew(state & (1 << TRIAL_SHIFT) - 1, state >> TRIAL_SHIFT & (1 << RULE_SHIFT - TRIAL_SHIFT) - 1,
                    state >> RULE_SHIFT)

    def list_starts(self) -> tuple[int, ...]:
        """List the initial states: the first stone under each rule."""
        return tuple(self.encode(Brew(0, 0, rule)) for rule in range(len(list_rules(self.features))))

    def is_state(self, state: Any) -> bool:
        """Return whether an untrusted value is an incomplete stone, a trial and a rule."""
        if type(state) is not int or state < 0:
            return False
        stone, trials, rule = self.decode(state)
        return (stone < (1 << self.features) - 1 and trials <= self.trials and rule < len(list_rules(self.features))
                and (trials < self.trials or stone == 0))

    def update(self, state: int, contacts: Contacts) -> int:
        """Apply the pressed potions to the stone, in index order."""
        stone, trials, rule = self.decode(state)
        for potion in contacts.pressed:
            if trials < self.trials:
                feature, is_on = list_rules(self.features)[rule][potion]
                stone = stone | 1 << feature if is_on else stone & ~(1 << feature)
                if stone == (1 << self.features) - 1:
                    stone, trials = 0, trials + 1
        return self.encode(Brew(stone, trials, rule))

    def is_solved(self, state: int) -> bool:
        """Return whether all trials are finished."""
        return self.decode(state).trials == self.trials

    def compute_progress(self, state: int) -> float:
        """Return the fraction, in [0, 1], of the trials that are finished."""
        return self.decode(state).trials / self.trials

    def observe(self, state: int) -> tuple[float, ...]:
        """Return one number per feature, and the fraction of finished trials; the rule stays hidden."""
        return (*(float(self.decode(state).stone >> i & 1) for i in range(self.features)), self.compute_progress(state))

    def get_lit(self, state: int) -> tuple[bool, ...]:
        """Return whether each potion is lit: all once all trials are finished, none before."""
        return (self.is_solved(state),) * (2 * self.features)

    def get_facts(self, state: int) -> frozenset[str]:
        """Return `on(feature-i)`, `done(trials)`, and the hidden `gives(potion,feature)` or `takes(potion,feature)`."""
        stone, trials, rule = self.decode(state)
        known = (self._name(potion, *effect) for potion, effect in enumerate(list_rules(self.features)[rule]))
        return frozenset({*(f"on(feature-{i + 1})" for i in range(self.features) if stone >> i & 1), f"done({trials})",
                          *known})

    def _name(self, potion: int, feature: int, is_on: bool) -> str:
        return f"{'gives' if is_on else 'takes'}({self.target_names[potion]},feature-{feature + 1})"

    def make_symbolic_model(self) -> SymbolicModel:
        """Return the model: one operator per potion with a conditional effect per rule. It contains the hidden rule."""
        on = [f"on(feature-{i + 1})" for i in range(self.features)]
        done = [frozenset({f"done({trials})"}) for trials in range(self.trials + 1)]
        operators, hidden = [], []
        for potion, name in enumerate(self.target_names):
            effects = []
            for feature in range(self.features):
                off, gives = (frozenset({self._name(potion, feature, way)}) for way in (False, True))
                hidden += [*off, *gives]
                others = frozenset(on) - {on[feature]}
                effects.append(Effect(off, delete=frozenset({on[feature]})))
                effects += [Effect(gives, frozenset({other}), frozenset({on[feature]})) for other in sorted(others)]
                effects += [Effect(gives | others | before, add=after, delete=before | others)
                            for before, after in zip(done, done[1:], strict=False)]
            operators.append(Operator(f"press-{name}", name, "press", forbidden=done[-1], when=tuple(effects)))
        facts = (*on, *(fact for each in done for fact in each), *hidden)
        return SymbolicModel(facts, tuple(operators), done[-1])


@lru_cache
def list_rules(features: int) -> tuple[tuple[tuple[int, bool], ...], ...]:
    """List all hidden rules: for each potion, the feature that it changes and whether it turns it on."""
    effects = [(feature, is_on) for feature in range(features) for is_on in (True, False)]
    return tuple(itertools.permutations(effects))


register_puzzle(PotionsConfig, PotionsPuzzle)
