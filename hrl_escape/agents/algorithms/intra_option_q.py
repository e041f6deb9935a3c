"""Intra-option Q-learning: every primitive updates every option that would have chosen it.

Sutton, Precup and Singh (1999), section 6. The environment must give traces of the primitives inside options (see
`agent.make_transition`). On a flat environment the algorithm is Q-learning.
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
    """Settings of `intra-option-q`: the use of options, and the settings of every agent with a table.

    Options for exploration only measure how much of their benefit that is. Repeated primitives are the control:
    temporal extension without goals.
    """

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
    options_serve: Literal["all", "exploration", "nothing"] = "all"
    """`all`: options are chosen and valued. `exploration`: random choices can be options, but only primitives are
    valued and greedy. `nothing`: options are ignored. For environments with primitives and options; an option is
    recognised by its first run and therefore runs once in any case."""
    repeats: tuple[Annotated[int, Range(1)], ...] = ()
    """Numbers of decisions that a random choice is repeated for, one drawn each time; empty for one decision."""


class IntraOptionQ(TabularAgent):
    """One-step intra-option Q-learning.

    For each primitive (s, a, r, s') in the trace and each option o consistent with it, that is pi_o(s) = a:

        Q(s, o) <- Q(s, o) + alpha [r + gamma U(s', o) - Q(s, o)]
        U(s', o) = (1 - beta_o(s')) Q(s', o) + beta_o(s') max over legal o' of Q(s', o')

    and U = 0 if the episode terminated. If the item is a decision of a level below, of k primitives, r is its
    discounted reward and gamma^k replaces gamma. beta refers to s', the next state. Only options whose policy is a
    function of the state are consistent with a primitive. The executed option, if it is not among them, is updated once
    per decision by the SMDP backup of `q-learning`. Traces are processed from their end, and one pass carries a reward
    all the way back. If the trace lacks the legal actions of a state inside an option, updates with a maximum over them
    are skipped.
    """

    needs_trace: ClassVar[bool] = True
    settings: IntraOptionQSettings
    STATE = ("_is_option", "_repeated")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: IntraOptionQSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._is_option = np.zeros(count_actions(action_space, self.name), np.bool_)
        self._repeated = (0, 0)  # a random choice, and for how many more decisions

    def _leave_out(self, mask: NDArray[np.bool_], uses: tuple[str, ...]) -> NDArray[np.bool_]:
        """Mask without options if `options_serve` is one of `uses`; unchanged if no action would remain."""
        left = mask & ~self._is_option
        return left if self.settings.options_serve in uses and left.any() else mask

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings define, among the actions that they allow."""
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
        """Return the legal action of highest value, ties at random; a primitive unless options serve `all`."""
        return super().act_greedy(observation, self._leave_out(action_mask, ("exploration", "nothing")), rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from the primitives inside the decision, and from the decision if they do not cover it.

        Raises:
            StepContractError: an option ran and the environment gave no trace of it.
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
