"""A room as an environment of BALROG: actions and observations are text, and invalid actions are counted.

BALROG's `EnvWrapper` takes any `gym.Wrapper` with a `language_action_space`, a `default_action`, observations under
`obs["text"]` and `get_stats()["progression"]`. This script needs no BALROG and plays one game at random.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from hrl_escape import EscapeRoomEnv, OptionsEnv, get_preset
from hrl_escape.text import TextEnv, ToolCall


class EscapeRoomText(gymnasium.Wrapper):
    """Text interface that takes the name of an option and returns a description.

    Args:
        env: a `TextEnv` over options alone.

    Attributes:
        progression: largest share of the puzzle solved in the game, from 0 to 1; 1 after an escape.
        failed_candidates: invalid actions, in order.
    """

    def __init__(self, env: TextEnv) -> None:
        super().__init__(env)
        self.text_env, self.progression = env, 0.0
        self.failed_candidates: list[str] = []

    @property
    def language_action_space(self) -> list[str]:
        """Return the names of the options of this room."""
        return self.text_env.tools[0]["inputSchema"]["properties"]["option"]["enum"]

    @property
    def default_action(self) -> str:
        """Return the action that replaces an invalid one: the first option."""
        return self.language_action_space[0]

    def get_instruction_prompt(self) -> str:
        """Return the text that begins the game."""
        return self.text_env.transcript[0].text

    def check_action_validity(self, candidate: str) -> str:
        """Return the candidate if it is valid; otherwise count it and return the default action."""
        if candidate in self.language_action_space:
            return candidate
        self.failed_candidates.append(candidate)
        return self.default_action

    def reset(self, **arguments: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a game."""
        _, info = self.env.reset(**arguments)
        self.progression, self.failed_candidates = 0.0, []
        return self._show(), info

    def step(self, action: str) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Run the option with this name."""
        self.text_env.begin(ToolCall("run_option", {"option": self.check_action_validity(action)}))
        _, reward, terminated, truncated, info = self.env.step(self.text_env.action)
        solved = self.text_env.instance.puzzle.compute_progress(self.text_env.state.puzzle)
        self.progression = 1.0 if info["is_success"] else max(self.progression, 0.99 * solved)
        return self._show(), reward, terminated, truncated, info

    def get_stats(self) -> dict[str, Any]:
        """Return the statistics of a game for BALROG."""
        return {"progression": self.progression, "failed_candidates": list(self.failed_candidates)}

    def _show(self) -> dict[str, Any]:
        return {"text": {"long_term_context": self.text_env.transcript[-1].text, "short_term_context": ""}}


if __name__ == "__main__":
    options = OptionsEnv(EscapeRoomEnv(config=get_preset("paper-two-button")), include_primitives=False)
    room, rng = EscapeRoomText(TextEnv(options)), np.random.default_rng(0)
    observation, _ = room.reset(seed=0)
    print(room.get_instruction_prompt())
    over, candidates = False, [*room.language_action_space, "ask for the code"]
    while not over:
        observation, _, terminated, truncated, _ = room.step(str(rng.choice(candidates)))
        print(observation["text"]["long_term_context"])
        over = terminated or truncated
    print(room.get_stats())
