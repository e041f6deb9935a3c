"""The batched engine: thousands of rooms that step together, on a CPU or an accelerator.

`TensorRoom` owns the tables and states of a batch and, optionally, a compiled kernel; `rules.py` has the rules. Poses
agree with the scalar rules up to rounding. Contacts are decided in single precision, and flags can therefore differ
within a micrometre of a threshold.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hrl_escape.env.batched.compilation import CompiledStep, check_compiler
from hrl_escape.env.batched.observations import compute_bounds, load_observation, observe
from hrl_escape.env.batched.poses import TensorState
from hrl_escape.env.batched.puzzles.base import as_signed, get_tensor_puzzle, unpack_bits
from hrl_escape.env.batched.rooms import Rooms, find_device
from hrl_escape.env.batched.rules import begin, glide, is_in_exit, restart, step
from hrl_escape.env.batched.tables import (
    Layout,
    Tables,
    list_tensors,
    make_layout,
    map_tensors,
    pick_rules,
    stack_instances,
)
from hrl_escape.env.kinematics import RoomState, Rules, check_state
from hrl_escape.env.noise import fold_seed
from hrl_escape.env.observations.base import BatchObservation, make_observer
from hrl_escape.env.tensor_geometry import store
from hrl_escape.env.velocities import Velocities
from hrl_escape.errors import (
    ActionError,
    BatchError,
    ConfigError,
    ResetNeededError,
    StateError,
    show_value,
)

Autoreset = Literal["next-step", "same-step", "disabled"]
AUTORESETS = ("next-step", "same-step", "disabled")


class RoomInfo(NamedTuple):
    """The `info` of every room."""

    primitives: Tensor  # number of primitives in the episode so far, int32 (rooms,)
    pressed: Tensor  # 1 for each target that this primitive pressed, int8 (rooms, targets)
    buttons_on: Tensor  # 1 for each target that is on, int8 (rooms, targets)
    instance: Tensor  # index of the instance, int64 (rooms,)
    success: Tensor  # 1 if the episode has ended with an escape, otherwise 0, int32 (rooms,)


class Outcome(NamedTuple):
    """The result of a step of the batch."""

    observation: Tensor
    """Observations after any automatic reset, float32 (rooms, numbers); values of one kind are contiguous in memory."""
    reward: Tensor  # float32 (rooms,)
    terminated: Tensor  # bool (rooms,)
    truncated: Tensor  # bool (rooms,)
    info: RoomInfo  # after any automatic reset
    final_observation: Tensor | None = None  # observation before a reset in the same step, or None in other reset modes
    final_info: RoomInfo | None = None  # `info` before a reset in the same step, or None in other reset modes


def advance(layout: Layout, observation: BatchObservation, autoreset: Autoreset, tables: Tables, state: TensorState,
            action: Tensor) -> tuple[TensorState, Outcome]:
    """Step every room, reset and observe it. This is the function that is compiled.

    With `next-step`, a room whose episode has ended ignores its action, begins the next episode and has reward 0. With
    `same-step`, it begins the next episode in the step that ends the last. With `disabled`, it keeps moving.
    """
    had_ended = state.has_ended.to(torch.int64) != 0  # as wide as the values that it selects
    move = step if layout.velocities is None else glide
    state, reward, terminated, truncated, pressed, escaped = move(layout, tables, state, action)
    if autoreset == "next-step":
        state = restart(layout, tables, state, had_ended)
        reward, pressed = torch.where(had_ended, 0.0, reward), torch.where(had_ended, 0, pressed)
        terminated, truncated, escaped = (flags & ~had_ended for flags in (terminated, truncated, escaped))
    seen, info = observe(layout, tables, state, observation), inform(layout, tables, state, pressed, escaped)
    if autoreset != "same-step":
        return state, Outcome(seen, reward, terminated, truncated, info)
    ended = state.has_ended.to(torch.int64) != 0
    state = restart(layout, tables, state, ended)
    now = inform(layout, tables, state, torch.where(ended, 0, pressed), torch.zeros_like(escaped))
    return state, Outcome(observe(layout, tables, state, observation), reward, terminated, truncated, now, seen, info)


def inform(layout: Layout, tables: Tables, state: TensorState, pressed: Tensor, escaped: Tensor) -> RoomInfo:
    """Return the info of every room; `pressed` has bits, int64 (rooms,), `escaped` truth values, bool (rooms,)."""
    form, columns = pick_rules(layout, tables, state.instance)
    lit = form.get_lit(columns, state.puzzle)
    begun, on = (unpack_bits(words, layout.targets, torch.int8).T for words in (store(pressed), lit))
    return RoomInfo(state.primitives, begun, on, state.instance, escaped.to(torch.int32))


Kernel = Callable[[TensorState, Tensor], tuple[TensorState, Outcome]]


@lru_cache(maxsize=256)
def _compile(layout: Layout, observation: BatchObservation, autoreset: Autoreset, device: str, threads: int,
             shapes: tuple) -> CompiledStep:
    """Compile a step for one shape of batch, shared by engines of the same shape."""
    return CompiledStep(partial(advance, layout, observation, autoreset), device, threads)


class TensorRoom:
    """A batch of rooms that step together; each has its own instance.

    Attributes:
        instances: all instances of the batch; `state.instance` indexes them.
        layout: properties that the instances share.
        tables: numbers of the instances, on the device.
        count: number of rooms.
        device: device of all tensors.
        actions: number of primitives, or of velocities.
        low: smallest value of each observation number in any instance, float32.
        high: largest value of each observation number.
        rows: names of the objects of the observation's first rows, if it has rows.
        words: names of the numbers in a row.
    """

    def __init__(self, rooms: Rooms, *, autoreset: Autoreset = "next-step", velocities: Velocities | None = None,
                 most_steps: int | None = None) -> None:
        """Stack instances and allocate the batch; the first episodes begin with `reset`.

        Args:
            rooms: instances, observation and device; the instances must share robot, dynamics, and kind and size of
                puzzle.
            autoreset: when the next episode begins: in the next step, in the same step, or only by `reset`.
            velocities: bounds and time step of velocities as actions, or None for primitives.
            most_steps: largest number of steps in an episode, if smaller than the horizon.

        Raises:
            UnsupportedError: these rooms require the Bullet engine, or there is no compiler.
            UnknownNameError: no observation of that name.
            ConfigError: no such autoreset mode.
        """
        if autoreset not in AUTORESETS:
            raise ConfigError("autoreset", autoreset, f"one of {', '.join(AUTORESETS)}")
        self.instances, self.device = rooms.instances, find_device(rooms.device)
        self.layout = make_layout(self.instances, rooms.resample_instance, velocities)
        self.tables = stack_instances(self.instances, self.layout, self.device)
        if most_steps is not None:
            self.tables = self.tables._replace(horizons=self.tables.horizons.clamp(max=most_steps))
        self.count = rooms.num_envs
        self.actions = len(velocities.list_bounds(self.layout.robot) if velocities else self.layout.actions)
        self._observation, self.is_compiled = load_observation(rooms.observation), rooms.compile
        self.low, self.high = compute_bounds(self.instances, rooms.observation)
        observer = make_observer(rooms.observation, Rules(self.instances[0]))
        self.rows, self.words = observer.rows, observer.words
        self._autoreset: Autoreset = autoreset
        self._state: TensorState | None = None
        self._rules: dict[int, Rules] = {}
        self._kernel = self._make_kernel()

    def _make_kernel(self) -> Kernel | None:
        if not self.is_compiled:
            return None
        check_compiler(self.device)
        shapes = (self.count, *list_shapes(self.tables))
        return _compile(self.layout, self._observation, self._autoreset, self.device.type, torch.get_num_threads(),
                        shapes).bind(self.tables)

    def to(self, device: str | torch.device) -> TensorRoom:
        """Move the batch with its running episodes to another device. Returns the batch itself."""
        self.device = find_device(device)
        self.tables = map_tensors(lambda table: table.to(self.device), self.tables)
        if self._state is not None:
            self._state = map_tensors(lambda field: field.to(self.device), self._state)
        self._kernel = self._make_kernel()
        return self

    # --- episodes ----------------------------------------------------------------------

    def reset(self, seeds: Tensor | None = None, where: Tensor | None = None) -> Tensor:
        """Begin new episodes.

        Args:
            seeds: key of each room's random numbers, int64 (rooms,); by default the streams continue.
            where: rooms to reset, bool (rooms,); by default all.

        Returns:
            The observation of all rooms.

        Raises:
            ResetNeededError: the rooms have no seeds yet.
        """
        with torch.no_grad():
            if where is not None:
                self._check("where", where, torch.bool)
            if seeds is not None:
                self._check("seeds", seeds, torch.int64)
                rooms = torch.arange(self.count, device=self.device)
                fresh = begin(self.layout, self.tables, seeds, rooms % len(self.instances))
            else:
                old = self.state
                everywhere = torch.ones_like(old.has_ended, dtype=torch.bool)
                fresh = restart(self.layout, self.tables, old, everywhere if where is None else where)
            if where is not None and seeds is not None:
                old = self.state
                fresh = TensorState(*(torch.where(where, new, kept) for new, kept in zip(fresh, old, strict=True)))
            self.state = fresh
            return self.observe()

    def step(self, action: Tensor) -> Outcome:
        """Run one primitive, or one step of velocities, in every room.

        Args:
            action: integers (rooms,) on the batch's device; for velocities, floats (rooms, numbers), which are clipped
                to their bounds.

        Raises:
            ActionError: an action is not in the table. On an accelerator, where a check would stall the device, such an
                action has no effect, and a velocity that is NaN counts as 0.
            BatchError: wrong shape, dtype or device.
            ResetNeededError: no episode has begun, or an episode has ended and automatic reset is disabled.
        """
        state = self.state
        action = self._check_action(action)
        with torch.no_grad():
            if self._kernel is not None:
                self.state, outcome = self._kernel(state, action)
            else:
                self.state, outcome = advance(self.layout, self._observation, self._autoreset, self.tables, state,
                                              action)
        return outcome

    def observe(self) -> Tensor:
        """Return the current observations of the rooms, float32 (rooms, numbers)."""
        with torch.no_grad():
            return observe(self.layout, self.tables, self.state, self._observation)

    def inform(self) -> RoomInfo:
        """Return the current `info` of the rooms, with no target pressed."""
        with torch.no_grad():
            state = self.state
            form, columns = pick_rules(self.layout, self.tables, state.instance)
            is_solved = form.is_solved(columns, state.puzzle)
            escaped = is_in_exit(self.layout, self.tables, state.instance, state.x, state.y) & is_solved
            return inform(self.layout, self.tables, state, torch.zeros_like(state.touching),
                          escaped & (state.has_ended != 0))

    # --- states ------------------------------------------------------------------------

    @property
    def state(self) -> TensorState:
        """States of the rooms. Assign to it to continue from other states.

        Raises:
            ResetNeededError: no episode has begun.
        """
        if self._state is None:
            raise ResetNeededError("no episode has begun. Call reset() with seeds first")
        return self._state

    @state.setter
    def state(self, state: TensorState) -> None:
        self._state = state

    def get_room_state(self, room: int) -> RoomState:
        """Return one room's state as a scalar `RoomState`, for planners, cameras and the Bullet engine."""
        return self.get_room_states([room])[0]

    def get_room_states(self, rooms: Sequence[int]) -> list[RoomState]:
        """Return the states of some rooms, copied from the device together; see `get_room_state`.

        Raises:
            ConfigError: no such room. Negative indices count from the last room.
        """
        for room in rooms:  # an invalid index would crash an accelerator irrecoverably
            if not -self.count <= room < self.count:
                raise ConfigError("rooms", room, f"numbers from {-self.count} to {self.count - 1}")
        at = torch.tensor([room % self.count for room in rooms], dtype=torch.int64, device=self.device)
        many = map_tensors(lambda field: field.index_select(-1, at).t().tolist(), self.state)
        puzzles = [self.instances[instance].puzzle for instance in many.instance]
        return [
            RoomState(x, y, heading, offset, tuple(joints), tuple(offsets) if any(offsets) else (),
                      get_tensor_puzzle(puzzle.kind).decode(puzzle, word % 2**64), touching % 2**64, primitives, key)
            for x, y, heading, offset, joints, offsets, word, touching, primitives, key, puzzle in zip(
                many.x, many.y, many.heading_steps, many.heading_offset, many.joint_steps, many.joint_offsets,
                many.puzzle, many.touching, many.primitives, many.noise_key, puzzles, strict=True)
        ]

    def set_room_state(self, room: int, state: RoomState) -> None:
        """Set the state of one room from a scalar `RoomState`; its instance and random stream stay the same.

        Raises:
            StateError: the state belongs to another robot, has parts beyond the kinematic rules, or is unreachable in a
                puzzle with a table.
        """
        rules = self._get_rules(int(self.state.instance[room]))
        check_state(rules, state)
        if state.physics is not None or state.z or state.pitch or state.roll:
            raise StateError(f"the batched engine accepts kinematic states, got {show_value(state)}")
        joints = self.layout.robot.joints
        values = {
            "x": state.x, "y": state.y, "heading_steps": state.heading_steps, "heading_offset": state.heading_offset,
            "joint_steps": state.joint_steps, "joint_offsets": state.joint_offsets or (0.0,) * joints,
            "puzzle": as_signed(get_tensor_puzzle(self.layout.puzzle).encode(rules.instance.puzzle, state.puzzle)),
            "touching": as_signed(state.touching), "primitives": state.primitives, "noise_key": state.noise_key,
            "has_ended": False,
        }
        if state.heading_offset and not self.layout.has_offsets:
            raise StateError("headings of these rooms must be whole turn steps, because noise and offsets are off")
        if any(state.joint_offsets) and not self.layout.has_joint_offsets:
            raise StateError("joints of these rooms must be at whole steps, because noise is off")
        changed = {}
        for name, value in values.items():
            field = getattr(self.state, name).clone()
            field[..., room] = torch.tensor(value, dtype=field.dtype, device=self.device)
            changed[name] = field
        self.state = self.state._replace(**changed)

    # --- checks ------------------------------------------------------------------------

    def _get_rules(self, instance: int) -> Rules:
        if instance not in self._rules:
            self._rules[instance] = Rules(self.instances[instance])
        return self._rules[instance]

    def _check(self, name: str, value: Tensor, dtype: torch.dtype) -> None:
        if not isinstance(value, Tensor) or value.shape != (self.count,) or value.dtype != dtype \
                or value.device != self.device:
            raise BatchError(name, value, f"a tensor of shape ({self.count},), {dtype}, on {self.device}")

    def _check_action(self, action: Tensor) -> Tensor:
        if self.layout.velocities is not None:
            return self._check_velocities(action)
        if isinstance(action, Tensor) and action.dtype in (torch.int32, torch.int16, torch.int8, torch.uint8):
            action = action.to(torch.int64)
        self._check("action", action, torch.int64)
        if self.device.type == "cpu":
            low, high = torch.aminmax(action)
            for extreme in (int(low), int(high)):
                if not 0 <= extreme < self.actions:
                    raise ActionError(extreme, self.actions)
            self._check_running()
        return action

    def _check_velocities(self, rates: Tensor) -> Tensor:
        shape = (self.count, self.actions)
        if not isinstance(rates, Tensor) or rates.shape != shape or not rates.is_floating_point() \
                or rates.device != self.device:
            raise BatchError("action", rates, f"a tensor of shape {shape}, of floating point, on {self.device}")
        if self.device.type == "cpu":
            if not bool(torch.isfinite(rates).all()):
                raise BatchError("action", rates, "finite numbers")
            self._check_running()
        return rates.to(torch.float64)

    def _check_running(self) -> None:
        if self._autoreset == "disabled" and bool(self.state.has_ended.any()):
            raise ResetNeededError("episodes have ended and autoreset is disabled. Reset these rooms first")


def draw_seed() -> int:
    """Draw a seed from the system's entropy, for rooms without a given one."""
    return secrets.randbits(62)


def make_room_keys(seeds: Sequence[int], device: torch.device) -> Tensor:
    """Return keys of rooms' random numbers, int64 (rooms,), from seeds of any size; see `fold_seed`."""
    return torch.from_numpy(np.array([fold_seed(seed) for seed in seeds], dtype=np.uint64).view(np.int64)).to(device)


def list_shapes(tree: object) -> list[tuple[int, ...]]:
    """Return the shapes of all tensors in nested named tuples and dicts."""
    return [tuple(table.shape) for table in list_tensors(tree)]
