"""One training run in many environments: segments of steps, their totals, and checkpoints of the running episodes.

Environments that can save their episodes are saved with the run at any time. All others begin their episodes again at
an evaluation, and the run is saved only there. Both resume to the same bits.

Vector environments of Gymnasium are adapted here, with each of the three kinds of automatic reset. The last state of an
episode is a decision's outcome, never the first observation of the next one. If the environment cannot save its
episodes, their actions are saved, and a resumed run replays them. To keep this short, all episodes begin again at the
first evaluation after `REMADE` actions.
"""

from __future__ import annotations

import ctypes
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces.utils import flatten
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import (
    SUCCESS_KEYS,
    Agent,
    check_observation,
    check_same_observations,
    count_choices,
    read_success_value,
    set_option_discount,
)
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.many_envs import (
    EndedDecisions,
    ManyEnvs,
    gather_decisions,
)
from hrl_escape.agents.registry import split_name
from hrl_escape.agents.single_env import serve_many
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.env_description import describe_many
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.run import NO_OPTIONS, Means, Reporter, Run, RunArguments
from hrl_escape.agents.training.run_folder import RunFolder
from hrl_escape.errors import CheckpointError, DiscountMismatchError, StepContractError, show_value
from hrl_escape.step_info import CHANGED, FLOAT32_ROUNDING

REMADE = 200_000
"""Most actions, of all environments together, that are saved in place of running episodes."""


class VectorManyEnvs:
    """Many environments of a vector environment, with one decision of each a step.

    `infos` can hold the keys that `make_transition` reads, as arrays: `action_mask`, and for decisions of several
    primitives `duration`, `discount`, `discounted_reward` and `summed_reward`; and `is_success`, else `success`, at the
    end of an episode. An array `_action_mask`, bool (environments,), and so on, marks the valid entries; in an
    environment without a mask every action is legal. Box actions have no mask. Observations with goals, a Dict, become
    rows in the order of its keys, as in `gymnasium.spaces.flatten`. Wrappers of the vector environment act on every
    step.

    Args:
        env: numpy arrays, or tensors, which stay on their device.
        gamma: discount of `discounted_reward`; set in environments of options.
    """

    def __init__(self, env: VectorEnv, gamma: float) -> None:
        self._env = env
        self.count, self.gamma = env.num_envs, gamma
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space
        self._actions = count_choices(self.action_space, "train")
        self._action_type = np.min_scalar_type(self._actions) if self._actions else np.dtype(np.float32)
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self.observation = self.action_mask = torch.empty(0)
        self._was_over = torch.zeros(self.count, dtype=torch.bool)
        self._gives_episodes = env is env.unwrapped and hasattr(env, "state_dict")  # wrappers can have a state, too
        self._made: list[NDArray[Any]] = []  # otherwise, actions of every step since `reset`, (envs, ...) each
        set_option_discount(env, gamma)

    @property
    def device(self) -> torch.device:
        """Device of the environment's tensors; the CPU for arrays."""
        return self.observation.device

    @property
    def is_waiting(self) -> Tensor:
        """Environments that do not reset in the next step, bool (environments,)."""
        return ~self._was_over

    def reset(self, seeds: int) -> None:
        """Begin all episodes again."""
        self._made = []
        observation, infos = self._env.reset(seed=seeds)
        self.observation = self._take(observation)
        self.action_mask = self._read_masks(infos, torch.ones((), dtype=torch.bool, device=self.device))
        self._was_over = torch.zeros(self.count, dtype=torch.bool, device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one decision in every environment, or the reset in its place."""
        before, where = self.observation, self.is_waiting
        if not self._gives_episodes and len(self._made) * self.count <= REMADE:
            self._made.append(action.cpu().numpy().astype(self._action_type))
        given = action if isinstance(before, Tensor) and self._gives_tensors else action.cpu().numpy()
        seen, reward, terminated, truncated, infos = self._env.step(given)
        paid = self._take(reward, torch.float64)
        every = torch.ones((), dtype=torch.bool, device=paid.device)
        now, mask = self._take(seen), self._read_masks(infos, every)
        terminated, truncated = self._take(terminated, torch.bool), self._take(truncated, torch.bool)
        over = (terminated | truncated) & where
        reached, reached_mask, final = now, mask, {}
        if self._mode == AutoresetMode.SAME_STEP and "final_obs" in infos:
            final = infos["final_info"]
            reached = self._replace(now, infos["final_obs"], over)
            reached_mask = torch.where(over[:, None], self._read_masks(final, every), mask)
        elif self._mode == AutoresetMode.DISABLED and bool(over.any()):
            begun, infos_begun = self._env.reset(options={"reset_mask": over if self._gives_tensors else
                                                          over.cpu().numpy()})
            now, mask = self._take(begun), torch.where(over[:, None], self._read_masks(infos_begun, over), mask)
        self.observation, self.action_mask = now, mask
        self._was_over = over if self._mode == AutoresetMode.NEXT_STEP else torch.zeros_like(over)
        duration, summed, discounted = self._read_rewards(paid, infos, final, where, over)
        success = self._read_success(final if self._mode == AutoresetMode.SAME_STEP else infos, over)
        return EndedDecisions(where, before, action, summed, discounted, duration, reached, reached_mask, terminated,
                          truncated, success)

    # --- what comes from the environment ---------------------------------------------------

    def _take(self, value: Any, dtype: torch.dtype | None = None) -> Tensor:
        if isinstance(value, Mapping):
            return torch.cat([self._take(part).flatten(1).float() for part in value.values()], dim=1)
        if isinstance(value, Tensor):
            self._gives_tensors = True
            return value if dtype is None else value.to(dtype)
        self._gives_tensors = False
        tensor = torch.tensor(np.asarray(value), dtype=dtype)
        if dtype is None and tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            check_observation(np.asarray(value), "of a step")
        return tensor

    def _replace(self, batch: Tensor, values: Any, where: Tensor) -> Tensor:
        """Copy of a batch with some rows of another, which can be an array of arrays and None."""
        rows = where.nonzero().squeeze(1)
        if isinstance(values, Mapping):
            new = self._take(values)[rows]
        elif isinstance(values, Tensor):
            new = values[rows]
        else:
            one, found = self.observation_space, [values[row] for row in rows.tolist()]
            has_parts = isinstance(one, gymnasium.spaces.Dict)
            new = torch.from_numpy(np.stack([
                np.asarray(flatten(one, each) if has_parts else each) for each in found]))
        return batch.index_copy(0, rows, new.to(self.device, batch.dtype))

    def _read(self, infos: Mapping[str, Any], name: str) -> tuple[Tensor, Tensor] | None:
        """Return the numbers of a key (environments, ...), and a mask of valid entries, bool (environments,).

        None if the key is absent or does not hold numbers.
        """
        given = infos.get(name)
        if given is None or isinstance(given, Mapping):
            return None
        if isinstance(given, Tensor):
            values = given
        else:
            array = _make_array(given)
            if array.dtype == object:
                rows = [None if row is None else _make_array(row) for row in array]
                shapes = {row.shape for row in rows if row is not None and row.dtype.kind in "biuf"}
                if len(shapes) != 1 or any(row is not None and row.dtype.kind not in "biuf" for row in rows):
                    return None
                empty, told = np.zeros(shapes.pop()), np.array([row is not None for row in rows])
                return (torch.from_numpy(np.stack([empty if row is None else row for row in rows])).to(self.device),
                        torch.from_numpy(told).to(self.device))
            if array.dtype.kind not in "biuf":
                return None
            values = torch.from_numpy(np.array(array))
        who = infos.get(f"_{name}")
        gives = torch.ones(self.count, dtype=torch.bool) if who is None else torch.as_tensor(who, dtype=torch.bool)
        return values.to(self.device), gives.to(self.device)

    def _read_masks(self, infos: Mapping[str, Any], rows: Tensor) -> Tensor:
        """Return the legal actions, bool (environments, actions); all actions if an environment has no mask.

        Args:
            infos: of a step, a reset, or the ends of episodes.
            rows: the environments whose masks are checked, bool (environments,) or ().
        """
        found = self._read(infos, "action_mask") if self._actions else None
        if found is None:
            told = infos.get("action_mask")
            if self._actions and told is not None and not all(row is None for row in told):
                raise StepContractError(f"infos['action_mask'] is {show_value(told)}; it must have a "
                                        "number for each action of each environment")
            return torch.ones((self.count, self._actions), dtype=torch.bool, device=self.device)
        given, gives = found
        if given.shape != (self.count, self._actions):
            raise StepContractError(f"infos['action_mask'] has shape {tuple(given.shape)}; {self.count} environments "
                                    f"of {self._actions} actions need ({self.count}, {self._actions})")
        mask = (given != 0) | ~gives[:, None]
        if mask.device.type == "cpu" and not bool((mask.any(dim=1) | ~rows).all()):
            raise StepContractError("infos['action_mask'] is all zero for an environment: at least one action must "
                                    "always be legal")
        return mask

    def _read_rewards(self, paid: Tensor, infos: Mapping[str, Any], final: Mapping[str, Any], where: Tensor,
                      over: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Duration k, sum of rewards and R of each environment's decision; see `read_payment`.

        `final` holds the values of decisions that ended an episode.
        """
        if paid.shape != (self.count,):
            raise StepContractError(f"rewards have shape {tuple(paid.shape)}; {self.count} environments need one "
                                    "number each. For several rewards, weigh them in a wrapper below")
        if paid.device.type == "cpu" and not bool((paid.isfinite() | ~where).all()):
            raise StepContractError(f"a reward is {float(paid[where & ~paid.isfinite()][0])}; rewards must be finite "
                                    "numbers")
        duration = torch.ones(self.count, dtype=torch.int64, device=paid.device)
        summed = discounted = paid.double()
        for source, rows in ((infos, where & ~over if final else where), (final, where & over)):
            if (found := self._read(source, "duration")) is None or found[0].dtype.is_floating_point:
                continue
            given, gives = found
            rows = rows & gives
            parts = [self._read(source, name) for name in ("discounted_reward", "discount", "summed_reward")]
            owned = rows
            for part in parts[:2]:
                owned = owned & part[1] if part is not None else torch.zeros_like(owned)
            if bool((rows & ~owned & (given != 1)).any()):
                raise StepContractError(
                    f"infos['duration'] is {given[rows & ~owned].tolist()}, but infos has no 'discounted_reward' with "
                    "'discount', so the discounted rewards of these decisions are unknown. Add them; if the "
                    "environments mean something else by 'duration', rename the key in a wrapper")
            if not bool(owned.any()):
                continue
            if bool((owned & (given < 1)).any()):
                raise StepContractError(f"decisions took {given[owned].tolist()} primitives; every action must cost at "
                                        "least one, or be masked")
            duration = torch.where(owned, given.to(torch.int64), duration)
            summed, discounted = self._check_rewards(paid, summed, discounted, duration, owned, parts)
        return duration, summed.float(), discounted.float()

    def _check_rewards(self, paid: Tensor, summed: Tensor, discounted: Tensor, duration: Tensor, rows: Tensor,
                       parts: Sequence[tuple[Tensor, Tensor] | None]) -> tuple[Tensor, Tensor]:
        """Insert the sums of decisions in some rows, and check that rewards equal one of the two."""
        (of_r, _), (of_gamma, _) = (part for part in parts[:2] if part is not None)
        power = torch.as_tensor(self.gamma, dtype=torch.float64, device=paid.device) ** duration
        rounding = FLOAT32_ROUNDING * duration
        wrong = rows & (duration > 1) & ((of_gamma.double() - power).abs() > rounding * power + 1e-12)
        if bool(wrong.any()):
            row = int(wrong.nonzero()[0])
            raise DiscountMismatchError(self.gamma, float(of_gamma[row]), int(duration[row]))
        discounted = torch.where(rows, of_r.double(), discounted)
        is_paid = self._is_same(paid, discounted, rounding)
        if parts[2] is None:
            is_paid |= duration > 1
        else:
            summed = torch.where(rows & parts[2][1], parts[2][0].double(), summed)
            is_paid |= self._is_same(paid, summed, rounding)
        if bool((changed := rows & ~is_paid).any()):
            row = int(changed.nonzero()[0])
            paid_in_sum = summed if parts[2] is not None else discounted
            raise StepContractError(CHANGED.format(where=f"of environment {row}", reward=float(paid[row]),
                                                   summed=float(paid_in_sum[row])))
        return summed, discounted

    @staticmethod
    def _is_same(reward: Tensor, paid: Tensor, rounding: Tensor) -> Tensor:
        return (reward.double() - paid).abs() <= rounding * paid.abs()

    def _read_success(self, infos: Mapping[str, Any], over: Tensor) -> Tensor:
        """Success of each environment whose episode ended, see `read_success`, int8 (environments,); -1 for None.

        `infos` holds the infos of their last steps.
        """
        success = torch.full_like(over, -1, dtype=torch.int8)
        for name in reversed(SUCCESS_KEYS):
            if name not in infos:
                continue
            values, given = infos[name], infos.get(f"_{name}")
            if isinstance(values, Tensor):
                shown = over if given is None else over & torch.as_tensor(given, device=self.device)
                if values.dtype != torch.bool:
                    for value in values[shown].tolist():
                        read_success_value(name, value)
                success = torch.where(shown, values.to(self.device, torch.int8), success)
                continue
            for stream in over.nonzero().squeeze(1).tolist():
                if (given is None or given[stream]) and values[stream] is not None:
                    success[stream] = read_success_value(name, values[stream])
        return success

    # --- checkpoints -----------------------------------------------------------------------

    def state_dict(self) -> StateTree | None:
        """Running episodes, or the actions that led to them, or None after too many actions."""
        env: Any = self._env.unwrapped
        if self._gives_episodes:
            return {"env": dict(env.state_dict()), "observation": self.observation, "action_mask": self.action_mask,
                    "was_over": self._was_over}
        if len(self._made) * self.count > REMADE:
            return None
        return {"made": np.array(self._made, self._action_type).reshape(-1, self.count, *self.action_space.shape or ()),
                "observation": self.observation}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the state of `state_dict` after a `reset` with the same seeds, or raise `CheckpointError`."""
        env: Any = self._env.unwrapped
        if self._gives_episodes:
            env.load_state_dict(state["env"])
            self.observation, self.action_mask, self._was_over = (
                torch.from_numpy(np.array(state[name])).to(self.device)
                for name in ("observation", "action_mask", "was_over"))
            return
        for actions in np.asarray(state["made"]):
            self.step(torch.from_numpy(actions.astype(np.int64 if self._actions else np.float32)).to(self.device))
        if not np.array_equal(self.observation.cpu().numpy(), np.asarray(state["observation"]), equal_nan=True):
            raise CheckpointError("the environments are not deterministic: a replay of seeds and actions differs")


def _make_array(value: Any) -> NDArray[Any]:
    """An array of a value; an empty one of objects where rows differ in length."""
    try:
        return np.asarray(value)
    except ValueError:
        return np.empty(0, object)


def make_many_envs(env: VectorEnv | ManyEnvs, gamma: float) -> ManyEnvs:
    """The many environments of a vector environment: its own, or one decision of each a step; others do not change.

    A wrapped vector environment is stepped through its wrappers, all decisions side by side, even if the environment
    inside is a `ManyEnvs` itself.
    """
    inner: Any = env
    if isinstance(env, VectorEnv) and not (env is env.unwrapped and hasattr(env, "get_many_envs")):
        return VectorManyEnvs(env, gamma)
    streams = inner.get_many_envs() if isinstance(env, VectorEnv) else env
    set_option_discount(streams, gamma)
    return streams


SEGMENT_PRIMITIVES, SEGMENT_STEPS = 16_384, 16
"""Size of a segment, a row of the log: primitives of all environments together, and fewest steps."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_KEPT = 1 << 30  # bytes


class ManyEnvsRun(Run):
    """A run in units of segments: a fixed number of steps of all environments."""

    def __init__(self, agent: Agent, env: VectorEnv | ManyEnvs, eval_env: gymnasium.Env, arguments: RunArguments,
                 callbacks: Sequence[Callback] = ()) -> None:
        super().__init__(agent, eval_env, eval_env, arguments, callbacks=callbacks)
        keep_freed_memory()
        self._source, self._begun = env, 0
        self.streams = streams = make_many_envs(env, agent.gamma)
        check_same_observations(streams.observation_space, eval_env.observation_space)
        self._steps = max(SEGMENT_STEPS, SEGMENT_PRIMITIVES // streams.count)
        self._server = serve_many(agent)
        self._begin()

    @property
    def identity(self) -> dict[str, Any]:
        """Identity of the environments and the evaluation environment, which represents them in a loaded run."""
        return super().identity | {"streams": describe_many(self._source)}

    def _begin(self) -> None:
        self._begun += 1
        self._reset_streams()
        self._server.begin_episodes(self.streams.count, self.streams.device)

    def _reset_streams(self) -> None:
        self.streams.reset(compute_episode_seed(self.arguments.seed, "streams", self._begun))
        self._tally = _Tally(self.streams.count, self.streams.device)
        space, is_box = self.streams.action_space, isinstance(self.streams.action_space, gymnasium.spaces.Box)
        self._no_actions = torch.zeros((self.streams.count, *space.shape), device=self.streams.device,
                                       dtype=torch.float32 if is_box else torch.int64)
        self._masks = self.streams.action_mask.clone()  # legal at each environment's present decision
        self._is_fresh = True

    @property
    def can_be_saved(self) -> bool:
        """True if environments can save their episodes, or all episodes have just begun again, or the run is over."""
        return self._is_fresh or self.is_over or self.streams.state_dict() is not None

    def _evaluate(self, folder: RunFolder | None) -> None:
        super()._evaluate(folder)
        if self.decisions and not self.is_over and self.streams.state_dict() is None:
            self._begin()

    def run_unit(self, report: Reporter) -> dict[str, Any]:
        """Train for one segment; returns its row of the log."""
        started = time.perf_counter()
        streams, agent, tally, masks = self.streams, self._server, self._tally, self._masks
        before, words = self.primitives, self.describe_returns()
        self._is_fresh, means = False, Means()
        for _ in range(self._steps):
            if self.is_spent:
                break
            asking = streams.is_waiting.nonzero().squeeze(1)
            action = self._no_actions.clone()
            masks[asking] = streams.action_mask[asking]
            if len(asking):  # after episodes that end together, Gymnasium's environments reset together
                action[asking] = agent.act(Moments(asking, streams.observation[asking], masks[asking]))
            ended = streams.step(action)
            decisions = gather_decisions(ended, masks, streams.gamma, self.agent.gamma)
            if len(decisions.env):
                means.note(agent.observe(decisions))
            self.primitives += tally.add(decisions, ended.success[decisions.env])
            self.decisions += len(decisions.env)
            report(self.primitives, words)
        if self.primitives == self.decisions and before == 0 and split_name(self.arguments.name)[1]:
            warnings.warn(NO_OPTIONS.format(name=self.arguments.name), stacklevel=2)
        return self.end_segment(tally.take_row(), means, started, before)

    def state_dict(self) -> StateTree:
        """Environments and their sums, in addition to the agent and the totals."""
        return super().state_dict() | {"streams": None if self.is_over else self.streams.state_dict(),
                                       "begun": self._begun, "tally": self._tally.state_dict(),
                                       "masks": self._masks.cpu().numpy()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the state of `state_dict`."""
        super().load_state_dict(state)
        self._begun = int(state["begun"])
        self._reset_streams()
        if state["streams"] is not None:
            try:
                self.streams.load_state_dict(state["streams"])
            except CheckpointError as error:
                warnings.warn(f"{error}: all episodes begin again, so the run does not resume to the same bits",
                              stacklevel=2)
                self._begin()
                return
            self._tally.load_state_dict(state["tally"])
            self._masks = torch.from_numpy(np.array(state["masks"])).to(self.streams.device)


class _Tally(Stateful):
    """Returns and lengths of running episodes, and sums over those that ended, on the device.

    The sums are empty between segments, so the state is the state of the running episodes.
    """

    STATE = ("_running",)

    def __init__(self, count: int, device: torch.device) -> None:
        self._running = torch.zeros((2, count), dtype=torch.float64, device=device)  # return and length so far
        self._sums = torch.zeros(5, dtype=torch.float64, device=device)
        """Returns, lengths, successes, episodes, and episodes that report their success."""

    def add(self, decisions: Decisions, success: Tensor) -> int:
        """Add decisions; returns the primitives that ran. `success`, (n,), is as in `EndedDecisions`."""
        row = torch.stack((decisions.summed_reward.double(), decisions.duration.double()))
        running = self._running[:, decisions.env] + row
        over = decisions.terminated | decisions.truncated
        self._running[:, decisions.env] = torch.where(over, 0.0, running)
        counts = (success == 1, torch.ones_like(over), success >= 0)
        ended = torch.stack((*running, *(count.double() for count in counts)))
        self._sums += torch.where(over, ended, 0.0).sum(dim=1)
        return int(decisions.duration.sum())

    def take_row(self) -> dict[str, Any]:
        """Logged numbers of the episodes that ended since the last call."""
        returns, lengths, successes, episodes, reported = self._sums.tolist()
        self._sums.zero_()
        return {"train/episodes": int(episodes), "train/successes": int(successes) if reported else None,
                "train/return": returns / episodes if episodes else None,
                "train/length": lengths / episodes if episodes else None}


def keep_freed_memory() -> None:
    """Let this process keep up to 1 GiB of freed memory for the next block of its size.

    glibc gives blocks of some megabytes back to the system when they are freed, and each minibatch of many environments
    would pay for fresh, zeroed pages. Results do not depend on it. Other C libraries are left alone.
    """
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(_MMAP_THRESHOLD, _KEPT)
        set_option(_TRIM_THRESHOLD, _KEPT)
