"""A room as a set of tools: what a language model, a protocol's server or a person at a prompt plays through."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.text.settings import Level
from hrl_escape.text.told_env import Score, ToldEnv, ToolCall, Turn


class ToolResult(NamedTuple):
    """Answer to a call.

    Attributes:
        text: what happened, what it cost and what can be done next.
        is_error: the call was wrong; the text says what would be valid.
    """

    text: str
    is_error: bool = False


class RoomSession:
    """Games in a room, played by calls of tools.

        session = RoomSession(OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1")))
        print(session.reset(seed=0))
        print(session.call("run_option", {"option": "press button-1"}).text)

    Args:
        env: options over a room, a flat room, or a `ToldEnv`, whose level then holds.
        told: what a caller is told, one of `TOLD_LEVELS`.

    Attributes:
        env: the environment that tells.

    Raises:
        UnknownNameError: no such level.
        UnsupportedError: there is no room.
    """

    def __init__(self, env: gymnasium.Env, told: Level = "places") -> None:
        self.env = env if isinstance(env, ToldEnv) else ToldEnv(env, told)

    def reset(self, seed: int | None = None) -> str:
        """Begin a game; the text says what there is, as far as it is told. The seed fixes start and noise."""
        self.env.reset(seed=seed)
        return self.env.transcript[-1].text

    def tools(self) -> list[dict[str, Any]]:
        """JSON Schemas of the tools of this game: `name`, `description` and `inputSchema`."""
        return self.env.tools

    def call(self, name: Any, arguments: Any = None) -> ToolResult:
        """Call a tool; whatever the call is, the answer is a text.

        A wrong call costs one primitive, as a masked option does, and so does one of an option that cannot start.
        After the end of a game nothing happens any more.
        """
        env = self.env
        if env.is_over:
            return ToolResult("The game is over: reset begins another.", True)
        env.begin(ToolCall(name, {} if arguments is None else arguments))
        while env.action is not None:
            env.step(env.action)
        return ToolResult(env.transcript[-1].text, env.transcript[-1].is_error)

    def score(self) -> Score:
        """Score of the game so far."""
        return self.env.score()

    @property
    def transcript(self) -> list[Turn]:
        """Turns since the last reset with a seed."""
        return self.env.transcript

    @property
    def log(self) -> list[SMDPTransition]:
        """One SMDP transition a call that took primitives."""
        return self.env.log
