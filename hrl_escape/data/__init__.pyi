from .catalogue import DataSpec, find_recording, list_specs, parse_spec
from .export import to_minari, to_ogbench, to_torch
from .materialise import DataSet, load_data
from .played import from_minari, record_play
from .played_data import PlayedData
from .record import make_played_recording, record
from .recording import Recording, load_recording, save_recording

__all__ = [
    "DataSet",
    "DataSpec",
    "PlayedData",
    "Recording",
    "find_recording",
    "from_minari",
    "list_specs",
    "load_data",
    "load_recording",
    "make_played_recording",
    "parse_spec",
    "record",
    "record_play",
    "save_recording",
    "to_minari",
    "to_ogbench",
    "to_torch",
]
