"""A room as a game of TextArena for one player: observations and actions are text.

TextArena's loop calls `reset(num_players)`, then `get_observation()` and `step(action)` until the game is done, and
`close()` for the rewards. The reward is the efficiency of the game. This script needs no TextArena and plays one game.
"""

from __future__ import annotations

import json
import re
from typing import Any

from hrl_escape import EscapeRoomEnv, get_preset
from hrl_escape.text import RoomSession

RULES = ('Answer with one call in square brackets, such as [look], [press-button-1] or '
         '[{"tool": "move", "arguments": {"primitive": "forward", "times": 3}}].')


class EscapeRoom:
    """One room. The first bracketed text of an action is the call.

    Args:
        preset: configuration of the room.
        reveal: information in the text: names, places or model.
    """

    def __init__(self, preset: str = "paper-two-button", reveal: Any = "places") -> None:
        self._session = RoomSession(EscapeRoomEnv(config=get_preset(preset)), reveal)
        self._said = ""

    def reset(self, num_players: int = 1, seed: int | None = None) -> None:
        """Start a game for one player; a game without a seed takes seed 0."""
        if num_players != 1:
            raise ValueError(f"a room has one player, got num_players={num_players}")
        begun = self._session.reset(seed=seed or 0)
        options = self._session.tools()[0]["inputSchema"]["properties"]["option"]["enum"]
        self._said = f"{begun}\n{RULES}\nOptions: {', '.join(options)}."

    def get_observation(self) -> tuple[int, str]:
        """Return the player's number and what the room says."""
        return 0, self._said

    def step(self, action: str) -> tuple[bool, dict[str, Any]]:
        """Make a call; return whether the game is over, and details of the step."""
        found = re.search(r"\[(.*)\]", action, re.DOTALL)
        call = found[1].strip() if found else action.strip()
        tool, arguments = "run_option", {"option": call}
        if call == "look":
            tool, arguments = "look", {}
        elif call.startswith("{"):
            try:
                given = json.loads(call)
                tool, arguments = given.get("tool"), given.get("arguments")
            except (ValueError, AttributeError, RecursionError):
                pass  # a wrong call, which costs one primitive
        result = self._session.call(tool, arguments)
        self._said = result.text
        return self._session.env.is_over, {"is_error": result.is_error}

    def close(self) -> tuple[dict[int, float], dict[int, dict[str, Any]]]:
        """Return the rewards of the players and the details of the game."""
        score = self._session.score()
        return {0: score.efficiency}, {0: {"primitives": score.primitives, "escaped": score.escaped,
                                           "invalid_calls": score.invalid_calls}}


if __name__ == "__main__":
    game = EscapeRoom()
    game.reset(num_players=1, seed=0)
    actions = iter(["[look]", "I try [press-button-1]", "[press-button-2]", "[press-button-1]", "[go-to-exit]"])
    done = False
    while not done:
        player, observation = game.get_observation()
        print(observation)
        done, details = game.step(next(actions))
    print(game.get_observation()[1])
    print(game.close())
