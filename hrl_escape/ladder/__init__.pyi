from .benchmark import Benchmark, list_benchmarks, load_benchmark
from .certificate import certify_rung
from .goals import GoalsEnv
from .hidden import derive_hidden_seed
from .instance_set import InstanceSet, InstanceSetEnv
from .keys import compute_keys
from .rung import Rung
from .sequence import SequenceEnv

__all__ = [
    "Benchmark",
    "GoalsEnv",
    "InstanceSet",
    "InstanceSetEnv",
    "Rung",
    "SequenceEnv",
    "certify_rung",
    "compute_keys",
    "derive_hidden_seed",
    "list_benchmarks",
    "load_benchmark",
]
