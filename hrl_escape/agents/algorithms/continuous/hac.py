"""HAC: every level learns as if the levels below were already optimal, with goals and actions in hindsight.

    Q_i(s, a; g) <- 0 if a reaches g, else -1 + gamma Q_i(s', mu_i(s'; g); g),    -H <= Q_i <= 0,    DDPG at every level

a is an action on the lowest level, and a goal for the level below on the others. Three kinds of transitions:

- hindsight actions: a missed goal is replaced by the point that was reached, as if it had been set;
- hindsight goals: the transitions of a call are stored again with goals that it reached later;
- subgoal tests: a share of the goals must be reached without exploration below; a miss is worth -H, without bootstrap.

Levy, Konidaris, Platt and Saenko (2019).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, RunningCall
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.goal_levels import GoalReader, RowReplay
from hrl_escape.agents.components.networks import Learner, is_goal_space, make_generator, make_network
from hrl_escape.agents.components.replay import UpdateSchedule, list_batch_sizes
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.state import Kept, Stateful
from hrl_escape.errors import AgentSettingsError, UnsupportedSpaceError
from hrl_escape.settings import Range

INITIAL_COST = 0.067
"""Size of the value of an untrained critic, as in the authors' program. Near 0 is optimistic."""


@dataclass(frozen=True, kw_only=True)
class HacSettings(AgentSettings):
    """Settings of `hac`. Actions and goals are scaled to [-1, 1], so noise is in these units."""

    gamma: Annotated[float, Range(0, 1)] = 0.95
    """Discount of each level per choice. It need not look further ahead than `attempts`."""
    levels: Annotated[int, Range(1, 5)] = 2
    """Number of levels; all but the lowest set goals. 1 is a flat agent with goals in hindsight."""
    attempts: Annotated[int, Range(2)] = 10
    """H, choices of a level for each of its goals. Together the levels look H^levels decisions ahead."""
    goal_tolerance: Annotated[float, Range(0, open_low=True)] = 0.45
    """Largest distance from a goal that counts as reached, in the unit of goals."""
    goal_tolerances: tuple[Annotated[float, Range(0, open_low=True)], ...] = ()
    """Largest difference from a goal in each component, where units differ. Replaces `goal_tolerance`."""
    subgoal_tests: Annotated[float, Range(0, 1)] = 0.3
    """Share of goals that are tested. More rules out goals beyond reach sooner and explores less; 0 turns tests off."""
    hindsight_goals: Annotated[int, Range(0)] = 3
    """Goals in hindsight for each transition of a call."""
    random_share: Annotated[float, Range(0, 1)] = 0.2
    """Share of choices that are uniform, outside tests."""
    noise: Annotated[float, Range(0)] = 0.1
    """Standard deviation of the noise on all other choices outside tests."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64, 64)
    """Units of each hidden layer, at every level."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform; or orthogonal, with tanh units."""
    scale_observations: bool = True
    """Map goals, and components of observations with finite bounds, to [-1, 1]."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator."""
    max_grad_norm: Annotated[float, Range(0)] = 0.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    warmup: Annotated[int, Range(0)] = 1_000
    """Primitives before the first update."""
    batch_size: Annotated[int, Range(1)] = 256
    """Transitions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 0.5
    """Updates of every level for each primitive."""
    max_updates: Annotated[int, Range(1)] = 8
    """Most updates after a step of many environments. Where more are due, minibatches grow instead."""
    max_batch_size: Annotated[int, Range(1)] = 1_024
    """Largest minibatch with many environments."""
    replay_capacity: Annotated[int, Range(1)] = 500_000
    """Transitions of each level kept for replay."""


def find_near(difference: Tensor, settings: HacSettings) -> Tensor:
    """Return where differences of points and goals (..., size) are within the tolerance, bool (...)."""
    if settings.goal_tolerances:
        return (difference.abs() <= difference.new_tensor(settings.goal_tolerances)).all(-1)
    return difference.norm(dim=-1) <= settings.goal_tolerance


class HacLevel(Stateful):
    """Actor and critic of a level: DDPG without target networks, with a critic between -H and 0.

    Args:
        name: in messages.
        goals: the goal space.
        choices: number of components of a choice.
        settings: of the agent.
        generator: draws the weights.
    """

    STATE = ("_actor_learner", "_critic_learner")

    def __init__(self, name: str, goals: GoalReader, choices: int, settings: HacSettings, generator: torch.Generator
                 ) -> None:
        self._settings, self.choices = settings, choices
        self._offset = -math.log(settings.attempts / INITIAL_COST - 1)
        extra = goals.size + goals.own_size - goals.encoder.shape[0]  # a level sees its goal, not the desired one
        self.actor = make_network(goals.encoder, choices, settings, generator, extra)
        self.critic = make_network(goals.encoder, 1, settings, generator, extra + choices)
        self._actor_learner = Learner(name, {"actor": self.actor}, ["actor"], settings)
        self._critic_learner = Learner(name, {"critic": self.critic}, ["critic"], settings)

    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""
        self._actor_learner.move(device)
        self._critic_learner.move(device)

    def choose(self, seen: Tensor) -> Tensor:
        """Return mu(s; g) in [-1, 1], (n, choices)."""
        return self.actor(seen).tanh()

    def compute_values(self, seen: Tensor, choice: Tensor) -> Tensor:
        """Return Q(s, a; g) between -H and 0, (n,). An untrained critic is near -`INITIAL_COST`."""
        outputs = self.critic(torch.cat((seen, choice), dim=1)).squeeze(1)
        return -self._settings.attempts * (outputs + self._offset).sigmoid()

    def update(self, drawn: Mapping[str, Tensor]) -> dict[str, float]:
        """Make one gradient step of critic and actor."""
        with torch.no_grad():
            after = self.compute_values(drawn["next_seen"], self.choose(drawn["next_seen"]))
            targets = (drawn["reward"] + drawn["bootstrap"] * after).clamp(-self._settings.attempts, 0)
        loss = functional.mse_loss(self.compute_values(drawn["seen"], drawn["choice"]), targets)
        metrics = {"loss": self._critic_learner.minimise(loss), "gradient_norm": self._critic_learner.gradient_norm}
        value = self.compute_values(drawn["seen"], self.choose(drawn["seen"])).mean()
        self._actor_learner.minimise(-value)
        return metrics


class Calls(Stateful):
    """Running calls of each environment, level by level from the lowest.

    Attributes:
        goal: of each level, (levels, environments, size); the highest level's is the environment's.
        count: finished choices of each level since it got its goal, int64 (levels, environments).
        is_over: levels that need a new goal, bool (levels, environments); at the top, an episode that begins.
    """

    STATE = ("goal", "count", "is_over")

    def __init__(self, settings: HacSettings, num_envs: int, size: int, device: torch.device) -> None:
        self._settings, shape = settings, (settings.levels, num_envs)
        self.goal = torch.zeros((*shape, size), device=device)
        self.count = torch.zeros(shape, dtype=torch.int64, device=device)
        self.is_over = torch.ones(shape, dtype=torch.bool, device=device)

    def set_goal(self, level: int, env: Tensor, goal: Tensor) -> None:
        """Give goals, (n, size), to a level in some environments."""
        self.goal[level, env], self.count[level, env], self.is_over[level, env] = goal, 0, False

    def find_reached(self, env: Tensor, point: Tensor) -> Tensor:
        """Return which levels' goals points (n, size) reach, bool (levels, n)."""
        return find_near(self.goal[:, env] - point, self._settings)

    def finish(self, env: Tensor, reached: Tensor, cut: Tensor) -> list[Tensor]:
        """Count the choices that ended with a decision of some environments; mark the calls that are over.

        A call is over after H choices, where its goal or a higher one is reached, or at the episode's end, if the call
        below is over.

        Args:
            env: int64 (n,).
            reached: bool (levels, n), goals reached after the decision.
            cut: bool (n,), the episode ended.

        Returns:
            The choices that ended at each level, bool (n,) each.
        """
        ended = [torch.ones_like(cut)]
        for level in range(self._settings.levels):
            self.count[level, env] += ended[level].long()
            is_full = self.count[level, env] >= self._settings.attempts
            self.is_over[level, env] = over = ended[level] & (is_full | reached[level:].any(0) | cut)
            ended.append(over)
        return ended[:-1]


class Hac(BatchAgent):
    """Hierarchical actor-critic; equation and transitions are in the module's text. Rewards are ignored.

    Attributes:
        goals: the goal space.
        levels: actors and critics, from the lowest level.
        calls: running calls.
        replays: transitions of each level, from the lowest.
    """

    settings: HacSettings
    acts_in = ("box",)
    is_markov = False
    STATE = ("levels", Kept("_schedule.steps", "steps"), Kept("_schedule._due", "updates_due"))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HacSettings | None = None) -> None:
        self.settings = settings = settings or HacSettings()
        self.box = BoxActions(action_space, self.name)
        if not is_goal_space(observation_space):
            raise UnsupportedSpaceError(f"{self.name} pursues the goal of the environment: it needs observations in a "
                                        f"Dict of observation, achieved_goal and desired_goal, not {observation_space}")
        self.goals = goals = GoalReader(observation_space, (), (), settings.scale_observations, self.name)
        if settings.goal_tolerances and len(settings.goal_tolerances) != goals.size:
            raise AgentSettingsError("goal_tolerances", settings.goal_tolerances, f"{goals.size} numbers, one for each "
                                     "component of a goal")
        self._goal_box = BoxActions(gymnasium.spaces.Box(goals.low.numpy(), goals.high.numpy()), self.name)
        generator = make_generator(make_rng(seed, "weights"))
        self.levels = [HacLevel(f"{self.name} level {level}", goals, goals.size if level else self.box.size, settings,
                                generator) for level in range(settings.levels)]
        self._schedule, self._seed = UpdateSchedule(settings.warmup, settings.updates_per_step), seed
        self.shown: tuple[RunningCall, ...] = ()
        self._prepare(1, None)

    def _prepare(self, num_envs: int, device: torch.device | None) -> None:
        self.place, settings, goals = (num_envs, device), self.settings, self.goals
        self._arrays = Arrays(make_rng(self._seed, "draws"), device or torch.device("cpu"))
        where, seen = self._arrays.device, goals.own_size + goals.size
        goals.move(where)
        self.calls = Calls(settings, num_envs, goals.size, where)
        self.replays = [RowReplay(settings.replay_capacity, {
            "seen": (seen,), "choice": (level.choices,), "reward": (), "bootstrap": (), "next_seen": (seen,)},
            self._arrays) for level in self.levels]
        shape = num_envs, settings.attempts
        self._tested = torch.zeros((settings.levels, num_envs), dtype=torch.bool, device=where)
        self._steps = [{name: torch.zeros((*shape, size), device=where) for name, size in (
            ("view", goals.own_size), ("choice", level.choices), ("point", goals.size), ("next_view", goals.own_size))}
            for level in self.levels]  # choices of the running call of each level

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; replay is kept if their number is unchanged."""
        if self.place == (num_envs, device):
            self.calls.is_over.fill_(True)
            return
        for level in self.levels:
            level.move(device or torch.device("cpu"))
        self._prepare(num_envs, device)

    def see(self, view: Tensor, goal: Tensor) -> Tensor:
        """Return inputs of a level, (..., numbers), from views without desired goal and goals (..., size)."""
        if self.settings.scale_observations:
            goal = self._goal_box.unscale(goal)
        return torch.cat((view, goal), dim=-1)

    # --- acting --------------------------------------------------------------------------

    def act(self, batch: Moments) -> Any:
        """Set goals where calls are over, from the top, and return actions, float32 (n, ...)."""
        view = self.goals.view(batch.observation)[:, : self.goals.own_size]
        env, calls = torch.as_tensor(batch.env), self.calls
        is_over = calls.is_over[:, env]
        if bool(is_over[-1].any()):
            calls.set_goal(-1, env[is_over[-1]], self.goals.find_desired(batch.observation)[is_over[-1]])
        for level in range(self.settings.levels - 1, 0, -1):
            rows = is_over[level - 1].nonzero().squeeze(1)
            if len(rows):
                unit = self._explore(level, env[rows], view[rows])
                calls.set_goal(level - 1, env[rows], self._goal_box.scale(unit))
        unit = self._explore(0, env, view)
        self.show(int(env[0]), calls)
        action = self.box.scale(unit)
        return action.numpy() if self.place[1] is None else action

    def _explore(self, level: int, env: Tensor, view: Tensor) -> Tensor:
        """Return choices of a level in some environments, without noise below a tested goal; maybe begin tests."""
        settings, draws, calls = self.settings, self._arrays.draw_uniform, self.calls
        with torch.no_grad():
            best = self.levels[level].choose(self.see(view, calls.goal[level, env]))
        is_tested = self._tested[level + 1:, env].any(0)
        noisy = (best + settings.noise * self._arrays.draw_normal(*best.shape)).clamp(-1, 1)
        uniform = 2 * draws(*best.shape) - 1
        free = torch.where((draws(len(env)) < settings.random_share)[:, None], uniform, noisy)
        unit = torch.where(is_tested[:, None], best, free)
        if level:
            self._tested[level, env] = ~is_tested & (draws(len(env)) < settings.subgoal_tests)
        steps, at = self._steps[level], (env, calls.count[level, env])
        steps["view"][at], steps["choice"][at] = view, unit
        return unit

    def show(self, env: int, calls: Calls) -> None:
        """Keep the goals of an environment for display, the highest first."""
        found = []
        for level in range(self.settings.levels - 1, -1, -1):
            goal = calls.goal[level, env].tolist()
            place = (goal[0], goal[1]) if len(goal) > 1 else None
            found.append(RunningCall(f"level {level}", tuple(round(each, 2) for each in goal),
                                     int(calls.count[level, env]), 0.0, place))
        self.shown = tuple(found)

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the goals behind the latest choice, with their first two components as place."""
        return self.shown

    def make_policy(self) -> Policy:
        """Make the policy of all actors without noise."""
        return CallPolicy(self)

    def choose_greedy(self, calls: Calls, env: Tensor, observation: Any) -> Tensor:
        """Set goals where calls are over, and return the best actions, float32 (n, ...)."""
        view, is_over = self.goals.view(observation)[:, : self.goals.own_size], calls.is_over[:, env]
        view = view.to(self.goals.low.device)
        with torch.no_grad():
            calls.set_goal(-1, env[is_over[-1]], self.goals.find_desired(observation).to(view.device)[is_over[-1]])
            for level in range(self.settings.levels - 1, 0, -1):
                unit = self.levels[level].choose(self.see(view, calls.goal[level, env]))
                rows = is_over[level - 1]
                calls.set_goal(level - 1, env[rows], self._goal_box.scale(unit)[rows])
            self.show(int(env[0]), calls)
            return self.box.scale(self.levels[0].choose(self.see(view, calls.goal[0, env])))

    # --- learning ------------------------------------------------------------------------

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store the transitions of all choices and calls that ended, then make the updates that are due."""
        settings, goals, calls = self.settings, self.goals, self.calls
        env, terminated = torch.as_tensor(batch.env), torch.as_tensor(batch.terminated)
        view, point = goals.view(batch.next_observation)[:, : goals.own_size], goals.project(batch.next_observation)
        cut = terminated | torch.as_tensor(batch.truncated)
        reached = calls.find_reached(env, point)
        reached[-1] |= terminated  # the environment says when its goal is reached
        goal, count = calls.goal[:, env].clone(), calls.count[:, env].clone()
        for level, ended in enumerate(calls.finish(env, reached, cut)):
            rows = ended.nonzero().squeeze(1)
            if not len(rows):
                break
            steps, at = self._steps[level], (env[rows], count[level, rows])
            if level:
                missed = ~reached[level - 1, rows]
                is_fair = missed & ~cut[rows] & ~reached[level:, rows].any(0)
                self._store_tests(level, env[rows], at, is_fair & self._tested[level, env[rows]], view[rows],
                                  goal[level, rows])
                there = torch.as_tensor(self._goal_box.unscale(point[rows]))
                steps["choice"][at] = torch.where(missed[:, None], there, steps["choice"][at])
                self._tested[level, env[rows]] = False
            steps["point"][at], steps["next_view"][at] = point[rows], view[rows]
            self._add(level, steps["view"][at], steps["choice"][at], view[rows], goal[level, rows],
                      reached[level, rows])
            over = calls.is_over[level, env[rows]]
            if bool(over.any()) and settings.hindsight_goals:
                self._replay_call(level, env[rows][over], count[level, rows][over] + 1)
        return self._update(int(batch.duration.sum()))

    def _add(self, level: int, view: Tensor, choice: Tensor, next_view: Tensor, goal: Tensor, reached: Tensor) -> None:
        """Store transitions: reward 0 and no bootstrap where the goal is reached, else -1 and gamma."""
        self.replays[level].add(seen=self.see(view, goal), choice=choice, reward=reached.float() - 1,
                                bootstrap=self.settings.gamma * ~reached, next_seen=self.see(next_view, goal))

    def _store_tests(self, level: int, env: Tensor, at: tuple[Tensor, Tensor], failed: Tensor, next_view: Tensor,
                     goal: Tensor) -> None:
        """Store the goals that a level set, was tested with and missed: worth -H."""
        if bool(failed.any()):
            steps = self._steps[level]
            worst = torch.full((int(failed.sum()),), -float(self.settings.attempts), device=env.device)
            self.replays[level].add(
                seen=self.see(steps["view"][at], goal)[failed], choice=steps["choice"][at][failed], reward=worst,
                bootstrap=torch.zeros_like(worst), next_seen=self.see(next_view, goal)[failed])

    def _replay_call(self, level: int, env: Tensor, length: Tensor) -> None:
        """Store the choices of finished calls again, with goals that they or later choices of the call reached."""
        steps, attempts = {name: rows[env] for name, rows in self._steps[level].items()}, self.settings.attempts
        place = torch.arange(attempts, device=env.device)
        call, number = (place < length[:, None]).nonzero(as_tuple=True)
        for _ in range(self.settings.hindsight_goals):
            later = number + (self._arrays.draw_uniform(len(number)) * (length[call] - number)).long()
            later = torch.minimum(later, length[call] - 1)
            goal, point = steps["point"][call, later], steps["point"][call, number]
            reached = find_near(goal - point, self.settings)
            self._add(level, steps["view"][call, number], steps["choice"][call, number],
                      steps["next_view"][call, number], goal, reached)

    def _update(self, primitives: int) -> dict[str, float]:
        settings, metrics = self.settings, {}
        due = self._schedule.advance(primitives, len(self.replays[-1]))
        for size in list_batch_sizes(settings, due, self.place[1] is not None):
            for number, (level, replay) in enumerate(zip(self.levels, self.replays, strict=True)):
                metrics |= {f"level_{number}_{name}": value for name, value in
                            level.update(replay.sample(size)).items()}
        return metrics

    def list_running(self) -> dict[str, Stateful]:
        """Return parts of the state for the present environments, by their names in a checkpoint."""
        return {"calls": self.calls, "draws": self._arrays, "running": _Running(self._tested, self._steps),
                **{f"replay_{level}": replay for level, replay in enumerate(self.replays)}}


class _Running(Stateful):
    """Choices of the running calls, and which goals are tested."""

    STATE = ("tested", "steps")

    def __init__(self, tested: Tensor, steps: list[dict[str, Tensor]]) -> None:
        self.tested = tested
        self.steps = {f"{level} {name}": rows for level, each in enumerate(steps) for name, rows in each.items()}


class CallPolicy(Policy):
    """All actors without noise, with calls that end as in learning."""

    is_markov = False

    def __init__(self, agent: Hac) -> None:
        self._agent = agent
        self.begin_episode(np.random.default_rng(0))

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Begin an episode in every environment. The policy is deterministic and ignores `rng`."""
        agent = self._agent
        self._calls = Calls(agent.settings, num_envs, agent.goals.size, agent.goals.low.device)
        self._has_acted = torch.zeros(num_envs, dtype=torch.bool, device=agent.goals.low.device)

    def act(self, batch: Moments) -> Any:
        """Return actions, float32 (n, ...)."""
        agent, calls = self._agent, self._calls
        point = agent.goals.project(batch.observation).to(agent.goals.low.device)
        env = torch.as_tensor(batch.env).to(point.device)
        if bool((known := self._has_acted[env]).any()):
            calls.finish(env[known], calls.find_reached(env, point)[:, known], torch.zeros_like(known[known]))
        self._has_acted[env] = True
        action = agent.choose_greedy(calls, env, batch.observation)
        return action if isinstance(batch.observation, Tensor) else action.cpu().numpy()
