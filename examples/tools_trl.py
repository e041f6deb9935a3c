"""Tools of a room for TRL: a class whose public methods are the tools of a model in training.

    trainer = GRPOTrainer(model=..., environment_factory=EscapeRoom, train_dataset=...)

TRL makes an instance per rollout, reads the docstring of each method as the schema of a tool, and calls `get_reward` at
the end. This script needs no TRL and plays one game by hand.
"""

from __future__ import annotations

from typing import Any

from hrl_escape import EscapeRoomEnv, generate, get_preset
from hrl_escape.text import RoomSession


class EscapeRoom:
    """One room per rollout, drawn by the `seed` of the example.

    Args:
        preset: configuration of the rooms.
        reveal: information in the text: names, places or model.
    """

    def __init__(self, preset: str = "paper-two-button", reveal: Any = "places") -> None:
        self._config, self._reveal = get_preset(preset), reveal
        self._session: RoomSession | None = None

    def reset(self, seed: int = 0, **example: Any) -> str:
        """Start a game in the room of this seed and return its first text."""
        self._session = RoomSession(EscapeRoomEnv(instance=generate(self._config, seed)), self._reveal)
        return self._session.reset(seed=seed)

    def run_option(self, option: str) -> str:
        """Run an option to its end, such as driving to a button and pressing it.

        Args:
            option: Name of the option, such as `press-button-1`, or `go-to-exit` for the way out.

        Returns:
            What happened, its cost, and the options that can start next.
        """
        return self._call("run_option", {"option": option})

    def look(self) -> str:
        """Describe the room. This is free.

        Returns:
            The objects, their places, and which are on.
        """
        return self._call("look", {})

    def move(self, primitive: str, times: int = 1) -> str:
        """Repeat one primitive of the robot until something changes.

        Args:
            primitive: Name of the primitive, such as `forward` or `turn-left`.
            times: How often, at most 50.

        Returns:
            What happened and its cost.
        """
        return self._call("move", {"primitive": primitive, "times": times})

    def get_reward(self) -> float:
        """Return the efficiency of the game, from 0 (no escape) to 1 (as fast as the best known plan)."""
        return 0.0 if self._session is None else self._session.score().efficiency

    def _call(self, name: str, arguments: dict[str, Any]) -> str:
        if self._session is None:
            raise ValueError("call reset first")
        return self._session.call(name, arguments).text


if __name__ == "__main__":
    room = EscapeRoom()
    print(room.reset(seed=0))
    for option in ("press-button-1", "press-button-2", "go-to-exit"):
        print(room.run_option(option))
    print(f"reward {room.get_reward():.2f}")
