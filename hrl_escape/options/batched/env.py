"""`BatchedOptionsEnv`: thousands of rooms in which decisions of different durations run side by side.

Every step runs one primitive in every room and hands over the decisions that ended with it,
with the SMDP fields of `OptionsEnv`; a room whose decision has ended takes its next one at once and waits
for nobody. The rules are the batched engine's; what happens in a step is `stepping.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from hrl_escape.env.config import RoomConfig
from hrl_escape.env.primitives import make_primitives
from hrl_escape.env.tensor_instances import InstanceSource, Layout, Tables, collect_instances, map_tensors
from hrl_escape.env.tensor_observations import compute_bounds
from hrl_escape.env.tensor_poses import TensorState
from hrl_escape.env.tensor_room import TensorRoom, check_compiler, compile_step, list_shapes
from hrl_escape.errors import ActionError, BatchError, ConfigError, ResetNeededError
from hrl_escape.options.batched.decisions import ENDINGS, Decisions, Running
from hrl_escape.options.batched.planning import Guide
from hrl_escape.options.batched.prices import Prices, stack_prices
from hrl_escape.options.batched.stepping import PATIENCE, STUCK, Settings, Shown, advance, begin, make_running, show

__all__ = ["ENDINGS", "BatchedOptionsEnv", "Decisions"]

Kernel: TypeAlias = Callable[[Tables, Prices | None, TensorState, Running, Shown, Tensor],
                             tuple[TensorState, Running, Shown, Decisions]]


class BatchedOptionsEnv:
    """Many rooms whose robots choose among options and primitives, each at its own pace.

    Actions are those of `OptionsEnv` on the same instance, with the same numbers, names and masks: primitives
    (unless `include_primitives` is false), `meta-01` to `meta-NN`, `meta-exit`. Where `OptionsEnv` follows a plan,
    options here are greedy on cost-to-go fields that were computed once an instance, and ask the planner only where
    these lead nowhere; they reach what plans reach, in about as many primitives. Rooms pressed by hand have no fields,
    for what is left to do depends on every joint: their options are planned on the host, one room after the other,
    as `OptionsEnv` plans them (under noise or slip, at every primitive). Only their primitives run in the batch.

        seen = env.reset(torch.arange(env.count))
        while learning:
            action = choose(env.observation, env.action_mask)     # read only where env.is_waiting
            done = env.step(action)
            rows = done.where.nonzero().squeeze(1)
            replay.add(*(field[rows] for field in done[1:]))

    All tensors are on `device`, rooms first. What happens in a room depends on its own seed and actions, never on the
    batch it is in.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        instance: a `RoomInstance`, the path of one, or several of them, instead of `config`.
        instance_seed: instance seed of the first room instance.
        num_instances: how many instances of the schematic there are; room i is in instance i modulo their number.
        observation: `state`, `features` or `egocentric`.
        resample_instance: every episode draws one of the instances.
        include_primitives: whether primitives are actions too.
        discount: gamma per primitive, in [0, 1]; readable as `gamma`.
        max_duration: primitives after which an option is ended (`timeout`); None for no limit.
        autoreset: begin the next episode of a room as soon as one ends; else it stands still until `reset`.
        device: where the rooms are.
        compile: fuse a step into compiled kernels; takes some 20 s once for each shape of batch.

    Attributes:
        room: the batched engine: instances, layout, states.
        count: number of rooms.
        device: where everything is.
        action_names: names of the actions.
        actions: their number.
        gamma: discount per primitive.
        observation_space: of one room.
        action_space: of one room.

    Raises:
        UnsupportedError: the batched engine cannot step these rooms.
        ConfigError: an argument is impossible.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: str | RoomConfig | dict[str, Any] = "paper-two-button",
        *,
        instance: InstanceSource | None = None,
        instance_seed: int = 0,
        num_instances: int = 1,
        observation: str = "features",
        resample_instance: bool = False,
        include_primitives: bool = True,
        discount: float = 0.99,
        max_duration: int | None = None,
        autoreset: bool = True,
        device: str | torch.device = "cpu",
        compile: bool = False,
    ) -> None:
        if not 0.0 <= discount <= 1.0:
            raise ConfigError("BatchedOptionsEnv.discount", discount, "a number from 0 to 1")
        if max_duration is not None and max_duration < 1:
            raise ConfigError("BatchedOptionsEnv.max_duration", max_duration, "at least 1, or None for no limit")
        self.room = TensorRoom(collect_instances(config, instance, instance_seed, num_instances), num_envs,
                               observation=observation, autoreset="disabled", resample=resample_instance, device=device)
        self.count, self.device, self.gamma = num_envs, self.room.device, float(discount)
        layout = self.room.layout
        self._by_hand = layout.dynamics.press_with == "hand"
        self._prices = None if self._by_hand else stack_prices(self.room.instances, self.device)
        self._guide = Guide(self.room)
        names = [primitive.name for primitive in make_primitives(layout.robot.joints)] if include_primitives else []
        self.action_names = (*names, *(f"meta-{n + 1:02d}" for n in range(layout.targets)), "meta-exit")
        self.actions = len(self.action_names)
        self.action_space = spaces.Discrete(self.actions)
        self.observation_space = spaces.Box(*compute_bounds(self.room.instances, observation), dtype=np.float32)
        patience = math.ceil(PATIENCE / (1.0 - layout.dynamics.slip)) if layout.dynamics.slip < 1.0 else PATIENCE
        if self._by_hand:
            patience = 2**31 - 1  # planned options have their own
        self._settings = Settings(observation, len(names), self.gamma, patience, max_duration or 2**31 - 1, autoreset)
        self._kernel: Kernel | None = None
        if compile:
            check_compiler(self.device)
            shapes = (num_envs, *list_shapes(self.room.tables), *(list_shapes(self._prices) if self._prices else ()))
            self._kernel = _compile(layout, self._settings, self.device.type, torch.get_num_threads(), shapes)

    # --- what there is to see --------------------------------------------------------------

    def _check_begun(self) -> None:
        if not hasattr(self, "_shown"):
            raise ResetNeededError("call reset() with seeds first: no episode has begun")

    @property
    def observation(self) -> Tensor:
        """What the rooms show now, after any automatic reset, float32 (rooms, numbers)."""
        self._check_begun()
        return self._shown.observation

    @property
    def action_mask(self) -> Tensor:
        """The actions legal now, bool (rooms, actions)."""
        self._check_begun()
        return self._shown.mask

    @property
    def is_waiting(self) -> Tensor:
        """Rooms that take an action at the next step, bool (rooms,)."""
        self._check_begun()
        return (self._running.action < 0) & ~self.is_over

    @property
    def is_over(self) -> Tensor:
        """Rooms whose episode has ended and that stand still until `reset`, bool (rooms,)."""
        return self.room.get_state().has_ended != 0

    # --- episodes ----------------------------------------------------------------------------

    def reset(self, seeds: Tensor | None = None, where: Tensor | None = None) -> Tensor:
        """Begin new episodes; decisions that run in these rooms are dropped.

        Args:
            seeds: key of each room's random numbers, int64 (rooms,); None goes on with the streams there are.
            where: rooms to reset, bool (rooms,); None resets all.

        Returns:
            The observation of all rooms.

        Raises:
            ResetNeededError: the rooms were never seeded.
            BatchError: another shape, dtype or device.
        """
        self.room.reset(seeds, where)
        with torch.no_grad():
            self._shown = show(self.room.layout, self.room.tables, self.room.get_state(), self._settings)
            fresh = make_running(self._shown.observation)
            if where is not None and hasattr(self, "_running"):
                fresh = fresh._replace(action=torch.where(where, -1, self._running.action))
                fresh = self._running._replace(action=fresh.action)
            # each tensor its own memory, as steps leave them: a compiled step would compile anew for shared ones
            self._running, self.room.state = map_tensors(_own, fresh), map_tensors(_own, self.room.get_state())
        return self._shown.observation

    def step(self, action: Tensor) -> Decisions:
        """Give waiting rooms their decisions and run one primitive in every room.

        Args:
            action: int64 (rooms,) on the rooms' device; read only where `is_waiting`.

        Returns:
            The decisions that ended with this primitive.

        Raises:
            ActionError: an action outside the table. On an accelerator, where looking would stall it, such an action
                is taken for the nearest one there is.
            BatchError: another shape, dtype or device.
            ResetNeededError: no episode has begun, or all have ended.
        """
        self._check_begun()
        action = self._check_action(action)
        room = self.room
        with torch.no_grad():
            self._plan(action)
            if self._kernel is not None:
                found = self._kernel(room.tables, self._prices, room.state, self._running, self._shown, action)
            else:
                found = advance(room.layout, self._settings, room.tables, self._prices, room.state, self._running,
                                self._shown, action)
        room.state, self._running, self._shown, decisions = found
        return decisions

    def _plan(self, action: Tensor) -> None:
        """Ask the planners for all who press by hand, else where greed has come no nearer for a while."""
        primitives = self._settings.primitives
        running = begin(self._running, self.is_waiting, action, self._shown.observation) if self._by_hand \
            else self._running
        where = (running.action >= primitives) & (running.planned == 0) & ~self.is_over
        goals = running.action - primitives
        if self._by_hand:
            legal = torch.gather(self._shown.mask, 1, running.action.clamp(min=0).unsqueeze(1)).squeeze(1)
            self._running, _ = self._guide.pursue(running, where & legal, goals)
        else:
            running, has_failed = self._guide.plan(running, where & (running.waited >= STUCK), goals)
            # one more primitive in vain, and those that planning has failed give up
            self._running = running._replace(
                waited=torch.where(has_failed, self._settings.patience, running.waited))

    def _check_action(self, action: Tensor) -> Tensor:
        if not isinstance(action, Tensor) or action.shape != (self.count,) or action.dtype != torch.int64 \
                or action.device != self.device:
            raise BatchError("action", action, f"a tensor of shape ({self.count},), torch.int64, on {self.device}")
        if self.device.type != "cpu":
            return action.clamp(0, self.actions - 1)
        low, high = torch.aminmax(torch.where(self.is_waiting, action, 0))
        for extreme in (int(low), int(high)):
            if not 0 <= extreme < self.actions:
                raise ActionError(extreme, self.actions)
        if not self._settings.autoreset and bool(self.is_over.all()):
            raise ResetNeededError("every room's episode has ended and autoreset is false: reset some first")
        return action


def _own(field: Tensor) -> Tensor:
    return field.clone(memory_format=torch.contiguous_format)


@lru_cache(maxsize=64)
def _compile(layout: Layout, settings: Settings, device: str, threads: int, shapes: tuple) -> Kernel:
    """Compile a step for one shape of batch; kernels hand flags over as words, as in `tensor_room.py`."""

    def kernel(tables: Tables, prices: Prices | None, state: TensorState, running: Running, shown: Shown, action: Tensor
               ) -> tuple[TensorState, Running, Shown, Decisions]:
        state, running, shown, done = advance(layout, settings, tables, prices, state, running, shown, action)
        shown, done = (map_tensors(lambda field: field.to(torch.int32) if field.dtype == torch.bool else field, part)
                       for part in (shown, done))
        return state, running, shown, done

    compiled = compile_step(kernel, device, threads)

    def run(tables: Tables, prices: Prices | None, state: TensorState, running: Running, shown: Shown, action: Tensor
            ) -> tuple[TensorState, Running, Shown, Decisions]:
        state, running, shown, done = compiled(tables, prices, state, running, shown, action)
        done = done._replace(where=done.where != 0, next_action_mask=done.next_action_mask != 0,
                             terminated=done.terminated != 0, truncated=done.truncated != 0)
        return state, running, shown._replace(mask=shown.mask != 0), done

    return run
