from .managers import Model, ToolsAgent, make_model, models
from .recordings import (
    Game,
    RecordedModel,
    load_games,
    record_game,
    replay_game,
    save_games,
    verify_games,
)
from .text_env import REVEAL_LEVELS, RoomSession, Score, TextEnv, ToolCall, ToolResult, Turn

__all__ = [
    "Game",
    "REVEAL_LEVELS",
    "Model",
    "RecordedModel",
    "RoomSession",
    "Score",
    "TextEnv",
    "ToolCall",
    "ToolResult",
    "ToolsAgent",
    "Turn",
    "load_games",
    "make_model",
    "models",
    "record_game",
    "replay_game",
    "save_games",
    "verify_games",
]
