"""`Plan`: primitives with the states they lead to, in named parts; it can be executed and drawn.

The states come from the room's kinematics without noise and slip. Without these, execution visits exactly these states.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, Kinematics, RoomState
from hrl_escape.errors import EscapeError
from hrl_escape.figures import make_svg
from hrl_escape.notebook import make_caption
from hrl_escape.planning.goals import Goal, name_goal


@dataclasses.dataclass(frozen=True)
class PlanPart:
    """One leg of a plan.

    Attributes:
        name: such as `press-button-2` or `go-to-exit`.
        goal: its goal.
        start: index of its first primitive.
        stop: index after its last primitive.
        also_pressed: names of other targets that it has to press.
    """

    name: str
    goal: Goal
    start: int
    stop: int
    also_pressed: tuple[str, ...] = ()


class Execution(NamedTuple):
    """Record of an executed plan.

    Attributes:
        states: states, the first one included.
        rewards: rewards, one per primitive.
        end: how the episode ended; `STOPPED` if it can continue.
        as_predicted: whether every state equals the predicted one.
    """

    states: tuple[RoomState, ...]
    rewards: tuple[float, ...]
    end: EpisodeEnd
    as_predicted: bool

    def __repr__(self) -> str:
        exact = "as predicted" if self.as_predicted else "not as predicted"
        return f"<Execution: {len(self.rewards)} primitives, return {sum(self.rewards):g}, {self.end.words}, {exact}>"

    @property
    def escaped(self) -> bool:
        """Return whether the robot escaped."""
        return self.end is EpisodeEnd.ESCAPED


@dataclasses.dataclass(frozen=True)
class Plan:
    """A sequence of primitives that reaches a goal.

    Attributes:
        instance: the room.
        name: its goal, in words.
        primitives: action numbers, in order.
        states: predicted states, one more than primitives; the first is the start.
        parts: its legs, in order; they cover all primitives.
        planner: names of the searches that found its legs: `fields`, or a path planner.
        expansions: search nodes expanded for it.
        seconds: wall time of planning it, without compilation, s.
        timed_out: whether the planner's time limit ended the search early.
    """

    instance: RoomInstance
    name: str
    primitives: tuple[int, ...]
    states: tuple[RoomState, ...]
    parts: tuple[PlanPart, ...]
    planner: str
    expansions: int = 0
    seconds: float = 0.0
    timed_out: bool = False

    @property
    def cost(self) -> int:
        """Return the number of primitives in the plan."""
        return len(self.primitives)

    @property
    def path(self) -> NDArray[np.float64]:
        """Return the positions of the body's axis, (primitives + 1, 2), in m."""
        return np.array([(state.x, state.y) for state in self.states], dtype=np.float64).reshape(-1, 2)

    @property
    def also_pressed(self) -> tuple[str, ...]:
        """Return the names of targets that the plan has to press on the way."""
        return tuple(name for part in self.parts for name in part.also_pressed)

    def __repr__(self) -> str:
        legs = ", ".join(part.name for part in self.parts)
        return f"<Plan {self.name}: {self.cost} primitives, return {self.compute_return():g}, by {legs or 'no leg'}>"

    def _repr_html_(self) -> str:
        return make_caption(self.play(), repr(self).strip("<>"))

    def _repr_svg_(self) -> str:
        from hrl_escape.env.pictures.maps import Trajectory, make_map  # loads matplotlib

        return make_svg(make_map(self.instance, self.states[-1], [Trajectory(self.path, self.name)]))

    def compute_return(self) -> float:
        """Return the undiscounted return of the plan as predicted, ignoring the horizon."""
        if self.instance.has_extra_reward:
            rules = Kinematics(self.instance, is_still=True)
            return sum(rules.step(*pair).reward for pair in zip(self.states, self.primitives, strict=False))
        reward, last = self.instance.reward, self.states[-1]
        escapes = self.instance.exit.contains(last.x, last.y) and self.instance.puzzle.is_solved(last.puzzle)
        return reward.step * (self.cost - 1) + reward.on_exit if escapes else reward.step * self.cost

    def execute(self, env: gymnasium.Env) -> Execution:
        """Execute the primitives in an environment, open loop, until the plan or the episode ends.

        Under noise, slip or physics, use an option, which plans again from the state reached.

        Args:
            env: a flat environment of this room, wrapped or not, in the first state of the plan.

        Returns:
            States, rewards, and whether all states were as predicted.

        Raises:
            EscapeError: the environment has another room or none, or is in another state.
        """
        room: Any = env.unwrapped
        if not hasattr(room, "instance"):
            raise EscapeError(f"this plan is for room {self.instance.id}, and {type(room).__name__} is no room")
        if room.instance.id != self.instance.id:
            raise EscapeError(f"this plan is for room {self.instance.id}, the environment has {room.instance.id}")
        states, rewards = [room.get_state()], []
        if strip(states[0]) != strip(self.states[0]):
            raise EscapeError(f"this plan starts at {_describe_pose(self.states[0])}, the environment is at "
                              f"{_describe_pose(states[0])}: plan from env.unwrapped.get_state()")
        end = EpisodeEnd.STOPPED
        for primitive in self.primitives:
            _, reward, terminated, truncated, _ = env.step(primitive)
            states.append(room.get_state())
            rewards.append(float(reward))
            end = EpisodeEnd.of_step(room.rules.has_escaped(states[-1]), terminated, truncated)
            if end.is_over:
                break
        exact = [*map(strip, states)] == [*map(strip, self.states)]
        return Execution(tuple(states), tuple(rewards), end, exact)

    def draw(self, path: str | Path | None = None) -> Any:
        """Draw the plan on the room's map.

        Args:
            path: PNG, SVG or PDF file to write, or None to only return the figure.

        Returns:
            The matplotlib figure.
        """
        from hrl_escape.env.pictures.maps import Trajectory, make_map  # loads matplotlib
        from hrl_escape.figures import save_figure

        points = self.path
        legs = [Trajectory(points[part.start : part.stop + 1], f"{part.name} ({part.stop - part.start})")
                for part in self.parts]
        figure = make_map(self.instance, self.states[0], legs)
        if path is not None:
            save_figure(path, figure)
        return figure

    def play(self, width: int = 480) -> str:
        """Return an HTML frame that plays the plan on the room's map, for notebooks and pages; it loads no other files.

        Args:
            width: width of the frame, in pixels.
        """
        from hrl_escape.env.pictures.moving_map import embed_moving_map, make_moving_map  # loads matplotlib

        decisions = [(part.name, part.stop - part.start) for part in self.parts]
        return embed_moving_map(self.instance, make_moving_map(self.instance, self.states, decisions), width)

    def make_rows(self) -> list[tuple[str, str, str, str]]:
        """Return the plan as rows of text: a header, one row per part, and the total."""
        names = self.instance.robot.actions.names
        rows = [("part", "primitives", "ends at", "actions")]
        for part in self.parts:
            actions = self.primitives[part.start : part.stop]
            counts = ", ".join(f"{count} {names[a]}" for a, count in Counter(actions).items())
            note = f"; also presses {', '.join(part.also_pressed)}" if part.also_pressed else ""
            rows.append((part.name, str(len(actions)), _describe_pose(self.states[part.stop]), counts + note))
        return [*rows, ("total", str(self.cost), "", f"return {self.compute_return():g}")]

    def __str__(self) -> str:
        rows = self.make_rows()
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        return "\n".join("  ".join((*(cell.ljust(wide) for cell, wide in zip(row[:3], widths, strict=True)), row[3]))
                         for row in rows)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: primitives, poses, parts, cost and planner."""
        return {
            "instance": self.instance.id,
            "name": self.name,
            "cost": self.cost,
            "return": self.compute_return(),
            "primitives": list(self.primitives),
            "poses": [[s.x, s.y, s.heading_steps, *s.joint_steps] for s in self.states],
            "parts": [{"name": part.name, "goal": name_goal(part.goal, self.instance), "start": part.start,
                       "stop": part.stop, "also_pressed": list(part.also_pressed)} for part in self.parts],
            "planner": self.planner,
            "expansions": self.expansions,
            "seconds": self.seconds,
            "timed_out": self.timed_out,
        }


def make_planned_room(instance: RoomInstance) -> RoomInstance:
    """Return the room for planning. Under physics, where presses take force, the press margin is 0."""
    if instance.dynamics.kind != "physics":
        return instance
    return dataclasses.replace(instance, dynamics=dataclasses.replace(instance.dynamics, press_margin=0.0))


def strip(state: RoomState) -> RoomState:
    """Reduce a state to what determines the future of a room without noise."""
    return state._replace(primitives=0, noise_key=0, physics=None)


def _describe_pose(state: RoomState) -> str:
    return f"({state.x:.2f}, {state.y:.2f}) heading step {state.heading_steps}"


def join_parts(legs: Sequence[Plan]) -> tuple[PlanPart, ...]:
    """Join the parts of consecutive plans into the parts of one plan."""
    parts, offset = [], 0
    for leg in legs:
        parts += [dataclasses.replace(p, start=p.start + offset, stop=p.stop + offset) for p in leg.parts]
        offset += leg.cost
    return tuple(parts)
