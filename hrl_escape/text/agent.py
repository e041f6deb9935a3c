"""The agent `smdp-tools`: whatever calls tools, in the loops that train, evaluate, compare and show agents."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.fixed_policy import FixedPolicy
from hrl_escape.text.managers import Model
from hrl_escape.text.settings import ToolsSettings
from hrl_escape.text.told_env import find_told_env


class ToolsAgent(FixedPolicy):
    """Asks a model for a call of a tool at every decision; nothing is learned.

        env = ToldEnv(OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1")), told="names")
        evaluate(ToolsAgent(env, model), env, episodes=20)

    Args:
        env: where it acts; a `ToldEnv` is among its wrappers, and reads the calls.
        model: transcript and tools' schemas -> call. Whatever it says, the game goes on; see `RoomSession.call`.

    Attributes:
        caller: name of the model, by which runs are told apart: its attribute `name`, or that of its function or class.
    """

    Settings: ClassVar[type] = ToolsSettings
    STATE = ("caller",)

    def __init__(self, env: gymnasium.Env, model: Model) -> None:
        self.settings = ToolsSettings()
        self.told, self.model = find_told_env(env), model
        self.caller = str(getattr(model, "name", None) or getattr(model, "__qualname__", type(model).__qualname__))
        self._rng = np.random.default_rng(0)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """As in an evaluation, with chance of its own."""
        return self.act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Action of the call in progress, or of the next; of a wrong call the first legal one, which is not taken."""
        if hasattr(self.model, "rng"):
            vars(self.model)["rng"] = rng
        while self.told.action is None:
            self.told.begin(self.model(self.told.transcript, self.told.tools))
        return self.told.action if self.told.action >= 0 else int(np.flatnonzero(action_mask)[0])
