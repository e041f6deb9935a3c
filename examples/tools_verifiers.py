"""Rooms as an environment of verifiers: a taskset of rooms, and the room as the user of the conversation.

Requires `pip install verifiers uv` (tried with 0.4.0) in an environment of its own, because it pins another version of
mcp. Without it, the script prints this and ends. The model is behind any OpenAI-compatible endpoint; verifiers' chat
program runs on this machine, in an environment that uv makes.

    python examples/tools_verifiers.py --model my-model --endpoint http://localhost:8000/v1 --rooms 2

The module is a plugin of verifiers: with `examples` on PYTHONPATH its taskset has the id `tools_verifiers`.
"""

from __future__ import annotations

import argparse
import asyncio
import functools
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

from hrl_escape.sets import make_room
from hrl_escape.text import RoomSession

__all__ = ["RoomEnv", "RoomTaskset"]  # noqa: F822  # made on first use
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


@functools.cache
def make_classes() -> dict[str, Any]:
    """Make the taskset, the environment and its configuration; imports verifiers."""
    import verifiers.v1 as vf

    class RoomData(vf.TaskData):
        number: int

    class RoomTask(vf.Task[RoomData]):
        pass

    class RoomTasksetConfig(vf.TasksetConfig):
        rooms: int = 10

    class RoomTaskset(vf.Taskset[RoomTask, RoomTasksetConfig]):
        def load(self) -> Any:
            for number in range(self.config.rooms):
                session = make_session(number)
                text = session.reset(seed=0)
                options: Any = session.tools()[0]["inputSchema"]["properties"]["option"]["enum"]
                prompt = f"{text}\nOptions: {', '.join(options)}\n{RULES}"
                yield RoomTask(RoomData(name=ROOM.format(number), prompt=prompt, number=number))

    class RoomEnvConfig(vf.EnvConfig):
        player: vf.AgentConfig = vf.AgentConfig.model_validate(
            {"harness": {"id": "null"}, "runtime": {"type": "subprocess"}})  # a chat that runs no code

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

    return {kind.__name__: kind for kind in (RoomTaskset, RoomEnv, RoomEnvConfig)}


def __getattr__(name: str) -> Any:
    """Make the classes that verifiers looks up, on first use."""
    if name not in __all__:
        raise AttributeError(name)
    return make_classes()[name]


async def play(model: str, endpoint: str, key_variable: str, rooms: int) -> None:
    """Play each room once, by verifiers' own episodes."""
    import verifiers.v1 as vf

    made = make_classes()
    env = made["RoomEnv"](made["RoomEnvConfig"].model_validate(
        {"taskset": {"id": "tools_verifiers", "rooms": rooms}, "interception": {"type": "server"}}))
    context = vf.ModelContext(model=model, client=vf.EvalClientConfig(base_url=endpoint, api_key_var=key_variable))
    async with env.serving():
        for task in env.taskset.load():
            episode = await env.run_episode(task, context)
            errors = [*episode.errors, *(error for trace in episode.traces for error in trace.errors)]
            rewards = [{name: reward.score for name, reward in trace.rewards.items()} for trace in episode.traces]
            print(f"{task.data.name}: ok={episode.ok} {rewards} {[error.message for error in errors]}")


def main() -> None:
    """Play some rooms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="my-model", help="name of the model")
    parser.add_argument("--endpoint", default="http://localhost:8000/v1", help="OpenAI-compatible endpoint")
    parser.add_argument("--key-variable", default="OPENAI_API_KEY", help="environment variable with the key")
    parser.add_argument("--rooms", type=int, default=1, help="test rooms")
    args = parser.parse_args()
    if importlib.util.find_spec("verifiers") is None:
        print("verifiers is not installed: pip install verifiers uv")
        return
    sys.path.insert(0, str(Path(__file__).parent))
    asyncio.run(play(args.model, args.endpoint, args.key_variable, args.rooms))


if __name__ == "__main__":
    main()
