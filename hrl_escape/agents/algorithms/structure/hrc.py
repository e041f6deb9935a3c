"""HRC without its estimate of effects: causal interventions on subgoals, on any or on given ancestors of the goal.

Khorasani et al. (2025), Hierarchical reinforcement learning with targeted causal interventions. Subgoals are the bits
of the observation. A bit is reachable once its parents have been intervened on. The agent turns its chosen bits on,
tries every action without a known effect, and learns which bits an action needs. The paper prefers interventions with a
large estimated effect on the goal. If the goal needs all of its parents, it is never observed before they are on, and
no estimate can distinguish its ancestors from other subgoals. The agent therefore chooses any subgoal, or is given the
ancestors.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_index, sample_legal
from hrl_escape.agents.factored.observation import FactorReader
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError
from hrl_escape.settings import Range

InterventionRule = Literal["uniform", "targeted", "ancestors"]
"""`uniform`: any reachable subgoal. `targeted`: after n interventions, an ancestor of the goal with probability
n / (n + 1), otherwise another one. `ancestors`: an ancestor while there is one."""


def compute_intervention_probabilities(candidates: Sequence[int], ancestors: Collection[int], made: int,
                                       rule: InterventionRule) -> list[float]:
    """Return the probability of each candidate (at least one) to be the next, after `made` interventions."""
    wanted = [candidate in ancestors for candidate in candidates]
    count, others = sum(wanted), len(candidates) - sum(wanted)
    if rule == "uniform" or not count or not others:
        return [1 / len(candidates)] * len(candidates)
    share = 1.0 if rule == "ancestors" else made / (made + 1)
    return [share / count if is_wanted else (1 - share) / others for is_wanted in wanted]


TASK_END = -1
"""Number for the end of the task, in place of a bit."""


@dataclass(frozen=True, kw_only=True)
class HrcSettings(AgentSettings):
    """Settings of `hrc`: tries of an action, most parents of a bit, and choice of interventions."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    tries: Annotated[int, Range(1)] = 1
    """Tries of an action after each intervention. Actions that can fail need more."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most bits that an action needs. The number of candidate sets grows exponentially with it."""
    rule: InterventionRule = "uniform"
    """Rule for the next intervention; all except `uniform` need `ancestors`."""
    ancestors: tuple[Annotated[int, Range(0)], ...] = ()
    """Components of the observation that are ancestors of the goal. Privileged information."""

    def check(self) -> None:
        """Check that rules other than `uniform` have ancestors."""
        if self.rule != "uniform" and not self.ancestors:
            raise AgentSettingsError("HrcSettings.rule", self.rule, "uniform, or with the privileged ancestors=(...)")


class Hrc(Agent):
    """Intervenes on reachable subgoals until the end of the task is reachable.

    A bit that an action has turned on is reachable: by that action, if its parents are on. The parents are the smallest
    set of bits, on in every success, that was on in the fewest failures. Among several sets, the one with most bits on
    is tested. After each intervention every action without a known effect is tried with all chosen bits on. Once the
    end is reachable, the agent goes there.

    Attributes:
        interventions: components of the chosen bits, in order.
        cost: sum of 1 + the number of interventions so far, over bits found after the first intervention.
    """

    settings: HrcSettings
    STATE = (
        Kept("_samples", pack=lambda samples: [[str(before), action, str(after), over]
                                               for before, action, after, over in samples],
             unpack=lambda saved: [(int(before), int(action), int(after), bool(over))
                                   for before, action, after, over in saved]),
        "interventions", "cost",
        Kept("_effects", pack=lambda effects: [list(item) for item in effects.items()],
             unpack=lambda saved: {int(bit): int(action) for bit, action in saved}),
        Kept("_tried", pack=lambda tried: [[*key, count] for key, count in tried.items()],
             unpack=lambda saved: {(int(action), int(made)): int(count) for action, made, count in saved}),
        "_factors", "_rng",
    )  # fmt: skip

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HrcSettings | None = None) -> None:
        self.settings = settings or HrcSettings()
        self._actions = count_actions(action_space, self.name)
        self._reader = FactorReader(observation_space, self.name)
        if (self._reader.sizes > 2).any():
            raise UnsupportedSpaceError(f"hrc intervenes on bits, and {observation_space} has factors of more values")
        self._rng = make_rng(seed, "actions")
        self._samples: list[tuple[int, int, int, bool]] = []
        """For each decision: bits before, action, bits after, over; bit n of a number is component n."""
        self._find_anew()

    def _find_anew(self) -> None:
        """Discard everything except the samples."""
        self.interventions: list[int] = []
        self.cost = 0
        self._effects: dict[int, int] = {}
        """Bit, or `TASK_END` -> the action that first turned it on."""
        self._parents: dict[int, list[tuple[int, ...]]] = {}
        """Bit, or `TASK_END` -> its possible sets of parents."""
        self._tried: dict[tuple[int, int], int] = {}
        """(action, number of interventions) -> number of tries."""

    def _read(self, observation: Any) -> int:
        flat = self._reader.flatten(observation)
        if self._reader.notice(flat):  # some numbers are not bits
            left = {TASK_END, *self._reader.components.tolist()}
            self._effects = {bit: action for bit, action in self._effects.items() if bit in left}
            self.interventions = [bit for bit in self.interventions if bit in left]
            self._parents = {bit: self._find_parents(bit) for bit in self._effects}
        return self._read_frozen(observation)

    # --- knowledge --------------------------------------------------------------------

    def _find_parents(self, bit: int) -> list[tuple[int, ...]]:
        """Smallest sets that were on in all successes and in the fewest failures of the bit's action."""
        action, known = self._effects[bit], sum(1 << int(component) for component in self._reader.components)
        off = [row for row in self._samples if row[1] == action and (bit == TASK_END or not row[0] >> bit & 1)]
        worked = [row[0] for row in off if (row[3] if bit == TASK_END else row[2] >> bit & 1)]
        failed = [row[0] for row in off if not (row[3] if bit == TASK_END else row[2] >> bit & 1)]
        common = known
        for before in worked:
            common &= before
        bits = [n for n in range(common.bit_length()) if common >> n & 1]
        best: list[tuple[int, ...]] = []
        least = len(failed) + 1
        for size in range(min(self.settings.max_parents, len(bits)) + 1):
            for chosen in itertools.combinations(bits, size):
                mask = sum(1 << n for n in chosen)
                count = sum(before & mask == mask for before in failed)
                if count < least:
                    best, least = [chosen], count
                elif count == least and len(chosen) == len(best[0]):
                    best.append(chosen)
        return best

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Return edges (parent, child) between the components of reachable bits."""
        return frozenset((parent, bit) for bit, sets in self._parents.items() if bit != TASK_END for parent in sets[0])

    def _step_towards(self, bit: int, bits: int, depth: int = 0) -> int:
        """Next action on the way to a bit, or to the end, for the set of parents with most bits on."""
        for parent in min(self._parents[bit], key=lambda needs: sum(not bits >> parent & 1 for parent in needs)):
            if not bits >> parent & 1 and parent in self._effects and depth < len(self._effects):
                return self._step_towards(parent, bits, depth + 1)
        return self._effects[bit]

    # --- acting -----------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Go to the end; otherwise turn chosen bits on, try actions without effect, choose the next intervention."""
        action = self._choose(self._read(observation), action_mask)
        return action if action_mask[action] else sample_legal(action_mask, self._rng)

    def _choose(self, bits: int, mask: NDArray[np.bool_]) -> int:
        if TASK_END in self._effects:
            return self._step_towards(TASK_END, bits)
        while True:
            for bit in self.interventions:
                if not bits >> bit & 1 and bit in self._effects:
                    return self._step_towards(bit, bits)
            left = self._list_untried()
            if left.any():
                return sample_legal(left & mask if (left & mask).any() else mask, self._rng)
            candidates = [bit for bit in self._effects if bit not in self.interventions]
            if not candidates:
                self._tried.clear()  # no further bit was found: some action must have failed by chance
                return sample_legal(mask, self._rng)
            shares = compute_intervention_probabilities(candidates, self.settings.ancestors, len(self.interventions),
                                                        self.settings.rule)
            self.interventions.append(candidates[sample_index(np.array(shares), self._rng)])

    def _list_untried(self) -> NDArray[np.bool_]:
        """Actions without an effect so far that have to be tried with the current interventions."""
        made, working = len(self.interventions), set(self._effects.values())
        return np.array([action not in working and self._tried.get((action, made), 0) < self.settings.tries
                         for action in range(self._actions)])

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the next action on the way to the end, or a random one if none is known."""
        bits = self._read_frozen(observation)
        action = self._step_towards(TASK_END, bits) if TASK_END in self._effects else None
        return sample_legal(action_mask, rng) if action is None or not action_mask[action] else action

    def _read_frozen(self, observation: Any) -> int:
        values = self._reader.read(self._reader.flatten(observation))
        return sum(1 << int(bit) for bit, value in zip(self._reader.components, values, strict=True) if value)

    # --- learning ---------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add a sample. A bit turned on for the first time becomes reachable."""
        if not transition.cut:  # a decision that was cut inside has no outcome
            before, after = self._read(transition.observation), self._read(transition.next_observation)
            self._learn((before, transition.action, after, transition.terminated))
        return {"interventions": len(self.interventions), "intervention_cost": self.cost,
                "subgoals": len(self._effects)}  # fmt: skip

    def _learn(self, sample: tuple[int, int, int, bool]) -> None:
        self._samples.append(sample)
        before, action, after, over = sample
        made = len(self.interventions)
        if all(before >> bit & 1 for bit in self.interventions):
            self._tried[action, made] = self._tried.get((action, made), 0) + 1
        turned = after & ~before
        found = [n for n in range(turned.bit_length()) if turned >> n & 1] + [TASK_END] * over
        for bit in found:
            if bit not in self._effects:
                self._effects[bit] = action
                self.cost += (made + 1) * (made > 0)
        for bit, by in self._effects.items():
            if by == action:
                self._parents[bit] = self._find_parents(bit)

    @property
    def _factors(self) -> NDArray[np.int64]:
        return self._reader.components

    @_factors.setter
    def _factors(self, components: NDArray[np.int64]) -> None:
        self._reader.keep(components)

    def after_load(self) -> None:
        """Compute the parents again."""
        self._parents = {bit: self._find_parents(bit) for bit in self._effects}
