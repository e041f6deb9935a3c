from .benchmark import Benchmark, list_benchmarks, load_benchmark
from .certificate import RungCertificate, certify_rung, find_overlaps
from .goals import GoalsEnv
from .hidden import compute_commitment, derive_hidden_seed
from .instance_set import InstanceSet, InstanceSetEnv
from .keys import RoomKeys, compute_keys
from .manifest import Manifest, RungRecord, SetRecord
from .rung import Rung
from .sequence import SequenceEnv

__all__ = [
    "Benchmark",
    "GoalsEnv",
    "InstanceSet",
    "InstanceSetEnv",
    "Manifest",
    "RoomKeys",
    "Rung",
    "RungCertificate",
    "RungRecord",
    "SequenceEnv",
    "SetRecord",
    "certify_rung",
    "compute_commitment",
    "compute_keys",
    "derive_hidden_seed",
    "find_overlaps",
    "list_benchmarks",
    "load_benchmark",
]
