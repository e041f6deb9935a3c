"""The schematic: every field refuses what is below, above or of another type, and says so."""

import dataclasses
import math
import types
import typing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.env.config import (
    DynamicsConfig,
    ExitConfig,
    ObstaclesConfig,
    RewardConfig,
    RobotConfig,
    RoomConfig,
    ShapeConfig,
    StartConfig,
)
from hrl_escape.env.puzzles.base import Panels, Place, Prop, get_puzzle_kind, list_puzzles
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.settings import Settings
from hrl_escape.errors import ConfigError, UnknownNameError
from tests.env.rooms import all_schematics

PARTS: list[type[Settings]] = [
    RoomConfig, ShapeConfig, RobotConfig, ObstaclesConfig, StartConfig, ExitConfig, RewardConfig, DynamicsConfig,
    Panels, Place, Prop, GraphConfig, *(get_puzzle_kind(name).config_type for name in list_puzzles()),
]


def kind_of(part, field):
    """The plain type of a field, and whether None may stand in it."""
    hint = typing.get_type_hints(part)[field.name]
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    return next(option for option in options if option is not type(None))


FIELDS = [(part, field) for part in PARTS for field in dataclasses.fields(part)]
NUMBERS = [(p, f) for p, f in FIELDS if kind_of(p, f) in (int, float)]


def test_every_field_is_documented_and_every_number_has_a_range():
    for part, field in FIELDS:
        knob = field.metadata["knob"]
        assert knob.doc, (part, field.name)
        if kind_of(part, field) in (int, float):
            assert knob.low is not None and knob.high is not None, (part, field.name)


@given(st.sampled_from(NUMBERS), st.floats(1e-6, 1e9), st.booleans())
def test_a_number_outside_its_range_is_refused_by_name(where, beyond, above):
    part, field = where
    knob = field.metadata["knob"]
    value = knob.high + beyond if above else knob.low - beyond
    value = (math.ceil(value) if above else math.floor(value)) if kind_of(part, field) is int else value
    with pytest.raises(ConfigError) as error:
        part(**{field.name: value})
    assert error.value.field.endswith(field.name)
    assert repr(value) in str(error.value)
    assert format(knob.low, "g") in error.value.allowed


ODDITIES = [math.nan, math.inf, "seven", b"7", True, 1.5, 3, [], {}, object(), None]


@given(st.sampled_from(FIELDS), st.sampled_from(ODDITIES))
def test_a_value_of_another_type_is_refused_by_name(where, value):
    part, field = where
    kind, knob = kind_of(part, field), field.metadata["knob"]
    fits = (
        (value is None and knob.optional)
        or (kind is float and type(value) in (int, float) and math.isfinite(value))
        or (isinstance(kind, type) and kind is not float and type(value) is kind)
        or (value == [] and "tuple" in str(typing.get_type_hints(part)[field.name]))
        or (type(value) is str and kind is str)
    )
    if fits:
        return
    with pytest.raises(ConfigError) as error:
        part(**{field.name: value})
    assert field.name in error.value.field


@pytest.mark.parametrize("name", sorted(all_schematics()))
def test_a_schematic_survives_its_dict(name):
    import json

    config = all_schematics()[name]
    assert RoomConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_unknown_fields_and_puzzles_are_named():
    with pytest.raises(ConfigError, match=r"robot\.body_radus.*body_radius"):
        RoomConfig.from_dict({"robot": {"body_radus": 1}})
    with pytest.raises(UnknownNameError, match="Perhaps you meant 'buttons'"):
        RoomConfig.from_dict({"puzzle": {"kind": "butons"}})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: RobotConfig(turn_step_deg=7), "divisor of 360"),
        (lambda: RobotConfig(kind="urdf"), "URDF text"),
        (lambda: RobotConfig(kind="kuka-iiwa"), "robot.joints"),
        (lambda: RoomConfig(dynamics=DynamicsConfig(press_with="hand")), "joints >= 1"),
        (lambda: RoomConfig(room=ShapeConfig(rooms=2, doorway_width=1.0)), "doorway_width"),
        (lambda: RoomConfig(room=ShapeConfig(width=5), robot=RobotConfig(body_radius=3)), "fits into the room"),
        (lambda: RoomConfig(exit=ExitConfig(door=True, width=1)), "exit.width"),
        (lambda: ObstaclesConfig(size_min=3, size_max=2), "size_min"),
        (lambda: StartConfig(place="fixed", choices=3), "start.choices"),
        (lambda: get_puzzle_kind("buttons").config_type(count=2, goal=2), "button from 0 to 1"),
        (lambda: get_puzzle_kind("buttons").config_type(count=5, buttons=Panels(places="paper")), "at most 4"),
        (lambda: get_puzzle_kind("buttons").config_type(
            count=3, graph=GraphConfig(kind="edges", edges=((0, 1), (1, 0)))), "cycles"),
        (lambda: GraphConfig(edges=((0, 1),)), "graph.kind is 'edges'"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(make, words):
    with pytest.raises(ConfigError, match=words):
        make()
