"""DIAYN: skills that a discriminator can distinguish by their final states, learned without the task's reward.

Eysenbach, Gupta, Ibarz and Levine (2019), Diversity is all you need, on the clipped objective of PPO. The discriminator
sees a goal space only: given a pose, it distinguishes skills by the pose, and they press nothing.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.components.exploration import choose_best, make_rng
from hrl_escape.agents.components.networks import Learner, make_generator, make_network
from hrl_escape.agents.components.option_networks import OptionChoices, OptionHeads, OptionRolloutAgent
from hrl_escape.agents.components.policy_gradient import Rollout, compute_advantages, take_column
from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.factored.observation import FactorReader
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class DIAYNSettings(AgentSettings):
    """Settings of `diayn`: skills, discriminator, and the clipped update."""

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
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights; `orthogonal` goes with tanh units and a small last layer of the policy."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    entropy_weight: Annotated[float, Range(0)] = 0.1
    """Weight of the policy's entropy in the loss. More explores for longer."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error in the loss."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation. 1 has the most variance, and no bias from the critic."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    rollout: Annotated[int, Range(2)] = 256
    """Decisions collected before each round of updates, of all environments together."""
    rollout_per_env: Annotated[int, Range(1)] = 32
    """Least decisions of each of many environments, on average, in a rollout. A rollout above `rollout` is cut into as
    many minibatches, so into larger ones."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout. More learn more from it and move further from the policy that collected it."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in a minibatch of a rollout of `rollout` decisions."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Bound on how far the probability ratio may move to any advantage. Smaller is slower and steadier."""
    normalise_advantages: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1. Before the first success that blows
    noise up to full-sized steps."""
    options: Annotated[int, Range(2)] = 8
    """Number of skills."""
    goal: Literal["bits", "observation"] = "bits"
    """Part of the observation that the discriminator sees. `bits`: components of a flat Box that have only ever been 0
    or 1, in a room the puzzle's; all of a discrete observation. `observation`: everything."""
    discriminator_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam for the discriminator."""


class SkillHeads(OptionHeads):
    """Networks of skills, which are drawn evenly and never end by themselves."""

    names: ClassVar[tuple[str, ...]] = ("policy", "critic")

    def compute_terminations(self, observation: Any) -> NDArray[np.float64]:
        """Return zeros, float64 (skills,), because skills never end by themselves."""
        return np.zeros(self.options)

    def compute_betas(self, observation: Tensor) -> Tensor:
        """The same for many observations, (n, skills)."""
        return torch.zeros((len(observation), self.options), device=observation.device)

    def compute_option_policy(self, observation: Any) -> NDArray[np.float64]:
        """Return the uniform probability of each skill, p(z), float64 (skills,)."""
        return np.full(self.options, 1 / self.options)

    def compute_fresh_choice(self, observation: Tensor) -> Tensor:
        """The same for many observations, (n, skills)."""
        return torch.full((len(observation), self.options), 1 / self.options, device=observation.device)


class DIAYN(OptionRolloutAgent):
    """One skill z an episode, drawn evenly, and PPO within skills.

    The reward of a skill is

        log q(z | g(s')) - log p(z),    p(z) = 1 / skills

    for every decision that leads to s', where q is the discriminator's forecast of the skill from the goal g(s') and
    p(z) makes the reward 0 if skills cannot be distinguished. The task's reward only affects the choice
    among skills: evaluation runs the skill with the highest mean return in training.
    """

    settings: DIAYNSettings
    Heads = SkillHeads
    is_markov: bool = True
    STATE = (Kept("_judge", "discriminator"), "_returns", "_episodes", "_earned", "_bits", "_is_warned")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DIAYNSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self.discriminator = make_network(self._encoder, self.options, self.settings,
                                          make_generator(make_rng(seed, "discriminator")))
        self._judge = Learner(self.name, {"discriminator": self.discriminator}, ["discriminator"], self.settings,
                              self.settings.discriminator_rate)
        sees_bits = self.settings.goal == "bits" and isinstance(observation_space, spaces.Box)
        self._reader = FactorReader(observation_space, self.name) if sees_bits else None
        self._returns, self._episodes = np.zeros(self.options), np.zeros(self.options, np.int64)
        self._earned, self._is_warned = np.zeros(1), False  # so far, in each environment's episode

    # --- skills -----------------------------------------------------------------------

    def find_best_skill(self) -> int:
        """Return the skill with the highest mean return of training episodes, or 0 before the first."""
        means = np.where(self._episodes > 0, self._returns / np.maximum(self._episodes, 1), -np.inf)
        return int(means.argmax())

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the logits of the best skill at an observation, unmasked, (actions,)."""
        return self.heads.compute("policy", observation).reshape(self.options, -1)[self.find_best_skill()]

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the most probable action of the best skill."""
        self._shown = self.find_best_skill(), 0, observation
        return choose_best(self.compute_preferences(observation), action_mask)

    # --- learning ---------------------------------------------------------------------

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store the decisions and the returns of their episodes; update when the rollout is full."""
        over = batch.terminated | batch.truncated
        if self._many is None:
            self._note(batch.env, [self._option], batch.summed_reward, over, batch.next_observation)
        else:
            option = self._many[1].get_running(batch.env)
            parts = batch.env, option, batch.summed_reward, over, batch.next_observation
            self._note(*(part.cpu().numpy() for part in parts))
        return super().observe(batch)

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment, with a return of 0."""
        super().begin_episodes(num_envs, device)
        self._earned = np.zeros(num_envs)

    def move(self, device: torch.device) -> None:
        """Move networks, optimisers and collected decisions to a device."""
        super().move(device)
        self._judge.move(device)

    def _note(self, env: ArrayLike, option: ArrayLike, reward: ArrayLike, over: ArrayLike, reached: ArrayLike
              ) -> None:
        """Add up returns of skills, and find components of observations that are not bits; arrays (n, ...)."""
        env, option, over = np.asarray(env), np.asarray(option), np.asarray(over, dtype=np.bool_)
        if self._reader is not None and len(env):
            self._reader.notice(np.asarray(reached, dtype=np.float64).reshape(len(env), -1))
        self._earned[env] += np.asarray(reward)
        np.add.at(self._returns, option[over], self._earned[env[over]])
        np.add.at(self._episodes, option[over], 1)
        self._earned[env[over]] = 0.0

    def read_goals(self, observation: Tensor) -> Tensor:
        """Return encoded observations for the discriminator, with all other components 0; (n, ...)."""
        if self._reader is None:
            return observation
        seen = torch.zeros(observation.shape[1], device=observation.device)
        seen[self._reader.components] = 1.0
        if not seen.any() and not self._is_warned:
            self._is_warned = True
            warnings.warn("diayn: no component of the observation is a bit, so skills cannot be distinguished; set "
                          "goal=observation", stacklevel=2)
        return observation * seen

    def compute_rewards(self, observation: Tensor, option: Tensor) -> Tensor:
        """Reward log q(z | g) - log p(z) at encoded observations, nats, (n,)."""
        log_forecast = functional.log_softmax(self.discriminator(self.read_goals(observation)), dim=1)
        return take_column(log_forecast, option) + math.log(self.options)

    def _learn(self, rollout: Rollout, choices: OptionChoices) -> Mapping[str, float]:
        settings, option = self.settings, choices.option
        with torch.no_grad():
            rewards = self.compute_rewards(rollout.next_observation, option)
            values = take_column(self.heads.critic(rollout.observation), option)
            next_values, _ = self.heads.compute_next_values(rollout, choices)
            advantage = compute_advantages(rollout._replace(reward=rewards), values, next_values, settings)
            columns = (rollout.observation, rollout.mask, option, rollout.action,
                       self.heads.compute_old_log_probability(rollout, choices), advantage, advantage + values)
        batches = list(self._draw_batches(len(option), len(option)))
        metrics = self.heads.learner.minimise_each(
            self.heads.compute_option_loss(*(column.index_select(0, rows) for column in columns)) for rows in batches)
        goals = self.read_goals(rollout.next_observation)
        judged = self._judge.minimise_each(
            {"discriminator_loss": functional.cross_entropy(self.discriminator(goals.index_select(0, rows)),
                                                            option.index_select(0, rows))}
            for rows in batches)
        return metrics | judged | {"skill_reward": rewards.mean().item(),
                                   "gradient_norm": self.heads.learner.gradient_norm}

    @property
    def _bits(self) -> NDArray[np.int64] | None:
        """Components of the observation that are bits, or None if the discriminator sees everything."""
        return None if self._reader is None else self._reader.components

    @_bits.setter
    def _bits(self, components: NDArray[np.int64] | None) -> None:
        if self._reader is not None:
            self._reader.keep(np.asarray(components, np.int64))

    def after_load(self) -> None:
        """Take a number that was kept for the one environment as an array."""
        self._earned = np.atleast_1d(self._earned)
