"""A person as the caller of a room's tools: reads calls from a terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hrl_escape.text.chat import GameStopped
from hrl_escape.text.text_env import ToolCall, Turn

INPUTS = "Type an option or its number, look, a primitive with a number of times, or quit."


class Person:
    """Asks a person for calls. What is shown is the text that a model reads.

    Args:
        name: name in the results.
        read: reads a line.
        show: shows a text.
    """

    def __init__(self, name: str = "person", read: Callable[[str], str] = input, show: Callable[[str], object] = print
                 ) -> None:
        self.name, self._read, self._show = name, read, show

    def __call__(self, transcript: Sequence[Turn], tools: Sequence[Mapping[str, Any]]) -> ToolCall:
        """Return the person's next call; an unknown word is asked for again and costs nothing.

        Raises:
            GameStopped: the person ends the games. The game is played again later.
        """
        schemas = {tool["name"]: tool["inputSchema"]["properties"] for tool in tools}
        options: list[str] = schemas["run_option"]["option"]["enum"]
        primitives: list[str] = schemas["move"]["primitive"]["enum"] if "move" in schemas else []
        self._show(transcript[-1].text)
        if len(transcript) == 1:
            self._show("\n".join(f"{number}: {option}" for number, option in enumerate(options, 1)) + f"\n{INPUTS}")
        while True:
            try:
                word, _, times = self._read("> ").strip().partition(" ")
            except EOFError:
                word, times = "quit", ""
            if word == "quit":
                raise GameStopped("the person stopped", counts=False)
            if word == "look":
                return ToolCall("look", {})
            if word.isascii() and word.isdigit() and 1 <= int(word) <= len(options):
                word = options[int(word) - 1]
            if word in options:
                return ToolCall("run_option", {"option": word})
            if word in primitives:
                return ToolCall("move", {"primitive": word, "times": times or "1"})
            self._show(INPUTS)
