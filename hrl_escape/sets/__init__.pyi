from .benchmark import Benchmark, certify_rung, list_benchmarks, load_benchmark
from .environments import make_env, make_vec
from .goals import GoalsEnv
from .grammar import find_rooms, find_set, make_room
from .instance_set import InstanceSet, InstanceSetEnv
from .keys import compute_keys
from .room_sequence import RoomSequence
from .room_spec import RoomSpec
from .rung import Rung, derive_hidden_seed
from .sequence import SequenceEnv

__all__ = [
    "Benchmark",
    "GoalsEnv",
    "InstanceSet",
    "InstanceSetEnv",
    "RoomSequence",
    "RoomSpec",
    "Rung",
    "SequenceEnv",
    "certify_rung",
    "compute_keys",
    "derive_hidden_seed",
    "find_rooms",
    "find_set",
    "list_benchmarks",
    "load_benchmark",
    "make_env",
    "make_room",
    "make_vec",
]
