"""Decisions of full coverage: every option from every state that options lead to, in a room without noise."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.agents.components.offline import RecordedDecisions
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.best_known import list_start_states

__all__ = ["Coverage", "cover_room", "make_decisions"]


class Coverage(NamedTuple):
    """Decisions whose observations are numbers of states, the first of them the starts, and the number of actions."""

    decisions: RecordedDecisions
    states: int
    actions: int
    starts: int


def make_decisions(rows: list[dict[str, Any]], gamma: float, actions: int) -> RecordedDecisions:
    """Decisions from rows of state, action, rewards, next state and whether it ends; each a trajectory of its own."""
    count, rewards = len(rows), [row["rewards"] for row in rows]
    legal = np.zeros((max(max(row["state"], row["next"]) for row in rows) + 1, actions), np.bool_)
    for row in rows:
        legal[row["state"], row["action"]] = True
    state, after = (np.array([row[name] for row in rows]) for name in ("state", "next"))
    over = np.array([row["over"] for row in rows])
    discounted = np.array([sum(gamma**i * r for i, r in enumerate(each)) for each in rewards])
    return RecordedDecisions(
        state, np.array([row["action"] for row in rows]), legal[state], discounted, np.array(list(map(sum, rewards))),
        np.array(list(map(len, rewards))), np.array([gamma ** len(each) for each in rewards]), after, legal[after],
        over, np.ones(count, np.bool_), np.arange(count), np.zeros(count, np.int64))


def cover_room(room: RoomInstance, gamma: float, depth: int) -> Coverage:
    """Run every legal option from every state that `depth` decisions, the option itself the last, lead to."""
    env = OptionsEnv(EscapeRoomEnv(instance=room), include_primitives=False)
    flat: Any = env.unwrapped
    env.reset(seed=0)
    numbers: dict[RoomState, int] = {}
    rows: list[dict[str, Any]] = []
    waiting: deque[tuple[RoomState, int]] = deque()

    def find(state: RoomState, left: int) -> int:
        key = state._replace(primitives=0, noise_key=0)
        if key not in numbers:
            numbers[key] = len(numbers)
            waiting.append((key, left))
        return numbers[key]

    for start in list_start_states(room):
        find(start, depth)
    starts = len(numbers)
    while waiting:
        state, left = waiting.popleft()
        if not left:
            continue
        flat.set_state(state)
        for action in np.flatnonzero(env.resume()):
            flat.set_state(state)
            env.resume()
            _, _, over, _, info = env.step(int(action))
            rows.append({"state": numbers[state], "action": int(action), "rewards": env.last_rewards, "over": over,
                         "next": find(flat.get_state(), left - 1) if not over else numbers[state]})
    env.close()
    actions = int(env.action_space.n)
    return Coverage(make_decisions(rows, gamma, actions), len(numbers), actions, starts)
