from .hierarchy_env import HierarchyEnv
from .synthesise import synthesise

__all__ = ["HierarchyEnv", "synthesise"]
