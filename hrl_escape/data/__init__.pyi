from .catalogue import DataSpec, find_recording, list_specs, parse_spec
from .export import to_minari, to_ogbench, to_torch
from .materialise import DataSet, load_data
from .record import make_played_recording, record
from .recording import Recording, load_recording, save_recording

__all__ = [
    "DataSet",
    "DataSpec",
    "Recording",
    "find_recording",
    "list_specs",
    "load_data",
    "load_recording",
    "make_played_recording",
    "parse_spec",
    "record",
    "save_recording",
    "to_minari",
    "to_ogbench",
    "to_torch",
]
