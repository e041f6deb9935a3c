"""Macro-Q: Q-learning over primitives and macro-actions, each valued by its reward until it ends.

McGovern, Sutton and Fagg (1997), Roles of macro-actions in accelerating reinforcement learning. "Run to the wall" is a
macro; so is any closed-loop course of primitives. A macro is a task without learning, and the stack runs it like any
other call. Macros carry values far in one backup, and move exploration to where they end. That helps or hurts,
depending on where the goal is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.tables import QTable, make_discretiser
from hrl_escape.agents.hierarchy.runner import TabularRunner
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Return, Seen, Stack, Step, allow_only
from hrl_escape.settings import Range


class Macro(BaseTask):
    """One macro-action.

    Args:
        policy: function from a moment to a primitive.
        until: function from a moment to whether the macro is over. It is called after each primitive but not before the
            first: every macro lasts at least one primitive.
        start: function from a moment to whether the macro can begin; anywhere by default.
    """

    def __init__(self, name: str, primitives: int, policy: Callable[[Seen], int], until: Callable[[Seen], bool],
                 start: Callable[[Seen], bool] | None = None) -> None:
        super().__init__(name, primitives)
        self._policy, self._until, self._start = policy, until, start

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """Return whether the macro can begin here and its first primitive is legal."""
        return bool(seen.mask[self._policy(seen)]) and (self._start is None or self._start(seen))

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Return None: the policy reads the moment."""
        return None

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return the policy's primitive, or nothing if it is illegal, which ends the macro."""
        return allow_only(self._policy(seen), seen.mask)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 if `until` returns true, after the first primitive."""
        return float(frame.primitives > 0 and self._until(seen))


class MacroChooser(BaseTask):
    """The root: chooses among the primitives, numbered first, and the macros."""

    def __init__(self, primitives: int, macros: Sequence[Macro]) -> None:
        super().__init__("root", primitives + len(macros))
        self._primitives, self.macros = primitives, tuple(macros)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return legal primitives, and macros that can begin."""
        callable_now = [macro.is_callable(seen, context) for macro in self.macros]
        return np.concatenate([seen.mask, np.array(callable_now, np.bool_)])

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """Return the primitive or macro of a number."""
        return Call(choice if choice < self._primitives else self.macros[choice - self._primitives])


@dataclass(frozen=True, kw_only=True)
class MacroQSettings(AgentSettings):
    """Settings of `macro-q`: step sizes, exploration and discount; macros are an argument of the agent."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""


class MacroQ(TabularRunner):
    """Values of primitives and macros.

    Macro or primitive m took k primitives from s to s' and earned R = sum of gamma^i r_i:

        Q(s, m) <- Q(s, m) + alpha [R + gamma^k (1 - terminated) max over legal m' of Q(s', m') - Q(s, m)]

    If truncation cut m short, m would have continued: Q(s', m) replaces the maximum, or m is not learned if it cannot
    begin at s'. An episode can end inside a macro, which is then over.

    Args:
        macros: macros, numbered after the primitives; without any the algorithm is Q-learning.
    """

    Settings: ClassVar[type] = MacroQSettings
    STATE = ("table",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: MacroQSettings | None = None, macros: Sequence[Macro] = ()) -> None:
        settings = settings or MacroQSettings()
        actions = count_actions(action_space, "macro-q")
        hierarchy = Hierarchy(MacroChooser(actions, macros), tuple(macros),
                              privileges=("macro-actions",) if macros else ())
        super().__init__(hierarchy, seed, settings)
        self.table = QTable(actions + len(macros), settings)
        self._discretise = make_discretiser(observation_space, settings, "macro-q")

    def compute_choice_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .), (primitives + macros,)."""
        return self.table.get_values(self._discretise(observation))

    def weigh(self, stack: Stack, view: Any, seen: Seen) -> NDArray[np.float64] | None:
        """Return values at the root; a macro follows its policy."""
        return None if len(stack) > 1 else self.compute_choice_values(seen.observation)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Update the value of a finished primitive or macro."""
        error = 0.0
        for returned in returns:
            decision, seen = returned.decision, returned.seen
            if len(returned.stack) > 1:
                continue
            legal = returned.frame.task.legal(seen, None)
            was_cut = returned.cut and returned.truncated and not returned.terminated
            if was_cut and not legal[decision.choice]:
                continue
            values = self.compute_choice_values(seen.observation)
            after = values[decision.choice] if was_cut else np.where(legal, values, -np.inf).max()
            target = decision.reward + (0.0 if returned.terminated else decision.discount * float(after))
            error = abs(self.table.update(self._discretise(decision.view), decision.choice, target))
        return self.finish_step(step, error)
