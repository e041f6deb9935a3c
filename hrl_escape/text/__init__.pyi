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
from .settings import TOLD_LEVELS
from .told_env import RoomSession, Score, ToldEnv, ToolCall, ToolResult, Turn

__all__ = [
    "Game",
    "TOLD_LEVELS",
    "Model",
    "RecordedModel",
    "RoomSession",
    "Score",
    "ToldEnv",
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
