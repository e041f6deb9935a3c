from .benchmark import Benchmark, certify_rung, list_benchmarks, load_benchmark
from .goals import GoalsEnv
from .instance_set import InstanceSet, InstanceSetEnv
from .keys import compute_keys
from .places import RoomSpec
from .rung import Rung, derive_hidden_seed
from .sequence import SequenceEnv

__all__ = [
    "Benchmark",
    "GoalsEnv",
    "InstanceSet",
    "InstanceSetEnv",
    "RoomSpec",
    "Rung",
    "SequenceEnv",
    "certify_rung",
    "compute_keys",
    "derive_hidden_seed",
    "list_benchmarks",
    "load_benchmark",
]
