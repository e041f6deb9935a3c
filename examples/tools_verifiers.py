"""A room as an environment of verifiers: a taskset of rooms, and the room as the user of the conversation.

Requires `pip install verifiers` (0.4) in an environment of its own, because it pins another version of mcp. Without it,
the script prints this and ends.

    python examples/tools_verifiers.py             # plays one game with a scripted agent
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
from typing import Any

from hrl_escape.sets import make_room
from hrl_escape.text import RoomSession

ROOM = "ladder-1/pair/test#{}"
RULES = 'Reply with one call as JSON: {"tool": "run_option", "arguments": {"option": "press-button-1"}}.'


def make_session(number: int) -> RoomSession:
    """Make a game in a test room."""
    from hrl_escape import EscapeRoomEnv

    return RoomSession(EscapeRoomEnv(instance=make_room(ROOM.format(number))), "places")


def answer(session: RoomSession, reply: str) -> str:
    """Make the call of a reply and return the room's answer; a reply without a call costs one primitive."""
    try:
        given = json.loads(reply[reply.index("{"):reply.rindex("}") + 1])
        tool, arguments = given.get("tool"), given.get("arguments")
    except (ValueError, AttributeError, RecursionError):
        tool, arguments = None, None
    return session.call(tool, arguments).text


def make_classes() -> tuple[Any, Any]:
    """Make the taskset and the environment; imports verifiers."""
    import verifiers.v1 as vf

    class RoomData(vf.TaskData):
        number: int

    class RoomTask(vf.Task[RoomData]):
        pass

    class RoomConfig(vf.TasksetConfig):
        rooms: int = 10

    class RoomTaskset(vf.Taskset[RoomTask, RoomConfig]):
        def load(self) -> Any:
            for number in range(self.config.rooms):
                text = make_session(number).reset(seed=0)
                yield RoomTask(RoomData(name=ROOM.format(number), prompt=f"{text}\n{RULES}", number=number))

    class RoomEnvConfig(vf.EnvConfig):
        player: vf.AgentConfig = vf.AgentConfig()

    class RoomEnv(vf.Env[RoomEnvConfig]):
        async def run(self, task: Any, agents: Any) -> None:
            session = make_session(task.data.number)
            session.reset(seed=0)
            async with agents.player.interaction(task) as interaction:
                segment = await interaction.turn()
                while not segment.terminated:
                    said = answer(session, segment.last_reply)
                    if session.env.is_over:
                        break
                    segment = await interaction.turn(said)
            interaction.trace.record_reward("efficiency", session.score().efficiency, 1.0)

    return RoomTaskset, RoomEnv


class Scripted:
    """Agent that takes options in turn, in the place of a model."""

    def __init__(self, options: list[str]) -> None:
        self._options, self.rewards, self.turns = options, dict[str, float](), 0
        self.player = self.trace = self
        self.terminated, self.last_reply = False, ""

    def interaction(self, task: Any) -> Scripted:
        """Begin a conversation."""
        return self

    async def __aenter__(self) -> Scripted:
        return self

    async def __aexit__(self, *error: object) -> None:
        return None

    async def turn(self, said: str = "") -> Scripted:
        """Reply with the next option."""
        option = self._options[self.turns % len(self._options)]
        self.turns += 1
        self.last_reply = f'I call {json.dumps({"tool": "run_option", "arguments": {"option": option}})}'
        return self

    def record_reward(self, name: str, value: float, weight: float = 1.0) -> None:
        """Keep a reward."""
        self.rewards[name] = value * weight


def main() -> None:
    """Play one task."""
    if importlib.util.find_spec("verifiers") is None:
        print("verifiers is not installed: pip install verifiers")
        return
    import verifiers.v1 as vf

    taskset_class, env_class = make_classes()
    tasks = [*taskset_class(next(iter(taskset_class.__orig_bases__)).__args__[1](id="rooms", rooms=2))]
    assert issubclass(env_class, vf.Env) and all(isinstance(task, vf.Task) for task in tasks)
    agent = Scripted(["press-button-1", "press-button-2", "press-button-1", "go-to-exit"])
    asyncio.run(env_class.run(object.__new__(env_class), tasks[0], agent))
    print(f"{tasks[0].data.name}: {agent.turns} turns, {agent.rewards}")


if __name__ == "__main__":
    main()
