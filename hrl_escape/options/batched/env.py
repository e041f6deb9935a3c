"""`BatchedOptionsEnv`: thousands of rooms with decisions of different durations side by side.

Every step runs one primitive in every room and returns the decisions that ended, with the SMDP fields of `OptionsEnv`.
A room takes its next decision as soon as the last one ends. The rules are the batched engine's, and one step is in
`stepping.py`. Planners on the host order goals for options that carry out ancestors first, and find primitives where
the fields make no progress.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import torch
from torch import Tensor
from typing_extensions import Unpack

from hrl_escape.env.batched.compilation import CompiledStep, check_compiler
from hrl_escape.env.batched.engine import TensorRoom, list_shapes, make_room_keys
from hrl_escape.env.batched.observations import load_observation
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.rooms import RoomArguments, Rooms
from hrl_escape.env.batched.tables import map_tensors
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.noise import check_seed
from hrl_escape.env.poses import RoomState
from hrl_escape.env.presets import ConfigForm
from hrl_escape.errors import (
    ActionError,
    BatchError,
    ConfigError,
    PlanningFailed,
    ResetNeededError,
    UnsupportedError,
    show_value,
)
from hrl_escape.names import join_words
from hrl_escape.options.batched.aims import BatchGoal, check_goals, read_targets
from hrl_escape.options.batched.cost_to_go import CostFields, stack_fields
from hrl_escape.options.batched.hand_policy import weigh_postures
from hrl_escape.options.batched.known_runs import KnownRuns, repeats_runs
from hrl_escape.options.batched.stepping import (
    ENDINGS,
    FAIL_AFTER,
    NOT_ASKED,
    ORDER_LENGTH,
    PLAN_AFTER,
    PLAN_LENGTH,
    AgentView,
    Choice,
    OpenDecisions,
    Search,
    StepSettings,
    Transitions,
    begin_some,
    choose_some,
    find_startable,
    make_decisions,
    make_view,
    step_decisions,
)
from hrl_escape.options.batched.successors import presses_by_hand
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.meta_actions import name_object
from hrl_escape.options.option_sets import check_option_set
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.goals import name_goal
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.spaces import PointingDiscrete, make_vector_space


class HostPlanner:
    """Planners of a batch of rooms."""

    def __init__(self, room: TensorRoom) -> None:
        self._room = room
        self._planners: dict[int, tuple[RoomPlanner, tuple[BatchGoal, ...]]] = {}  # and the goals of the options

    def order(self, running: OpenDecisions, where: Tensor, options: Tensor) -> OpenDecisions:
        """Return the ancestors of options, int64 (rooms,), and these options, in the order to carry them out.

        `where` marks the rooms that need an order, bool (rooms,). Their next goal stays `NOT_ASKED` if the
        preconditions cannot be met.
        """
        at = where.nonzero().squeeze(1)
        if not len(at):
            return running
        found = [self._find_order(*room) for room in self._read(at, options)]
        found = [goals if len(goals) <= ORDER_LENGTH else [*goals[:ORDER_LENGTH], NOT_ASKED] for goals in found]
        device = where.device
        order, goal, left = running.order.clone(), running.goal.clone(), running.order_left.clone()
        order[:, at] = _align([goals[1:] for goals in found], ORDER_LENGTH, NOT_ASKED).to(order)
        goal[at] = torch.tensor([goals[0] if goals else NOT_ASKED for goals in found], device=device)
        left[at] = torch.tensor([max(len(goals) - 1, 0) for goals in found], dtype=left.dtype, device=device)
        return running._replace(order=order, goal=goal, order_left=left)

    def plan(self, running: OpenDecisions, where: Tensor) -> tuple[OpenDecisions, Tensor]:
        """Plan from the present states of the rooms of `where`, bool (rooms,), to their goals.

        Returns:
            The decisions with the beginnings of their plans, and the rooms whose planning failed, bool (rooms,).
        """
        at = where.nonzero().squeeze(1)
        has_failed = torch.zeros_like(where)
        if not len(at):
            return running, has_failed
        kept = 1 if self._room.layout.dynamics.is_random else PLAN_LENGTH  # a slip invalidates what follows
        plans = [self._find_plan(*room)[:kept] for room in self._read(at, running.goal)]
        plan, left = running.plan.clone(), running.plan_left.clone()
        lengths = torch.tensor([len(found) for found in plans], dtype=left.dtype, device=left.device)
        plan[:, at], left[at], has_failed[at] = _align(plans, PLAN_LENGTH, 0).to(plan), lengths, lengths == 0
        return running._replace(plan=plan, plan_left=left), has_failed

    def _read(self, at: Tensor, goal: Tensor) -> Iterator[tuple[RoomPlanner, RoomState, Sequence[BatchGoal], int]]:
        """Return planner, state, goals and the number of the goal of the rooms numbered `at`, int64 (some,).

        `goal` holds the numbers of all rooms, int64 (rooms,).
        """
        states = self._room.get_room_states(at.tolist())
        for number, state, aim in zip(self._room.state.instance[at].tolist(), states, goal[at].tolist(), strict=True):
            if number not in self._planners:
                instance = self._room.instances[number]
                self._planners[number] = get_planner(instance), check_goals(instance)
            planner, goals = self._planners[number]
            yield planner, state, goals, aim

    @staticmethod
    def _find_order(planner: RoomPlanner, state: RoomState, goals: Sequence[BatchGoal], number: int) -> list[int]:
        try:
            return [goals.index(goal) for goal in planner.orders.find_ancestors(state, goals[number])]
        except PlanningFailed:
            return []

    @staticmethod
    def _find_plan(planner: RoomPlanner, state: RoomState, goals: Sequence[BatchGoal], number: int) -> tuple[int, ...]:
        try:
            return planner.routes.find_route(state, goals[number]).primitives
        except PlanningFailed:
            return ()


def _align(rows: Sequence[Sequence[int]], length: int, filler: int) -> Tensor:
    """Return short lists as columns of a table, (length, lists), aligned to its end."""
    return torch.tensor([[filler] * (length - len(row)) + list(row) for row in rows]).T.contiguous()


class PostureChooser:
    """Chooses postures for the rooms of a batch, with or without a compiled kernel."""

    def __init__(self, room: TensorRoom, fields: CostFields, is_compiled: bool, parts: int) -> None:
        self._room, self._aims = room, fields.aims
        self._weigh, self._part = bind_parts(weigh_postures, room, fields, is_compiled, parts)

    def choose(self, running: OpenDecisions, where: Tensor) -> OpenDecisions:
        """Choose postures in the rooms of `where`, bool (rooms,), whose press begins or has made no progress."""
        layout, targets = self._room.layout, self._room.layout.targets
        goal = read_targets(layout, self._aims, self._room.state.instance, running.goal.clamp(min=0))
        is_press = (running.goal >= 0) & (goal < targets)
        rooms = (where & is_press & ((running.age == 0) | (running.stalled > 0))).nonzero().squeeze(1)
        if len(rooms) == 0:
            return running
        goal = goal.clamp(max=targets - 1)
        found = torch.cat([self._weigh(self._room.state, goal, some) for some in split_rooms(rooms, self._part)], dim=1)
        return running._replace(postures=running.postures.index_copy(1, rooms, found[:, : len(rooms)]))


class PrimitiveChooser:
    """Chooses the next primitives of some rooms of a batch, with or without a compiled kernel."""

    def __init__(self, room: TensorRoom, fields: CostFields, is_compiled: bool) -> None:
        self._room, self._aims = room, fields.aims
        self._choose, self._part = bind_parts(choose_some, room, fields, is_compiled, _SMALL_PARTS)

    def choose(self, running: OpenDecisions, where: Tensor, primitive: Tensor) -> Choice:
        """Choose in the rooms of `where`, bool (rooms,), and take `primitive`, int64 (rooms,), elsewhere at no cost."""
        state = self._room.state
        goal = read_targets(self._room.layout, self._aims, state.instance, running.goal.clamp(min=0))
        search = Search(goal, running.postures, running.cells, running.costs)
        choice = Choice(primitive, torch.zeros_like(running.least), torch.zeros_like(goal))
        rooms = where.nonzero().squeeze(1)
        if len(rooms):
            found = [self._choose(state, search, some) for some in split_rooms(rooms, self._part)]
            for every, parts in zip(choice, zip(*found, strict=True), strict=True):
                every[rooms] = torch.cat(parts)[: len(rooms)]
        return choice


def bind_parts(function: Callable[..., Any], room: TensorRoom, fields: CostFields, is_compiled: bool, parts: int
               ) -> tuple[Callable[..., Any], int]:
    """Bind a function of some rooms, compiled or not, to a batch.

    Returns:
        The function, and the number of rooms that it takes at a time, in `parts` parts of the batch; 0 for any number.
    """
    if not is_compiled:
        return partial(function, room.layout, room.tables, fields), 0
    shapes = (room.count, *list_shapes(room.tables), *list_shapes(fields))
    kernel = compile_step(function, (room.layout,), room.device.type, torch.get_num_threads(), shapes)
    return kernel.bind(room.tables, fields), max(-(-room.count // (16 * parts)), 1) * 16  # whole vectors


def split_rooms(rooms: Tensor, part: int) -> Sequence[Tensor]:
    """Split room numbers, int64 (some,), into parts of one size, as compiled kernels take them; 0 for a single part.

    The last part is padded with room 0.
    """
    return torch.cat([rooms, rooms.new_zeros(-len(rooms) % part)]).split(part) if part else (rooms,)


@lru_cache(maxsize=64)
def compile_step(function: Callable[..., Any], constants: tuple, device: str, threads: int, shapes: tuple
                 ) -> CompiledStep:
    """Compile a function of constants and tensors for one shape of batch.

    Rounding is the same as on a CPU, because the last bit decides between routes of equal length. This costs two fifths
    of an accelerator's rate.
    """
    return CompiledStep(partial(function, *constants), device, threads, rounds_alike=True)


BATCHED_SETS = ("press", "press-with-ancestors")
"""Option sets that batches support."""
_PARTS = 8  # parts of a batch, weighed one at a time by a compiled kernel: about as many as primitives in a press
_SMALL_PARTS = 32  # the same where most runs of options are known
_SHARED = ("options", "include_primitives", "discount", "option_set", "interruptible", "max_duration")
"""Arguments that `OptionsEnv` has, too."""

__all__ = ["ENDINGS", "BatchedOptionsEnv", "Transitions"]

Stepped: TypeAlias = tuple[TensorState, OpenDecisions, AgentView, Transitions, Tensor]
DecisionKernel: TypeAlias = Callable[[TensorState, OpenDecisions, AgentView, Tensor, Choice | None], Stepped]


class BatchedOptionsEnv:
    """Many rooms whose robots choose among options and primitives, each at its own pace.

    Actions have the same numbers, names and masks as in `OptionsEnv` on the same instance: primitives (unless
    `include_primitives` is false), then options such as `press-button-1`, and `go-to-exit`.

    Batched options press, grip and release. A puzzle with grips has at most 20,000 states and does not watch
    primitives. Pushes, and maps with doors that shut again, require `OptionsEnv`. Batched options are greedy on
    cost-to-go fields, computed once per instance, and use the planner where these make no progress. They reach the same
    goals in about as many primitives. A press by hand minimises the sum of what base and arm have left, over 64
    postures.

    A training loop::

        env.reset(torch.arange(env.count))
        while learning:
            action = choose(env.observation, env.action_mask)     # read only where env.is_waiting
            done = env.step(action)
            rows = done.where.nonzero().squeeze(1)
            replay.add(*(field[rows] for field in done[1:]))

    All tensors are on `device`, rooms first. A room depends on its own seed and actions, and not on the rest of the
    batch.

    Args:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        observation: name of a vector observation.
        options: an `OptionDegradation`, to degrade options as in `OptionsEnv`, or None.
        include_primitives: whether primitives are actions too.
        discount: gamma per primitive, in [0, 1]; readable as `gamma`.
        option_set: name of the default option set, one of `BATCHED_SETS`. `press-with-ancestors` asks the planner for
            the order of goals at the start of a decision.
        interruptible: return to the agent after every primitive of an option, with `interrupted`. Choosing the same
            option again continues it, and choosing another drops it.
        max_duration: maximum primitives of an option, which then ends with `timeout`, interruptions included, or None
            for no limit.
        autoreset: start the next episode of a room as soon as one ends; otherwise the room waits for `reset`.
        rooms: `instance`, `instance_seed`, `num_instances`, `resample_instance`, `device` and `compile`; see `Rooms`.

    Attributes:
        room: the batched engine: instances, layout, states.
        count: number of rooms.
        device: device of all tensors.
        action_names: names of the actions.
        actions: number of actions.
        gamma: discount per primitive; see `set_option_discount`.
        observation_space: of one room.
        action_space: of one room.

    Raises:
        UnsupportedError: the batched engine does not support these rooms or options.
        ConfigError: an argument is invalid.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: ConfigForm = "paper-two-button",
        *,
        observation: str = "state",
        options: OptionDegradation | None = None,
        include_primitives: bool = True,
        discount: float = 0.99,
        option_set: str = "press",
        interruptible: bool = False,
        max_duration: int | None = None,
        autoreset: bool = True,
        **rooms: Unpack[RoomArguments],
    ) -> None:
        if not 0.0 <= discount <= 1.0:
            raise ConfigError("BatchedOptionsEnv.discount", discount, "a number from 0 to 1")
        if max_duration is not None and max_duration < 1:
            raise ConfigError("BatchedOptionsEnv.max_duration", max_duration, "at least 1, or None for no limit")
        degradation = _read_options(options, option_set)
        self.rooms = Rooms(num_envs, config, observation=observation, **rooms)
        self.room = TensorRoom(dataclasses.replace(self.rooms, compile=False), autoreset="disabled")
        self.count, self.device, self.gamma = num_envs, self.room.device, float(discount)
        if degradation != OptionDegradation(option_set=degradation.option_set):  # draws depend on the episode's key
            self.room.layout = dataclasses.replace(self.room.layout, draws=True)
        layout = self.room.layout
        self._fields = stack_fields(self.room.instances, self.device)
        self._host_planner = HostPlanner(self.room)
        names = layout.actions.names if include_primitives else ()
        goals = check_goals(self.room.instances[0])
        self.action_names = (*names, *(name_goal(goal, self.room.instances[0]) for goal in goals))
        self.actions = len(self.action_names)
        about = (name_object(goal, self.room.instances[0]) for goal in goals)
        self.action_space = PointingDiscrete(self.actions, (*(None for _ in names), *about))
        self.observation_space = make_vector_space(self.room.low, self.room.high, self.room.rows, self.room.words)
        fail_after = math.ceil(FAIL_AFTER / (1.0 - layout.dynamics.slip)) if layout.dynamics.slip < 1.0 else FAIL_AFTER
        self._arguments = {"options": options, "include_primitives": include_primitives, "discount": self.gamma,
                           "option_set": option_set, "interruptible": interruptible, "max_duration": max_duration,
                           "autoreset": autoreset}
        self._settings = StepSettings(load_observation(observation), len(names), len(goals), self.gamma, fail_after,
                                      max_duration or 2**31 - 1, autoreset, interruptible,
                                      degradation.option_set == "press-with-ancestors", degradation)
        self._view: AgentView | None = None
        self._running: OpenDecisions | None = None
        repeats = self.device.type == "cpu" and repeats_runs(layout, self._settings)
        self._known = KnownRuns(num_envs) if repeats else None
        parts = _SMALL_PARTS if repeats else _PARTS
        self._chooser = (PostureChooser(self.room, self._fields, self.rooms.compile, parts) if presses_by_hand(layout)
                         else None)
        self._primitives = PrimitiveChooser(self.room, self._fields, self.rooms.compile) if repeats else None
        self._kernel = self._compile() if self.rooms.compile else None

    def _compile(self) -> DecisionKernel:
        check_compiler(self.device)
        shapes = (self.count, *list_shapes(self.room.tables), *list_shapes(self._fields))
        compiled = compile_step(step_decisions, (self.room.layout, self._settings), self.device.type,
                                torch.get_num_threads(), shapes)
        return compiled.bind(self.room.tables, self._fields)

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount per primitive, in [0, 1]. Running decisions keep the rewards they have."""
        if not 0.0 <= gamma <= 1.0:
            raise ConfigError("BatchedOptionsEnv.discount", gamma, "a number from 0 to 1")
        if gamma != self.gamma:
            self.gamma, self._settings = float(gamma), self._settings._replace(gamma=float(gamma))
            self._kernel = self._compile() if self.rooms.compile else None

    # --- observations and masks --------------------------------------------------------------

    def _get_begun(self) -> tuple[AgentView, OpenDecisions]:
        """Return the present view and decisions. Raises `ResetNeededError` before the first reset."""
        if self._view is None or self._running is None:
            raise ResetNeededError("call reset() with seeds first: no episode has begun")
        return self._view, self._running

    @property
    def observation(self) -> Tensor:
        """Return the present observation of the rooms, after any automatic reset, float32 (rooms, numbers)."""
        return self._get_begun()[0].observation

    @property
    def action_mask(self) -> Tensor:
        """Return the legal actions, bool (rooms, actions)."""
        return self._get_begun()[0].mask

    @property
    def is_waiting(self) -> Tensor:
        """Return which rooms take an action at the next step, bool (rooms,)."""
        return (self._get_begun()[1].action < 0) & ~self.is_over

    @property
    def is_over(self) -> Tensor:
        """Return which rooms have finished their episode and wait for `reset`, bool (rooms,)."""
        return self.room.state.has_ended != 0

    # --- episodes ----------------------------------------------------------------------------

    def reset(self, seeds: Tensor | int | None = None, where: Tensor | None = None) -> Tensor:
        """Start new episodes. Running decisions in these rooms are dropped.

        Args:
            seeds: keys of the rooms' random numbers, int64 (rooms,), or an integer of at least 0 that gives room i the
                key seeds + i. With None the present generators continue.
            where: rooms to reset, bool (rooms,), or None for all.

        Returns:
            The observation of all rooms, float32 (rooms, numbers).

        Raises:
            ResetNeededError: the rooms were never seeded.
            BatchError: another shape, dtype or device.
        """
        if isinstance(seeds, int):
            seeds = make_room_keys(range(check_seed(seeds), seeds + self.count), self.device)
        self.room.reset(seeds, where)
        with torch.no_grad():
            self._view = make_view(self.room.layout, self.room.tables, self._fields.aims, self.room.state,
                                   self._settings)
            fresh = make_decisions(self._view.observation)
            if where is not None and self._running is not None:
                fresh = self._running._replace(action=torch.where(where, -1, self._running.action),
                                               option=torch.where(where, -1, self._running.option))
            # each tensor gets its own memory, as after a step: shared memory would make a compiled step recompile
            self._running, self.room.state = map_tensors(_own, fresh), map_tensors(_own, self.room.state)
            if self._known is not None:
                self._known.drop(torch.ones_like(self.is_over) if where is None else where, self.room.state)
        return self._view.observation

    def step(self, action: Tensor) -> Transitions:
        """Pass decisions to the waiting rooms and run one primitive in every room.

        Args:
            action: int64 (rooms,) on the rooms' device; read only where `is_waiting`. A negative action leaves the room
                waiting.

        Returns:
            The decisions that ended with this primitive.

        Raises:
            ActionError: an action outside the table. On an accelerator, such an action is clamped instead, because the
                check would stall it.
            BatchError: another shape, dtype or device.
            ResetNeededError: no episode has begun, or all have ended.
        """
        view, running = self._get_begun()
        action = self._check_action(action)
        room = self.room
        with torch.no_grad():
            running, choice = self._plan(view, running, action)
            if self._kernel is not None:
                found = self._kernel(room.state, running, view, action, choice)
            else:
                found = step_decisions(room.layout, self._settings, room.tables, self._fields, room.state, running,
                                       view, action, choice, looks=self.device.type == "cpu")
            room.state, self._running, self._view, transitions, primitive = found
            if self._known is not None:
                self._known.record(room.state, primitive, transitions)
        return transitions

    # --- one of the rooms, and checkpoints -----------------------------------------------------

    def make_single_env(self) -> gymnasium.Env:
        """Make an `OptionsEnv` of the same rooms, options and observation. Its options follow plans."""
        env = EscapeRoomEnv(**self.rooms.list_single_arguments())
        return OptionsEnv(env, **{name: self._arguments[name] for name in _SHARED})

    def describe(self) -> dict[str, Any]:
        """Return the arguments that decide the numbers, as JSON values; rooms are given by their ids."""
        options = self._arguments["options"]
        return self.rooms.describe() | self._arguments | {"options": options and options.to_dict()}

    def state_dict(self) -> dict[str, Any]:
        """Return episodes and running decisions, as arrays."""
        view, running = self._get_begun()
        running = running if self._known is None else self._known.write_plans(running)
        return {name: {key: field.cpu().numpy() for key, field in part._asdict().items()}
                for name, part in (("rooms", self.room.state), ("view", view), ("running", running))}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a state from `state_dict`, in as many of the same rooms."""
        def take(part: dict[str, Any]) -> dict[str, Tensor]:
            return {name: torch.from_numpy(np.array(field)).to(self.device) for name, field in part.items()}

        self.room.state = TensorState(**take(state["rooms"]))
        if self._known is not None:
            self._known.drop(torch.ones_like(self.is_over), self.room.state)
        self._view, self._running = AgentView(**take(state["view"])), OpenDecisions(**take(state["running"]))

    def _plan(self, view: AgentView, running: OpenDecisions, action: Tensor) -> tuple[OpenDecisions, Choice | None]:
        """Ask for orders, choose postures, and plan for the rooms whose greedy policy has made no progress.

        Returns:
            The decisions, and where options repeat their runs, the next primitives.
        """
        settings, layout, known = self._settings, self.room.layout, self._known
        begins, is_followed = self.is_waiting & (action >= 0), None
        if known is not None:
            running = known.begin(self.room.state, running, begins & (action >= settings.primitives), action)
            is_followed = known.is_followed
        if known is not None or settings.interruptible or settings.has_ancestors or self._chooser is not None:
            at = (begins if is_followed is None else begins & ~is_followed).nonzero().squeeze(1)
            running = begin_some(settings, running, at, action, view.observation)
        where = (running.action >= settings.primitives) & ~self.is_over
        if is_followed is not None:
            where = where & ~is_followed
        chooses = where if known is None else where & known.find_leading()
        where = where & (running.plan_left == 0) & (running.run >= settings.degradation.detour)
        if settings.has_ancestors:
            option = (running.action - settings.primitives).clamp(min=0)
            can = find_startable(layout, self.room.tables, self._fields.aims, self.room.state, settings)
            where = where & ((running.run > 0) | torch.gather(can, 1, option.unsqueeze(1)).squeeze(1))
            running = self._host_planner.order(running, where & (running.goal == NOT_ASKED), option)
            where = where & (running.goal != NOT_ASKED)
        if self._chooser is not None and known is not None:
            running = self._chooser.choose(running, where & chooses)
            running = running._replace(postures=running.postures[:, known.leader])
        elif self._chooser is not None:
            running = self._chooser.choose(running, where)
        running, has_failed = self._host_planner.plan(running, where & (running.stalled >= PLAN_AFTER))
        # a room whose planning failed gives up after one more primitive without progress
        running = running._replace(stalled=torch.where(has_failed, settings.fail_after, running.stalled))
        if known is None or self._primitives is None:
            return running, None
        choice = self._primitives.choose(running, chooses, known.read(begins, running))
        return running, map_tensors(lambda field: field[known.leader], choice)

    def _check_action(self, action: Tensor) -> Tensor:
        if not isinstance(action, Tensor) or action.shape != (self.count,) or action.dtype != torch.int64 \
                or action.device != self.device:
            raise BatchError("action", action, f"a tensor of shape ({self.count},), torch.int64, on {self.device}")
        if self.device.type != "cpu":
            return action.clamp(-1, self.actions - 1)
        highest = int(torch.where(self.is_waiting, action, 0).max())
        if highest >= self.actions:
            raise ActionError(highest, self.actions)
        if not self._settings.autoreset and bool(self.is_over.all()):
            raise ResetNeededError("every room's episode has ended and autoreset is false: reset some first")
        return action


def _read_options(options: OptionDegradation | None, option_set: str) -> OptionDegradation:
    """Return `options` and `option_set` as one value. Raises for options that batches do not support."""
    if options is not None and not isinstance(options, OptionDegradation):
        raise UnsupportedError(f"options = {show_value(options)}: a batch has meta-actions only, whole or worse by an "
                               "OptionDegradation; OptionsEnv runs any options, in one room")
    chosen = option_set if options is None else options.option_set
    check_option_set(chosen)
    if chosen == "press-reactive":
        raise UnsupportedError("option_set = 'press-reactive': batched options choose by past cells, too, not by the "
                               "state alone; use OptionsEnv over one room")
    if chosen not in BATCHED_SETS:
        raise UnsupportedError(f"option_set = {chosen!r} has no batched form: a batch has {join_words(BATCHED_SETS)}; "
                               "OptionsEnv has every option set, in one room")
    if options is not None and options.latency:
        raise UnsupportedError(f"options.latency = {options.latency}: a batch does not wait for one room; OptionsEnv "
                               "sleeps")
    return OptionDegradation(option_set=chosen) if options is None else options


def _own(field: Tensor) -> Tensor:
    return field.clone(memory_format=torch.contiguous_format)
