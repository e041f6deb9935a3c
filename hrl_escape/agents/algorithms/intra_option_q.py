"""Intra-option Q-learning: every primitive teaches every option that would have done the same.

Sutton, Precup and Singh (1999), section 6. It needs to see inside options, so the environment must
give traces (see `agent.make_transition`); on a flat environment it is Q-learning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import compute_epsilon, sample_legal
from hrl_escape.agents.components.tables import TabularAgent
from hrl_escape.errors import StepContractError
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class IntraOptionQSettings(AgentSettings):
    """Use of the options, beside the settings of every agent with a table.

    Given to exploration alone, they show how much of their help that is; repeated primitives are the control, temporal
    extension without goals.
    """

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Steps of the clock over which epsilon falls linearly."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy`: uniform over legal actions with probability epsilon, else greedy. `boltzmann`: probability
    proportional to exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as keras-rl 0.4.2 has it: values beyond it are equally
    likely. 0 sets no bound."""
    bins: Annotated[int, Range(2)] = 11
    """A component with bounds low, high is rounded to the nearest of this many evenly spaced points, both ends
    included: 11 over a 20 m room is 2 m; a bit stays a bit."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """A component without bounds is rounded to multiples of this, in its own unit."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size alpha at a state and action's first update; 1 suits deterministic environments."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """The n-th update of a state and action uses learning_rate / n^power; above 0.5 converges under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return."""
    options_serve: Literal["all", "exploration", "nothing"] = "all"
    """`all`: they are chosen and valued. `exploration`: random choices may be options; values are backed up over
    primitives alone, which alone are greedy. `nothing`: as if there were none. For environments with primitives beside
    options; an option is known by its first run, so it is run once in any case."""
    repeats: tuple[Annotated[int, Range(1)], ...] = ()
    """Decisions for which a random choice is repeated, one of these drawn each time; empty for one."""


class IntraOptionQ(TabularAgent):
    """One-step intra-option Q-learning.

    For each primitive (s, a, r, s') in the trace and each option o consistent with it, that is pi_o(s) = a:

        Q(s, o) <- Q(s, o) + alpha [r + gamma U(s', o) - Q(s, o)]
        U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') max over legal o' of Q(s', o')

    and U = 0 where the episode terminated. Where the item is a decision of a level below, of k primitives, r is its
    discounted reward and gamma^k stands for gamma. beta is that of s', the state reached. Only options whose policy is
    a function of the state are consistent with anything; the executed option, if it is not among them, is learned by
    the SMDP backup of `q-learning`, once a decision. A trace is worked through from its end, so that one pass
    carries a reward all the way back. Where the trace does not say which actions are legal at a state
    inside an option, no maximum over them can be taken, and updates that need it are left out.
    """

    needs_trace: ClassVar[bool] = True
    settings: IntraOptionQSettings
    STATE = ("_is_option", "_repeated")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: IntraOptionQSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._is_option = np.zeros(count_actions(action_space, self.name), np.bool_)
        self._repeated = (0, 0)  # a random choice, and for how many decisions more

    def _leave_out(self, mask: NDArray[np.bool_], uses: tuple[str, ...]) -> NDArray[np.bool_]:
        """A mask without options where they serve one of these; whole where nothing would be left."""
        left = mask & ~self._is_option
        return left if self.settings.options_serve in uses and left.any() else mask

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, with the actions that they allow."""
        settings, (choice, left) = self.settings, self._repeated
        drawn = self._leave_out(action_mask, ("nothing",))
        if left and drawn[choice]:
            self._repeated = choice, left - 1
            return choice
        if settings.options_serve != "exploration" and not settings.repeats:
            return super().act(observation, drawn)
        if self._rng.random() >= compute_epsilon(settings, self._steps):
            return self.act_greedy(observation, action_mask, self._rng)
        choice = sample_legal(drawn, self._rng)
        self._repeated = choice, int(self._rng.choice(settings.repeats)) - 1 if settings.repeats else 0
        return choice

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value, drawn among equals; a primitive where options do not serve `all`."""
        return super().act_greedy(observation, self._leave_out(action_mask, ("exploration", "nothing")), rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from the primitives inside the decision, and from the decision where they do not cover it.

        Raises:
            StepContractError: an option ran but the environment gave no trace of it.
        """
        trace = transition.trace
        covers = sum(len(_get_rewards(item)) for item in trace)
        if transition.duration > 1 and covers != transition.duration:
            raise StepContractError(
                f"intra-option-q needs info['trace'] with one item per primitive; an action of "
                f"{transition.duration} primitives came with {covers}. Ask the environment for traces "
                "(OptionsEnv(env, trace=True)), or use q-learning"
            )
        self._is_option[transition.action] |= bool(trace) and trace[0][1] != transition.action
        if transition.terminated or transition.truncated:
            self._repeated = (0, 0)
        for index in range(len(trace) - 1, -1, -1):
            self._learn_primitive(trace[index], transition, is_last=index == len(trace) - 1)
        covered = bool(trace) and any(o == transition.action for o, _ in _get_consistent(trace[0]))
        return self.finish_decision(transition, 0.0 if covered else self.back_up(transition))

    def _learn_primitive(self, item: Any, transition: SMDPTransition, is_last: bool) -> None:
        consistent = _get_consistent(item)
        if not consistent:
            return
        observation, _, _, next_observation = item[:4]
        reward, discount = 0.0, 1.0
        for primitive_reward in _get_rewards(item):
            reward, discount = reward + discount * float(primitive_reward), discount * self.gamma
        mask = transition.next_action_mask if is_last else getattr(item, "next_action_mask", None)
        key = self._discretise(observation)
        next_values = self.compute_values(next_observation)
        ended = transition.terminated or (transition.truncated and not self.settings.bootstrap_on_truncation)
        for option, beta in consistent:
            value = 0.0
            if not (is_last and ended):
                if mask is None and beta > 0:
                    continue
                legal = mask is not None and self._leave_out(np.asarray(mask) != 0, ("exploration", "nothing"))
                best = 0.0 if mask is None else float(next_values[legal].max())
                value = (1 - beta) * float(next_values[option]) + beta * best
            self.table.update(key, option, reward + discount * value)


def _get_consistent(item: Any) -> tuple[tuple[int, float], ...]:
    return getattr(item, "consistent", ())


def _get_rewards(item: Any) -> Sequence[float]:
    """Rewards of the primitives of an item: one, unless it is a decision of a level below."""
    return getattr(item, "rewards", ()) or (item[2],)
