"""Named schematics: the paper's rooms, the published 2019 code's, and a ladder of difficulty."""

from hrl_escape.env.presets.catalogue import PRESETS, describe_schematic, get_preset, make_env_name

__all__ = ["PRESETS", "describe_schematic", "get_preset", "make_env_name"]
