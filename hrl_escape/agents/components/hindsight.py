"""Hindsight experience replay (Andrychowicz et al. 2017): replay an episode as if other goals had been requested.

At the end of an episode each of its decisions is stored again, with goals that were achieved at it or later (the
strategy `future`). Reward and termination are computed again from the achieved goal and the new one, before decisions
are joined into backups. A backup of n decisions therefore ends where the new goal is achieved. A goal that was already
achieved before a decision is skipped, because an episode with this goal would have ended earlier.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import GoalRule, SMDPTransition, compute_backup
from hrl_escape.agents.components.networks import ObservationEncoder, is_goal_space
from hrl_escape.agents.components.replay import Experience, make_batch
from hrl_escape.agents.decisions import Decisions, read_decision
from hrl_escape.agents.state import Kept, Stateful, read_value
from hrl_escape.errors import AgentSettingsError, StepContractError


class _Judgement(NamedTuple):
    """Reward of a decision for an achieved and a desired goal, and whether that ends the episode."""

    reward: float
    terminated: bool


class _Decision(NamedTuple):
    """A decision of the episode. Its observations are in the experience."""

    transition: SMDPTransition  # the rest of it
    experience: Experience  # backup of the decision
    before: NDArray  # goal achieved before it
    achieved: NDArray  # goal achieved after it
    desired: NDArray  # requested goal
    bonus: float  # bonus in its reward


class Hindsight(Stateful):
    """Hindsight without goals: nothing is stored again."""

    STATE: ClassVar[tuple[Any, ...]] = ()

    def push(self, batch: Decisions, experience: Experience, bonus: Any) -> list[Experience]:
        """Return no backups."""
        return []


class HindsightReplay(Hindsight):
    """The current episode, and its backups under goals that it achieved; some goals are drawn for each decision.

    Raises:
        AgentSettingsError: the environment has no goals.
    """

    STATE = ("_rng", Kept(
        "_episode", pack=lambda episode: [
            read_value(decision._replace(transition=decision.transition._replace(trace=[])), "episode")
            for decision in episode],
        unpack=lambda saved: [
            _Decision(**{**fields, "transition": SMDPTransition(**{**fields["transition"], "trace": ()}),
                         "experience": Experience(**fields["experience"])}) for fields in saved]))

    def __init__(self, space: gymnasium.Space, rule: GoalRule | None, goals: int, n_step: int,
                 encoder: ObservationEncoder, settings: Any, rng: np.random.Generator) -> None:
        if rule is None or not is_goal_space(space):
            raise AgentSettingsError(
                "hindsight_goals", goals, "0, because the environment has no goals. Goals require a Dict of "
                "observation, achieved_goal and desired_goal, and the methods compute_reward and "
                "compute_terminated, as in Gymnasium-Robotics and hrl_escape.sets.GoalsEnv")
        self._rule, self._goals, self._n_step = rule, goals, n_step
        self._encoder, self._settings, self._rng = encoder, settings, rng
        self._episode: list[_Decision] = []
        self._known: dict[tuple[bytes, bytes], _Judgement] = {}  # by pair of goals, for this episode

    def push(self, batch: Decisions, experience: Experience, bonus: Any) -> list[Experience]:
        """Store a decision, its backup and its bonus; at the end of the episode return backups under new goals.

        Raises:
            StepContractError: the decision ran several primitives, and goals achieved inside it are unknown.
        """
        transition = read_decision(batch)
        experience, bonus = Experience(*(field[0] for field in experience)), float(np.ravel(bonus)[0])
        if transition.duration != 1:
            raise StepContractError(f"action {transition.action} ran {transition.duration} primitives; hindsight_goals "
                                    "need decisions of one primitive. Use primitives only, or set hindsight_goals to 0")
        before, after = transition.observation, transition.next_observation
        bare = transition._replace(observation=None, next_observation=None, trace=())
        self._episode.append(_Decision(bare, experience, np.array(before["achieved_goal"]),
                                       np.array(after["achieved_goal"]), np.array(after["desired_goal"]), bonus))
        if not (transition.terminated or transition.truncated):
            return []
        relabelled = list(self._relabel())
        self._episode.clear()
        self._known.clear()
        return [make_batch(each) for each in relabelled]

    def _relabel(self) -> Iterator[Experience]:
        """Backups of each decision with goals achieved at it or later in the episode."""
        for start, decision in enumerate(self._episode):
            for chosen in self._rng.integers(start, len(self._episode), size=self._goals):
                goal = self._episode[chosen].achieved
                if not self._judge(decision.before, goal).terminated:
                    yield self._join(start, goal)

    def _join(self, start: int, goal: NDArray) -> Experience:
        """The backup of n decisions under another goal; shorter if the goal is achieved or the episode ends."""
        reward, bootstrap, last = 0.0, 1.0, start
        for last in range(start, min(start + self._n_step, len(self._episode))):
            own_reward, own_bootstrap = self._back_up(self._episode[last], goal)
            reward += bootstrap * own_reward
            bootstrap *= own_bootstrap
            if not bootstrap:
                break
        first, then = self._episode[start].experience, self._episode[last].experience
        return first._replace(
            observation=self._encoder.replace_goal(first.observation, goal),
            reward=reward * self._settings.reward_scale,
            bootstrap=bootstrap,
            next_observation=self._encoder.replace_goal(then.next_observation, goal),
            next_mask=then.next_mask,
        )

    def _back_up(self, decision: _Decision, goal: NDArray) -> tuple[float, float]:
        """R and b of a decision under another goal. Ends of the episode for other reasons stay ends."""
        reward, terminated = self._judge(decision.achieved, goal)
        if decision.transition.terminated and not terminated:
            terminated = not self._judge(decision.achieved, decision.desired).terminated
        reward, bootstrap = compute_backup(
            decision.transition._replace(reward=reward, summed_reward=reward, terminated=terminated), self._settings)
        return reward + decision.bonus, bootstrap

    def _judge(self, achieved: NDArray, goal: NDArray) -> _Judgement:
        """Reward and end by the environment's rule, called once per episode and pair of goals."""
        pair = achieved.tobytes(), goal.tobytes()
        if pair not in self._known:
            self._known[pair] = _Judgement(float(self._rule.compute_reward(achieved, goal, {})),
                                           bool(self._rule.compute_terminated(achieved, goal, {})))
        return self._known[pair]
