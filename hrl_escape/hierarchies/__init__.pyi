from .hierarchy_env import HierarchyEnv, HierarchyVectorEnv
from .synthesise import synthesise

__all__ = ["HierarchyEnv", "HierarchyVectorEnv", "synthesise"]
