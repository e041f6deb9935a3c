"""Option-critic in tables: policies and terminations of options learned by gradients of one critic.

Bacon, Harb and Precup (2017), with the deliberation cost of Harb et al. (2018), and updates of several options from one
decision by Klissarov and Precup (2021). Policy and termination are updated for the option that ran, its termination at
the next state; published programs differ in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition, compute_backup, count_actions
from hrl_escape.agents.components.exploration import (
    compute_epsilon_greedy,
    compute_softmax,
    make_rng,
    mask_values,
    sample_index,
)
from hrl_escape.agents.components.option_agent import OptionAgent
from hrl_escape.agents.components.tables import make_discretiser
from hrl_escape.agents.state import StateTree, pack_keys, unpack_keys
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class OptionCriticSettings(AgentSettings):
    """Settings of `option-critic`: options, step sizes and exploration."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    options: Annotated[int, Range(1)] = 4
    """Number of options to learn."""
    initial_termination: Annotated[float, Range(0, 1, open_low=True, open_high=True)] = 0.5
    """Initial probability of ending an option. Smaller values make the first options longer."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    critic_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of option values and of action values within options."""
    policy_rate: Annotated[float, Range(0)] = 0.25
    """Step size of the options' policies; 0 keeps them fixed."""
    termination_rate: Annotated[float, Range(0)] = 0.25
    """Step size of terminations; 0 keeps them fixed."""
    temperature: Annotated[float, Range(0, open_low=True)] = 0.01
    """Temperature of the options' policies, in units of scaled return. More makes them more random."""
    epsilon: Annotated[float, Range(0, 1)] = 0.01
    """Probability of a random option, and weight of the mean in the value of ending an option. More explores more."""
    deliberation_cost: Annotated[float, Range(0)] = 0.0
    """Cost of ending an option, in scaled return, paid in the value on arrival, which makes it a margin of
    terminations. More makes options last longer."""
    termination_margin: Annotated[float, Range(0)] = 0.0
    """Margin in the comparison of an option with the mean: its termination only grows if it is worse by more, in scaled
    return. Not part of values."""
    multi_option: Annotated[float, Range(0, 1)] = 0.0
    """Share of each update that goes to every option, weighted by its probability to run and to choose the same; the
    rest goes to the option that ran. Above 0 this is MOC."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.01
    """Factor on the rewards of learned values, for returns of about 1. Logged values keep units of return."""


class OptionTables(NamedTuple):
    """Learned numbers of one state."""

    values: NDArray[np.float64]  # (options,), Q(s, o)
    action_values: NDArray[np.float64]  # (options, actions), Q_U(s, o, a)
    preferences: NDArray[np.float64]  # (options, actions), theta
    endings: NDArray[np.float64]  # (options,), phi; the termination is its logistic function


class OptionCritic(OptionAgent):
    """Learn Q(s, o), Q_U(s, o, a), pi_o and beta_o from every decision (s, o, a) -> R, s'.

        U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') (V(s') - cost)
        V(s')    = (1 - epsilon) max over o' of Q(s', o') + epsilon mean over o' of Q(s', o')
        critic       Q_U(s, o, a) and Q(s, o) towards R + b U(s', o)
        policy       theta_o += rate grad log pi_o(a | s) (Q_U(s, o, a) - Q(s, o))
        termination  phi_o   -= rate grad beta_o(s') (Q(s', o) - V(s') + cost + margin), unless terminated

    Then the option ends with probability beta_o(s') and the next is chosen epsilon-greedily. With `multi_option` every
    option o is updated, weighted by w_o = P(o | s, previous option). The weight of its own value and policy also has
    the factor pi_o(a | s) / pi(a | s) of the option that ran. No step is longer than its rate.
    """

    settings: OptionCriticSettings
    STATE = ("log", "_option", "_decisions", "_likely", "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: OptionCriticSettings | None = None) -> None:
        self.settings = settings = settings or OptionCriticSettings()
        super().__init__(settings.options, self.name)
        self._actions = count_actions(action_space, self.name)
        self._discretise = make_discretiser(observation_space, settings, self.name)
        self._tables: dict[bytes, OptionTables] = {}
        self._unknown = self._make_tables()
        self._rng = make_rng(seed, "actions")
        self._likely = np.zeros(settings.options)  # P(o | s, previous option)
        self._eye = np.eye(settings.options)

    def _make_tables(self) -> OptionTables:
        options = self.settings.options
        even = np.zeros((options, self._actions))
        start = np.log(self.settings.initial_termination / (1 - self.settings.initial_termination))
        return OptionTables(np.zeros(options), even.copy(), even, np.full(options, start))

    def _get(self, observation: Any) -> OptionTables:
        """Read-only tables of a state."""
        return self._tables.get(self._discretise(observation), self._unknown)

    def _claim(self, observation: Any) -> OptionTables:
        """Tables of a state, created at its first update."""
        key = self._discretise(observation)
        if key not in self._tables:
            self._tables[key] = self._make_tables()
        return self._tables[key]

    # --- outputs ------------------------------------------------------------------------

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return pi_o(a | s) over legal actions, float64 (options, actions)."""
        preferences = self._get(observation).preferences / self.settings.temperature
        return compute_softmax(mask_values(preferences, action_mask))

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Return the probability that each option ends at the observation, beta_o(s), float64 (options,)."""
        return 1 / (1 + np.exp(-self._get(observation).endings))

    def compute_option_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .) of options, in units of return, float64 (options,)."""
        return self._get(observation).values / self.settings.reward_scale

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q_U(s, o, .) of the best option o, in units of return, float64 (actions,)."""
        tables = self._get(observation)
        return tables.action_values[tables.values.argmax()] / self.settings.reward_scale

    def compute_state_value(self, observation: Any) -> float:
        """Return V(s), in units of return."""
        return self._compute_mean_value(self._get(observation).values) / self.settings.reward_scale

    def _compute_mean_value(self, values: NDArray[np.float64]) -> float:
        """V of the epsilon-greedy policy over options."""
        return float((1 - self.settings.epsilon) * values.max() + self.settings.epsilon * values.mean())

    def _compute_choice(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability of each option under the policy over options, (options,)."""
        return compute_epsilon_greedy(values, self.settings.epsilon)

    def _draw(self, option: int, decisions: int, observation: Any, mask: NDArray[np.bool_],
              rng: np.random.Generator) -> int:
        self._shown = option, decisions, observation
        return sample_index(self.compute_policies(observation, mask)[option], rng)

    # --- acting -------------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the running option's policy; a new episode chooses its first option."""
        if self._option < 0:
            self._likely = self._compute_choice(self._get(observation).values)
            self._option, self._decisions = sample_index(self._likely, self._rng), 0
        return self._draw(self._option, self._decisions, observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Draw from the policy of the best option until it ends, in the evaluation that `rng` identifies."""
        option, decisions = int(self._get(observation).values.argmax()), 0
        if (known := self.recall(rng)) is not None:
            running, made = known
            if rng.random() >= self.compute_terminations(observation)[running]:
                option, decisions = running, made
        self._evaluation = rng, option, decisions + 1
        return self._draw(option, decisions, observation, action_mask, rng)

    # --- learning -----------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Make one update of critic, policy and termination; the option may then end."""
        error = self._learn(transition)
        self._decisions += 1
        ended = self._go_on(transition)
        metrics = {"td_error": error / self.settings.reward_scale, "states": len(self._tables)}
        return metrics | self.log.measure() if ended else metrics

    def _learn(self, transition: SMDPTransition) -> float:
        settings, option, action = self.settings, self._option, transition.action
        policies = self.compute_policies(transition.observation, transition.action_mask)
        here, there = self._claim(transition.observation), self._claim(transition.next_observation)
        reward, bootstrap = compute_backup(transition, settings)
        beta = self.compute_terminations(transition.next_observation)
        arrived = self._compute_mean_value(there.values) - settings.deliberation_cost
        target = reward * settings.reward_scale + bootstrap * ((1 - beta) * there.values + beta * arrived)
        error = float(target[option] - here.values[option])

        weights = self._eye[option] + settings.multi_option * (self._likely - self._eye[option])
        same = np.minimum(weights * policies[:, action] / policies[option, action], 1.0)
        here.action_values[:, action] += settings.critic_rate * weights * (target - here.action_values[:, action])
        here.values[:] += settings.critic_rate * same * (target - here.values)

        advantage = here.action_values[:, action] - here.values
        gradient = -policies  # gradient of log pi_o(a | s) by theta_o, times the temperature
        gradient[:, action] += 1
        here.preferences[:] += settings.policy_rate * (same * advantage)[:, None] * gradient
        if not transition.terminated:
            worse = there.values - self._compute_mean_value(there.values)
            margin = settings.deliberation_cost + settings.termination_margin
            there.endings[:] -= settings.termination_rate * weights * beta * (1 - beta) * (worse + margin)
        return abs(error)

    def _go_on(self, transition: SMDPTransition) -> bool:
        """Draw whether the option ends, and the next option; return whether it ended."""
        if transition.terminated or transition.truncated:
            self.log.add(self._option, self._decisions)
            self._option, self._decisions = -1, 0
            return True
        beta = float(self.compute_terminations(transition.next_observation)[self._option])
        choice = self._compute_choice(self._get(transition.next_observation).values)
        self._likely = beta * choice + (1 - beta) * self._eye[self._option]
        if self._rng.random() >= beta:
            return False
        self.log.add(self._option, self._decisions)
        self._option, self._decisions = sample_index(choice, self._rng), 0
        return True

    def state_dict(self) -> StateTree:
        """Return tables in order of first meeting, in addition to the attributes in `STATE`."""
        columns = zip(*self._tables.values(), strict=True) if self._tables else ([] for _ in OptionTables._fields)
        tables = {name: np.array(column) for name, column in zip(OptionTables._fields, columns, strict=True)}
        return {"keys": pack_keys(self._tables), **tables, **super().state_dict()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        columns = (np.array(state[name]) for name in OptionTables._fields)
        rows = (OptionTables(*row) for row in zip(*columns, strict=True))
        self._tables = dict(zip(unpack_keys(state["keys"]), rows, strict=True))
        super().load_state_dict(state)
