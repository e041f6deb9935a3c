from .benchmark import Benchmark, list_benchmarks, load_benchmark
from .environments import make_env, make_vec
from .goals import GoalsEnv
from .grammar import find_set, make_room
from .instance_set import InstanceSet
from .rung import Rung
from .sequence import SequenceEnv

__all__ = [
    "Benchmark",
    "GoalsEnv",
    "InstanceSet",
    "Rung",
    "SequenceEnv",
    "find_set",
    "list_benchmarks",
    "load_benchmark",
    "make_env",
    "make_room",
    "make_vec",
]
