"""Many copies of an environment that step together as tensors on one device, each at its own pace.

A step runs one primitive in every environment, or one decision where all take equally long. It returns the decisions
that ended. An environment takes its next decision as soon as its last one has ended.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import DiscountMismatchError

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class EndedDecisions(NamedTuple):
    """Result of a step: tensors (environments, ...) whose rows count where `where` is true."""

    where: Tensor  # environments whose decision ended, bool (environments,)
    observation: Tensor  # at the decision
    action: Tensor  # chosen there, int64, or float32 (environments, ...) of a Box
    reward: Tensor  # sum of the primitive rewards, float32
    discounted_reward: Tensor  # R = sum over i < k of gamma^i r_i at the environments' gamma, float32
    duration: Tensor  # k >= 1, the primitives that ran
    next_observation: Tensor  # state reached, never the first of a new episode
    next_action_mask: Tensor  # actions legal there, bool (environments, actions)
    terminated: Tensor  # the task ended, which a cut does not do, bool
    truncated: Tensor  # the episode was cut off, bool
    success: Tensor  # the episode ended in success, bool; or int8, with -1 where the environment reports none


class ManyEnvs(Protocol):
    """Many copies of an environment; `observation_space` and `action_space` describe a single copy.

    A vector environment, whose steps wait for all, may return them from its method `get_many_envs`. One that can make
    an ordinary environment of the same task, spaces and action numbers has the method `make_single_env`. One whose
    running episodes can be saved has `state_dict` and `load_state_dict`.
    """

    count: int  # environments that step together
    observation_space: Any  # Gymnasium space of one environment's observations
    action_space: Any  # and of its actions

    @property
    def gamma(self) -> float:
        """Discount per primitive in `discounted_reward`."""
        ...

    @property
    def device(self) -> torch.device:
        """Device of all tensors; known after `reset`."""
        ...

    @property
    def observation(self) -> Tensor:
        """Observations now, after any automatic reset, (environments, ...)."""
        ...

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (environments, actions); (environments, 0) for a Box."""
        ...

    @property
    def is_waiting(self) -> Tensor:
        """Environments that take an action at the next step, bool (environments,)."""
        ...

    def reset(self, seeds: int) -> Any:
        """Begin all episodes; environment i draws from seed + i."""
        ...

    def step(self, action: Tensor) -> Any:
        """Step with actions for waiting environments, int64 (environments,); episodes reset automatically.

        Returns `EndedDecisions`, or an object with its attributes.
        """
        ...

    def state_dict(self) -> StateTree | None:
        """State that later steps depend on, or None if it cannot be saved."""
        ...

    def load_state_dict(self, state: StateTree) -> None:
        """Continue where `state_dict` was taken."""


def gather_decisions(ended: EndedDecisions, masks: Tensor, gamma: float, agent_gamma: float) -> Decisions:
    """Return the decisions that ended, for an agent that discounts by its own gamma.

    Args:
        ended: result of a step.
        masks: bool (environments, actions), legal at each environment's present decision.
        gamma: discount of the environments.
        agent_gamma: discount of the agent.

    Raises:
        DiscountMismatchError: a decision of several primitives, discounted by another gamma than the agent's.
    """
    env = ended.where.nonzero().squeeze(1)
    duration = ended.duration.long()
    if gamma != agent_gamma and len(env) and (longest := int(duration[env].max())) > 1:
        raise DiscountMismatchError(agent_gamma, gamma**longest, longest)
    discount = (agent_gamma ** duration.double()).float()
    fields = (ended.observation, masks, ended.action, ended.discounted_reward, ended.reward, duration, discount,
              ended.next_observation, ended.next_action_mask, ended.terminated, ended.truncated)
    return Decisions._make((env, *(field[env] for field in fields), ()))
