"""Networks of options and their rollouts: what learners of options over networks share, whichever way they learn.

Networks of the policies of all options, their values Q(s, o), the policy over options and the terminations.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import SMDPTransition, compute_backup, count_actions
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    make_forward,
    make_generator,
    make_network,
)
from hrl_escape.agents.components.options.agent import OptionAgent
from hrl_escape.agents.components.options.choices import (
    NONE,
    OptionChoices,
    find_next,
    mix_values,
    mix_with_former,
)
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_log_policy,
    stack_decisions,
    take_column,
    unstack_decisions,
)
from hrl_escape.agents.state import StateTree

__all__ = ["NetworkOptionAgent"]


def _compute_shift(settings: Any) -> float:
    """Number added to the outputs of the network of terminations, so that 0 there is `initial_termination`."""
    return math.log(settings.initial_termination / (1 - settings.initial_termination))


class NetworkOptionAgent(OptionAgent):
    """Base of agents that learn options over networks from rollouts of one environment.

    Attributes:
        networks: by name. `policy`: logits of every option's policy, (options x actions). `critic`: Q(s, o) in scaled
            return, (options,). `ending`: terminations before the logistic function and the shift of
            `initial_termination`, (options,). `chooser`: logits of the policy over options, (options,).
        trained: names of the networks that are learned with `learning_rate`; empty for all.
    """

    name: ClassVar[str]
    heads: ClassVar[tuple[str, ...]] = ("policy", "critic", "ending", "chooser")
    trained: ClassVar[tuple[str, ...]] = ()
    settings: Any
    is_markov: bool = False

    def __init__(
        self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any = None
    ) -> None:
        self.settings = settings = settings or self.Settings()
        super().__init__(settings.options, self.name)
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._actions = count_actions(action_space, self.name)
        generator = make_generator(make_rng(seed, "weights"))
        self.networks = {}
        for head in self.heads:
            outputs = self.options * (self._actions if head == "policy" else 1)
            gain = 1.0 if head == "critic" else 0.01
            self.networks[head] = make_network(self._encoder, outputs, settings, generator, 0, gain)
        self.policy, self.critic = self.networks["policy"], self.networks["critic"]
        self._forward = {name: make_forward(network) for name, network in self.networks.items()}
        self._action_rng, self._option_rng = make_rng(seed, "actions"), make_rng(seed, "options")
        self._batch_rng = make_rng(seed, "batches")
        self._learner = Learner(self.name, self.networks, self.trained or self.heads, settings)
        self._former, self._is_chosen = NONE, True
        self._forget()

    def _forget(self) -> None:
        """Begin an empty rollout."""
        self._rows: list[tuple] = []
        self._choices: list[tuple[int, int, bool]] = []

    # --- what the networks say ----------------------------------------------------------

    def _compute(self, network: str, observation: Any) -> NDArray[np.float64]:
        """Outputs of a network for one observation."""
        return self._forward[network](self._encoder.encode(observation)).astype(np.float64)

    def compute_policies(self, observation: Any, action_mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """pi_o(a | s) over legal actions, float64 (options, actions)."""
        logits = self._compute("policy", observation).reshape(self.options, -1)
        return compute_softmax(mask_values(logits, action_mask))

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """beta_o(s), float64 (options,)."""
        return 1 / (1 + np.exp(-self._compute("ending", observation) - _compute_shift(self.settings)))

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """pi_Omega(o | s), float64 (options,)."""
        return compute_softmax(self._compute("chooser", observation))

    def compute_option_values(self, observation: Any) -> NDArray[np.float64]:
        """Q(s, .) of options, in units of return, float64 (options,)."""
        return self._compute("critic", observation) / self.settings.reward_scale

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the policy of the likeliest option at an observation, before any mask, (actions,)."""
        option = int(self.compute_option_policy(observation).argmax())
        return self._compute("policy", observation).reshape(self.options, -1)[option]

    def compute_state_value(self, observation: Any) -> float:
        """Mean of Q(s, o) over the policy over options, in units of return."""
        return float(self.compute_option_policy(observation) @ self.compute_option_values(observation))

    def compute_log_policies(self, observation: Tensor, option: Tensor, mask: Tensor) -> Tensor:
        """Log probabilities of the actions of one option a row, (n, actions)."""
        logits = self.policy(observation).view(len(option), self.options, self._actions)
        return compute_log_policy(logits[torch.arange(len(option), device=option.device), option], mask)

    def compute_betas(self, observation: Tensor) -> Tensor:
        """beta_o(s) of all options, (n, options)."""
        return torch.sigmoid(self.networks["ending"](observation) + _compute_shift(self.settings))

    def compute_option_choice(self, observation: Tensor, former: Tensor) -> Tensor:
        """pi(o | s, the option before), (n, options)."""
        return mix_with_former(self.compute_betas(observation), self.compute_fresh_choice(observation), former)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """pi_Omega(o | s), (n, options)."""
        return torch.softmax(self.networks["chooser"](observation), dim=1)

    # --- acting -------------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the running option's policy; a first option is drawn in a new episode."""
        if self._option == NONE:
            self._choose(observation)
        self._shown = self._option, self._decisions, observation
        return sample_index(self.compute_policies(observation, action_mask)[self._option], self._action_rng)

    def _choose(self, observation: Any) -> None:
        """Draw an option from the policy over options."""
        self._former, self._is_chosen = self._option, True
        self._option, self._decisions = sample_index(self.compute_option_policy(observation), self._option_rng), 0

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest action of an option: the likeliest one, given that which ran in `rng`'s evaluation."""
        choice, decisions = self.compute_option_policy(observation), 0
        if self._evaluation is not None and self._evaluation[0] is rng:
            _, running, decisions = self._evaluation
            ends = self.compute_terminations(observation)[running]
            choice = ends * choice
            choice[running] += 1 - ends
            decisions = decisions if int(choice.argmax()) == running else 0
        option = int(choice.argmax())
        self._evaluation = rng, option, decisions + 1
        self._shown = option, decisions, observation
        return choose_best(self._compute("policy", observation).reshape(self.options, -1)[option], action_mask)

    # --- learning -----------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Keep the decision; update when the rollout is full; then the option may end."""
        reward, bootstrap = compute_backup(transition, self.settings)
        over = transition.terminated or transition.truncated
        self._rows.append((
            self._encoder.encode(transition.observation), transition.action_mask, transition.action,
            reward * self.settings.reward_scale, bootstrap, transition.duration, over,
            self._encoder.encode(transition.next_observation), np.zeros(0, np.float32),
        ))
        self._choices.append((self._option, self._former, self._is_chosen))
        self._decisions += 1
        metrics: dict[str, float] = {}
        if len(self._rows) >= self.settings.rollout:
            rollout, choices = self._gather()
            self._forget()
            metrics = dict(self._learn(rollout, choices)) | self.log.measure()
        self._go_on(transition.next_observation, over)
        return metrics

    def _go_on(self, observation: Any, over: bool) -> None:
        """Draw whether the option ends, and the next."""
        if over:
            self.log.add(self._option, self._decisions)
            self._option, self._decisions = NONE, 0
        elif self._option_rng.random() < self.compute_terminations(observation)[self._option]:
            self.log.add(self._option, self._decisions)
            self._choose(observation)
        else:
            self._former, self._is_chosen = self._option, False

    def _gather(self) -> tuple[Rollout, OptionChoices]:
        choices = OptionChoices(*map(torch.tensor, zip(*self._choices, strict=True)))
        return stack_decisions(self._rows, 0), choices

    @abstractmethod
    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        """The updates from a rollout; returns numbers to log.

        The networks are still those that chose.
        """

    def compute_next_values(self, rollout: Rollout, choices: OptionChoices) -> tuple[Tensor, Tensor]:
        """Values of the states reached, (n,) each: of the option that ran next, and before that one was drawn.

        Where none ran next in the rollout, because the episode was cut or the rollout ended, both are the latter.
        """
        values = self.critic(rollout.next_observation)
        mean = mix_values(self.compute_option_choice(rollout.next_observation, choices.option), values, choices.option)
        after, goes_on = find_next(rollout)
        return torch.where(goes_on, take_column(values, choices.option[after]), mean), mean

    def compute_advantages(self, rollout: Rollout, choices: OptionChoices, values: Tensor, cost: float) -> Tensor:
        """Advantages of actions within options, (n,), where ending an option has a cost upon arrival.

        Args:
            rollout: n decisions.
            choices: of options.
            values: Q(s, o) of the options that ran, (n,).
            cost: in scaled return.
        """
        next_values, _ = self.compute_next_values(rollout, choices)
        betas = take_column(self.compute_betas(rollout.next_observation), choices.option)
        after, goes_on = find_next(rollout)
        ends = torch.where(goes_on, choices.is_chosen[after].float(), betas)
        return compute_advantages(rollout, values, next_values - cost * ends, self.settings)

    def compute_termination_loss(self, rollout: Rollout, choices: OptionChoices, margin: float) -> Tensor:
        """Mean of beta_o(s') (Q(s', o) - V(s') + margin) over decisions, 0 where the task ended, ().

        o is the option that ran and V(s') the mean of Q(s', .) over the policy over options.
        """
        reached, option = rollout.next_observation, choices.option
        with torch.no_grad():
            values = self.critic(reached)
            worse = take_column(values, option) - mix_values(self.compute_fresh_choice(reached), values, option)
        goes_on = rollout.bootstrap > 0
        return (take_column(self.compute_betas(reached), option) * (worse + margin) * goes_on).mean()

    def state_dict(self) -> StateTree:
        """The rollout so far, the running option, its log, generators, networks and optimiser."""
        rollout, choices = self._gather() if self._rows else (None, None)
        return {
            "rollout": None if rollout is None else rollout._asdict(),
            "choices": None if choices is None else choices._asdict(),
            "log": self.log.state_dict(),
            "running": [self._option, self._former, int(self._is_chosen), self._decisions],
            **{f"{name}_rng": rng.bit_generator.state for name, rng in self._list_rngs()},
            "learner": self._learner.state_dict(),
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._forget()
        if state["rollout"] is not None:
            self._rows = unstack_decisions(state["rollout"])
            columns = [np.asarray(state["choices"][name]).tolist() for name in ("option", "former", "is_chosen")]
            self._choices = list(zip(*columns, strict=True))
        self.log.load_state_dict(state["log"])
        self._option, self._former, is_chosen, self._decisions = map(int, state["running"])
        self._is_chosen = bool(is_chosen)
        self._evaluation = None
        for name, rng in self._list_rngs():
            rng.bit_generator.state = state[f"{name}_rng"]
        self._learner.load_state_dict(state["learner"])

    def _list_rngs(self) -> tuple[tuple[str, np.random.Generator], ...]:
        return ("action", self._action_rng), ("option", self._option_rng), ("batch", self._batch_rng)
