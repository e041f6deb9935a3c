from .chat import Budget, ChatClient, ChatModel, Reply, Usage
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
from .series import GameSeries
from .text_env import REVEAL_LEVELS, RoomSession, Score, TextEnv, ToolCall, ToolResult, Turn

__all__ = [
    "Budget",
    "ChatClient",
    "ChatModel",
    "Game",
    "GameSeries",
    "REVEAL_LEVELS",
    "Model",
    "RecordedModel",
    "Reply",
    "RoomSession",
    "Score",
    "TextEnv",
    "ToolCall",
    "ToolResult",
    "ToolsAgent",
    "Turn",
    "Usage",
    "load_games",
    "make_model",
    "models",
    "record_game",
    "replay_game",
    "save_games",
    "verify_games",
]
