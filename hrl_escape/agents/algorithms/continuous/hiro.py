"""HIRO: a manager that sets displacements as goals for a worker, both TD3, with old goals relabelled.

    worker:   r = -|s + g - s'|,  g' = h(s, g, s') = s + g - s',  TD3 on ((s, g), a, r, (s', g'))
    manager:  every c decisions, TD3 on (s_t, g~, sum of rewards, s_{t+c})
    g~ = argmax over ten candidates g of -1/2 sum over the window of |a_i - mu(s_i, g_i)|^2,
         g_{i+1} = h(s_i, g_i, s_{i+1})

s in these equations is the point of an observation in the goal space. The candidates are the goal that was set, the
displacement that happened, and eight draws around it. Nachum, Gu, Lee and Levine (2018).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.agent import AgentSettings, RunningCall
from hrl_escape.agents.algorithms.continuous.td3 import TwinDelayed
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.goal_levels import GoalReader, RowReplay
from hrl_escape.agents.components.networks import make_generator, make_network
from hrl_escape.agents.components.replay import UpdateSchedule, list_batch_sizes
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.state import Kept, Stateful
from hrl_escape.settings import Range

CANDIDATES = 8
"""Goals drawn around the displacement of a window, in addition to the two fixed candidates."""


@dataclass(frozen=True, kw_only=True)
class HiroSettings(AgentSettings):
    """Settings of `hiro`. Actions, and goals over `goal_range`, are in [-1, 1], so noise is in these units."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount of the manager, by `discounting`. Higher values look further ahead and learn more slowly."""
    discounting: Literal["decision", "primitive"] = "decision"
    """`decision` sums the rewards of a window and discounts once per window, as the paper does. `primitive` discounts
    k primitives by gamma^k."""
    worker_gamma: Annotated[float, Range(0, 1)] = 0.95
    """Discount of the worker per decision. It needs to look ahead for one window."""
    window: Annotated[int, Range(1)] = 10
    """c, decisions of the worker for each goal. Longer windows leave fewer, longer decisions to the manager."""
    goal_columns: tuple[Annotated[int, Range(0)], ...] = (0, 1)
    """Components of the observation that goals set, such as x and y. Observations with goals use `achieved_goal`."""
    goal_range: tuple[float, ...] = ()
    """Largest size of each component of a goal, in its unit; by default a quarter of the width between the bounds.
    Choose how far the worker gets in a window."""
    correction: bool = True
    """Relabel old goals for the current worker; otherwise they stay as they were set."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (256, 256)
    """Units of each hidden layer, at both levels."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform; or orthogonal, with tanh units."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the manager's rewards. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator."""
    max_grad_norm: Annotated[float, Range(0)] = 0.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.05
    """Share of the online networks blended into the targets. Smaller rates are slower and more stable. The paper's
    0.005 suits the millions of updates of one environment, not the few of many environments."""
    manager_noise: Annotated[float, Range(0)] = 0.2
    """Standard deviation of the noise on goals. More explores more."""
    worker_noise: Annotated[float, Range(0)] = 0.2
    """Standard deviation of the noise on actions."""
    target_noise: Annotated[float, Range(0)] = 0.2
    """Standard deviation of the noise on target actions, at both levels."""
    target_noise_clip: Annotated[float, Range(0)] = 0.5
    """Bound on that noise."""
    policy_delay: Annotated[int, Range(1)] = 2
    """Critic updates for each update of actor and targets."""
    warmup: Annotated[int, Range(0)] = 1_000
    """Primitives with random goals and actions, and without updates."""
    batch_size: Annotated[int, Range(1)] = 128
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 1.0
    """Worker updates for each primitive; the manager makes one for every `window` of them."""
    max_updates: Annotated[int, Range(1)] = 8
    """Most updates of each level after a step of many environments. Where more are due, minibatches grow instead."""
    max_batch_size: Annotated[int, Range(1)] = 1_024
    """Largest minibatch with many environments."""
    replay_capacity: Annotated[int, Range(1)] = 200_000
    """Decisions of the worker kept for replay; the manager keeps one for every `window` of them."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions of the worker."""


class Windows(Stateful):
    """The running window of each environment: its goal, and what the worker saw and did.

    Attributes:
        goal: relative to the present point, (environments, size).
        length: decisions so far, 0 where a goal has to be chosen, int64 (environments,).
    """

    STATE = ("goal", "length", "start", "first", "reward", "discount", "views", "points", "actions")

    def __init__(self, num_envs: int, window: int, goals: GoalReader, actions: int, device: torch.device) -> None:
        def zeros(*shape: int) -> Tensor:
            return torch.zeros((num_envs, *shape), device=device)

        self.goal, self.length = zeros(goals.size), zeros().long()
        self.start, self.first = zeros(*goals.encoder.shape), zeros(goals.size)  # view and goal at its beginning
        self.reward, self.discount = zeros(), zeros()
        self.views, self.actions = zeros(window, goals.own_size), zeros(window, actions)
        self.points = zeros(window + 1, goals.size)

    def begin(self, env: Tensor, view: Tensor, goal: Tensor) -> None:
        """Begin windows of some environments with goals, (n, size)."""
        self.goal[env], self.first[env], self.start[env] = goal, goal, view
        self.length[env], self.reward[env], self.discount[env] = 0, 0.0, 1.0
        self.actions[env], self.views[env], self.points[env] = 0.0, 0.0, 0.0


class Hiro(BatchAgent):
    """Two levels of TD3 with continuous goals; the equations are in the module's text.

    Attributes:
        goals: the goal space.
        manager: chooses goals over `goals.range`.
        worker: chooses actions from what it sees without the desired goal, and a goal.
        windows: running windows.
        manager_replay: windows of the manager with what the worker did.
        worker_replay: decisions of the worker.
    """

    settings: Any
    Settings = HiroSettings
    acts_in = ("box",)
    is_markov = False
    privileges = ("goal space",)
    STATE = ("manager", "worker", Kept("_schedule.steps", "steps"), Kept("_schedule._due", "updates_due"),
             "_manager_due")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HiroSettings | None = None) -> None:
        chosen: HiroSettings = settings or self.Settings()
        self.settings = settings = chosen
        self.box = BoxActions(action_space, self.name)
        self.goals = goals = GoalReader(observation_space, settings.goal_columns, settings.goal_range,
                                        settings.scale_observations, self.name)
        generator, size = make_generator(make_rng(seed, "weights")), goals.size
        extra = size + goals.own_size - goals.encoder.shape[0]  # the worker sees its goal in place of the desired one
        self.manager = TwinDelayed(f"{self.name} manager", lambda outputs, more: make_network(
            goals.encoder, outputs, settings, generator, more), size, settings, seed)
        self.worker = TwinDelayed(f"{self.name} worker", lambda outputs, more: make_network(
            goals.encoder, outputs, settings, generator, more + extra), self.box.size, settings, seed)
        self._schedule = UpdateSchedule(settings.warmup, settings.updates_per_step)
        self._manager_due, self._seed = 0.0, seed
        self.shown: tuple[RunningCall, ...] = ()
        self._prepare(1, None)

    def _prepare(self, num_envs: int, device: torch.device | None) -> None:
        self.place, settings, goals = (num_envs, device), self.settings, self.goals
        self._arrays = Arrays(make_rng(self._seed, "draws"), device or torch.device("cpu"))
        where, actions, window = self._arrays.device, self.box.size, settings.window
        goals.move(where)
        self.windows = Windows(num_envs, window, goals, actions, where)
        seen = goals.own_size + goals.size
        capacity = max(settings.replay_capacity, settings.replay_per_env * num_envs if device is not None else 1)
        self.worker_replay = RowReplay(capacity, {
            "seen": (seen,), "action": (actions,), "reward": (), "bootstrap": (), "next_seen": (seen,)}, self._arrays)
        whole = goals.encoder.shape
        self.manager_replay = RowReplay(max(capacity // window, 2), {
            "seen": whole, "goal": (goals.size,), "reward": (), "bootstrap": (), "next_seen": whole,
            "views": (window, goals.own_size), "actions": (window, actions), "points": (window + 1, goals.size),
            "length": ()}, self._arrays)

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; replay is kept if their number is unchanged."""
        if self.place == (num_envs, device):
            self.windows.length.zero_()
            return
        self.manager.move(device or torch.device("cpu"))
        self.worker.move(device or torch.device("cpu"))
        self._prepare(num_envs, device)

    # --- acting --------------------------------------------------------------------------

    def join(self, view: Tensor, goal: Tensor) -> Tensor:
        """Return inputs of the worker, (..., numbers), from views without desired goal and goals (..., size)."""
        return torch.cat((view, goal / self.goals.range), dim=-1)

    def act(self, batch: Moments) -> Any:
        """Set goals where windows begin, and return actions towards the goals, float32 (n, ...)."""
        view, point = self.goals.view(batch.observation), self.goals.project(batch.observation)
        env, windows, settings = torch.as_tensor(batch.env), self.windows, self.settings
        is_new = windows.length[env] == 0
        if bool(is_new.any()):
            rows = is_new.nonzero().squeeze(1)
            unit = self._explore(self.manager, view[rows], settings.manager_noise)
            windows.begin(env[rows], view[rows], unit * self.goals.range)
        own = view[:, : self.goals.own_size]
        unit = self._explore(self.worker, self.join(own, windows.goal[env]), settings.worker_noise)
        at = env, windows.length[env]
        windows.views[at], windows.points[at], windows.actions[at] = own, point, unit
        self.show(point[0], windows.goal[env[0]], int(windows.length[env[0]]))
        action = self.box.scale(unit)
        return action.numpy() if self.place[1] is None else action

    def _explore(self, level: TwinDelayed, seen: Tensor, noise: float) -> Tensor:
        """Points of a level's actor with noise; random points during the warm-up."""
        if not self._schedule.is_warm:
            return 2 * self._arrays.draw_uniform(len(seen), level.size) - 1
        points = level.evaluate(seen)
        return (points + noise * self._arrays.draw_normal(*points.shape)).clamp(-1, 1)

    def show(self, point: Tensor, goal: Tensor, length: int) -> None:
        """Keep the place of a goal for display."""
        target = (point + goal).tolist()
        place = (target[0], target[1]) if len(target) > 1 else None
        self.shown = (RunningCall("goal", tuple(round(each, 2) for each in target), length,
                                  float(length + 1 >= self.settings.window), place),)

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the goal behind the latest choice, with its place: the first two components of the goal space."""
        return self.shown

    def make_policy(self) -> Policy:
        """Make the policy of both actors without noise."""
        return GoalPolicy(self)

    # --- learning ------------------------------------------------------------------------

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store decisions of the worker and windows that end, then make the updates that are due."""
        settings, goals, windows = self.settings, self.goals, self.windows
        env, duration = torch.as_tensor(batch.env), torch.as_tensor(batch.duration)
        next_view, next_point = goals.view(batch.next_observation), goals.project(batch.next_observation)
        terminated, truncated = torch.as_tensor(batch.terminated), torch.as_tensor(batch.truncated)
        at = env, windows.length[env]
        goal = windows.goal[env]
        left = windows.points[at] + goal - next_point
        self.worker_replay.add(
            seen=self.join(windows.views[at], goal), action=windows.actions[at],
            reward=-(left / goals.range).norm(dim=1),
            bootstrap=settings.worker_gamma ** duration.float() * ~terminated,
            next_seen=self.join(next_view[:, : goals.own_size], left))
        is_sum = settings.discounting == "decision"
        reward = torch.as_tensor(batch.summed_reward if is_sum else batch.reward)
        windows.reward[env] += windows.discount[env] * reward
        if not is_sum:
            windows.discount[env] *= torch.as_tensor(batch.discount)
        windows.length[env] += 1
        windows.goal[env], windows.points[env, windows.length[env]] = left, next_point
        over = (windows.length[env] == settings.window) | terminated | truncated
        if bool(over.any()):
            ended = env[over]
            factor = settings.gamma if is_sum else windows.discount[ended]
            self.store_windows(
                seen=windows.start[ended], goal=windows.first[ended],
                reward=windows.reward[ended] * settings.reward_scale, bootstrap=factor * ~terminated[over],
                next_seen=next_view[over], views=windows.views[ended], actions=windows.actions[ended],
                points=windows.points[ended], length=windows.length[ended])
            windows.length[ended] = 0
        return self._update(int(duration.sum()))

    def _update(self, primitives: int) -> dict[str, float]:
        settings, is_many, metrics = self.settings, self.place[1] is not None, {}
        due = self._schedule.advance(primitives, len(self.worker_replay))
        for size in list_batch_sizes(settings, due, is_many):
            drawn = self.worker_replay.sample(size)
            found = self.worker.update(drawn["seen"], drawn["action"], drawn["reward"], drawn["bootstrap"],
                                       drawn["next_seen"])
            metrics |= {f"worker_{name}": value for name, value in found.items()}
        self._manager_due += due / settings.window
        due = int(self._manager_due) if len(self.manager_replay) else 0
        self._manager_due -= due
        for size in list_batch_sizes(settings, due, is_many):
            found = self.update_manager(self.manager_replay.sample(size))
            metrics |= {f"manager_{name}": value for name, value in found.items()}
        return metrics

    def store_windows(self, **rows: Tensor) -> None:
        """Store windows that ended, (n, ...) each, for the manager."""
        self.manager_replay.add(**rows)

    def update_manager(self, drawn: Mapping[str, Tensor]) -> dict[str, float]:
        """Make one update of the manager from windows with relabelled goals."""
        goal, penalise = self.relabel(drawn) if self.settings.correction else drawn["goal"], self.find_penalty(drawn)
        return self.manager.update(drawn["seen"], (goal / self.goals.range).clamp(-1, 1), drawn["reward"],
                                   drawn["bootstrap"], drawn["next_seen"], penalise)

    def find_penalty(self, drawn: Mapping[str, Tensor]) -> Callable[[Tensor], Tensor] | None:
        """Return an additional loss of the manager's actor as a function of its choices, or None: HIRO has none."""
        return None

    def compute_likelihoods(self, drawn: Mapping[str, Tensor], candidates: Tensor) -> Tensor:
        """Return -1/2 sum over each window of |a_i - mu(s_i, g_i)|^2, (n, candidates) from goals (n, candidates, size).

        The sum is over the states where actions were chosen; the state at the end of a window is not one.
        """
        views, points, actions = drawn["views"], drawn["points"], drawn["actions"]
        goals = candidates[:, :, None] + (points[:, :1] - points[:, :-1])[:, None]
        views = views[:, None].expand(-1, candidates.shape[1], -1, -1)
        chosen = self.worker.evaluate(self.join(views, goals).flatten(0, 2)).view(*goals.shape[:3], -1)
        errors = ((chosen - actions[:, None]) ** 2).sum(-1)
        is_real = torch.arange(views.shape[2], device=views.device) < drawn["length"][:, None]
        return -0.5 * (errors * is_real[:, None]).sum(-1)

    def relabel(self, drawn: Mapping[str, Tensor]) -> Tensor:
        """Return the goals that windows are learned with, (n, size)."""
        points, rows = drawn["points"], torch.arange(len(drawn["goal"]), device=drawn["goal"].device)
        moved = (points[rows, drawn["length"].long()] - points[:, 0])[:, None]
        noise = self._arrays.draw_normal(len(rows), CANDIDATES, self.goals.size) * self.goals.range / 2
        around = torch.cat((moved, moved + noise), dim=1).clamp(-self.goals.range, self.goals.range)
        candidates = torch.cat((drawn["goal"][:, None], around), dim=1)
        return candidates[rows, self.compute_likelihoods(drawn, candidates).argmax(1)]

    def list_running(self) -> dict[str, Stateful]:
        """Return parts of the state for the present environments, by their names in a checkpoint."""
        return {"windows": self.windows, "manager_replay": self.manager_replay, "worker_replay": self.worker_replay,
                "draws": self._arrays}


class GoalPolicy(Policy):
    """Both actors without noise: a new goal every window, which is advanced as its environment moves."""

    is_markov = False

    def __init__(self, agent: Hiro) -> None:
        self._agent = agent
        self.begin_episode(np.random.default_rng(0))

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Begin an episode in every environment. The policy is deterministic and ignores `rng`."""
        size, device = self._agent.goals.size, self._agent.goals.range.device
        self._goal, self._point = (torch.zeros((num_envs, size), device=device) for _ in range(2))
        self._length = torch.zeros(num_envs, dtype=torch.int64, device=device)

    def act(self, batch: Moments) -> Any:
        """Return actions, float32 (n, ...)."""
        agent, goals = self._agent, self._agent.goals
        is_array = not isinstance(batch.observation, Tensor)
        view, point = (part.to(goals.range.device) for part in (goals.view(batch.observation),
                                                                goals.project(batch.observation)))
        env = torch.as_tensor(batch.env).to(point.device)
        goal = self._goal[env] + self._point[env] - point
        is_new = self._length[env] % agent.settings.window == 0
        if bool(is_new.any()):
            goal[is_new] = agent.manager.evaluate(view[is_new]) * goals.range
        agent.show(point[0], goal[0], int(self._length[env[0]]) % agent.settings.window)
        self._goal[env], self._point[env] = goal, point
        self._length[env] += 1
        action = agent.box.scale(agent.worker.evaluate(agent.join(view[:, : goals.own_size], goal)))
        return action.cpu().numpy() if is_array else action
