from .catalogue import DataSpec, find_tape, list_specs, parse_spec
from .export import to_minari, to_ogbench, to_torch
from .materialise import DataSet, load_data
from .record import make_played_tape, record
from .tape import Tape, load_tape, save_tape

__all__ = [
    "DataSet",
    "DataSpec",
    "Tape",
    "find_tape",
    "list_specs",
    "load_data",
    "load_tape",
    "make_played_tape",
    "parse_spec",
    "record",
    "save_tape",
    "to_minari",
    "to_ogbench",
    "to_torch",
]
