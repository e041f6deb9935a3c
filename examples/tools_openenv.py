"""A room as an OpenEnv environment: `reset` and `step` with typed actions, served to trainers over HTTP.

Requires `pip install openenv` (tried with 0.10.0). Its pinned versions conflict with other frameworks, so this package
has no extra for it. Without it, the script prints this and ends.

    python examples/tools_openenv.py                                    # plays one game in this process
    python examples/tools_openenv.py --serve                            # serves rooms on 127.0.0.1:8000
    python examples/tools_openenv.py --connect http://127.0.0.1:8000    # plays one game there
"""

from __future__ import annotations

import argparse
import importlib.util
from typing import Any

from hrl_escape import EscapeRoomEnv, get_preset
from hrl_escape.text import RoomSession


def make_classes() -> tuple[Any, Any, Any]:
    """Make the classes of the environment, its actions and its observations; imports OpenEnv."""
    from openenv.core.env_server.interfaces import Environment
    from openenv.core.env_server.types import Action, Observation, State

    class ToolAction(Action):
        tool: str
        arguments: dict[str, Any] = {}

    class ToolObservation(Observation):
        text: str
        is_error: bool = False

    class EscapeRoom(Environment[ToolAction, ToolObservation, State]):
        """One room, played by tool calls."""

        SUPPORTS_CONCURRENT_SESSIONS = True

        def __init__(self) -> None:
            super().__init__()
            self._session = RoomSession(EscapeRoomEnv(config=get_preset("paper-two-button")))
            self._state = State()

        def reset(self, seed: int | None = None, episode_id: str | None = None, **given: Any) -> ToolObservation:
            self._state = State(episode_id=episode_id, step_count=0)
            return ToolObservation(text=self._session.reset(seed=seed), reward=0.0)

        def step(self, action: ToolAction, timeout_s: float | None = None, **given: Any) -> ToolObservation:
            before = self._session.score().reward
            result = self._session.call(action.tool, action.arguments)
            self._state.step_count += 1
            return ToolObservation(text=result.text, is_error=result.is_error, done=self._session.env.is_over,
                                   reward=self._session.score().reward - before)

        @property
        def state(self) -> State:
            return self._state

    return EscapeRoom, ToolAction, ToolObservation


def main() -> None:
    """Play or serve."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", action="store_true", help="serve over HTTP and WebSocket")
    parser.add_argument("--port", type=int, default=8000, help="port of the server")
    parser.add_argument("--connect", help="address of a server to play at")
    args = parser.parse_args()
    if importlib.util.find_spec("openenv") is None:
        print("OpenEnv is not installed: pip install openenv")
        return
    room_class, action_class, observation_class = make_classes()
    if args.serve:
        import uvicorn
        from openenv.core.env_server.http_server import create_app

        uvicorn.run(create_app(room_class, action_class, observation_class), host="127.0.0.1", port=args.port)
        return
    calls = [{"tool": "run_option", "arguments": {"option": option}}
             for option in ("press-button-1", "press-button-2", "go-to-exit")]
    if args.connect is not None:
        from openenv.core.generic_client import GenericEnvClient

        with GenericEnvClient(base_url=args.connect) as client:
            print(client.reset(seed=0).observation["text"])
            for call in calls:
                result = client.step(call)
                print(result.observation["text"], result.reward, result.done)
        return
    room = room_class()
    print(room.reset(seed=0).text)
    for call in calls:
        seen = room.step(action_class(**call))
        print(seen.text, seen.reward, seen.done)


if __name__ == "__main__":
    main()
