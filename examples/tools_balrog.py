"""A room as an environment of BALROG: actions and observations are texts, and what is no action is counted.

BALROG's `EnvWrapper` takes any `gym.Wrapper` with a `language_action_space`, a `default_action`, observations under
`obs["text"]` and `get_stats()["progression"]`. None of that needs the package; this script plays one game at random.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from hrl_escape import EscapeRoomEnv, OptionsEnv, get_preset
from hrl_escape.text import TextEnv, ToolCall


class EscapeRoomText(gymnasium.Wrapper):
    """Takes an option by its name, and answers in words.

    Args:
        env: a `TextEnv` over options alone.

    Attributes:
        progression: the most of the puzzle that has been solved in the game, from 0 to 1; 1 after an escape.
        failed_candidates: actions that were none, in order.
    """

    def __init__(self, env: TextEnv) -> None:
        super().__init__(env)
        self.told, self.progression = env, 0.0
        self.failed_candidates: list[str] = []

    @property
    def language_action_space(self) -> list[str]:
        """Names of the options of this room."""
        return self.told.tools[0]["inputSchema"]["properties"]["option"]["enum"]

    @property
    def default_action(self) -> str:
        """Action that replaces one that is none: the first option."""
        return self.language_action_space[0]

    def get_instruction_prompt(self) -> str:
        """The text that begins the game."""
        return self.told.transcript[0].text

    def check_action_validity(self, candidate: str) -> str:
        """The action itself, or the default one for a candidate that is none, which is counted."""
        if candidate in self.language_action_space:
            return candidate
        self.failed_candidates.append(candidate)
        return self.default_action

    def reset(self, **arguments: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin a game."""
        _, info = self.env.reset(**arguments)
        self.progression, self.failed_candidates = 0.0, []
        return self._show(), info

    def step(self, action: str) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Carry out the option of this name."""
        self.told.begin(ToolCall("run_option", {"option": self.check_action_validity(action)}))
        _, reward, terminated, truncated, info = self.env.step(self.told.action)
        solved = self.told.instance.puzzle.compute_progress(self.told.state.puzzle)
        self.progression = 1.0 if info["is_success"] else max(self.progression, 0.99 * solved)
        return self._show(), reward, terminated, truncated, info

    def get_stats(self) -> dict[str, Any]:
        """What BALROG keeps of a game."""
        return {"progression": self.progression, "failed_candidates": list(self.failed_candidates)}

    def _show(self) -> dict[str, Any]:
        return {"text": {"long_term_context": self.told.transcript[-1].text, "short_term_context": ""}}


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
