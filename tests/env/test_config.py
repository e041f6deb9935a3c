"""The room configuration: every field refuses what is below, above or of another type, and says so."""

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
from hrl_escape.env.puzzles.places import Capsule
from hrl_escape.errors import ConfigError, UnknownNameError
from hrl_escape.settings import Settings, describe_fields
from tests.covering import thin
from tests.env.rooms import all_configs

PARTS: list[type[Settings]] = [
    RoomConfig, ShapeConfig, RobotConfig, ObstaclesConfig, StartConfig, ExitConfig, RewardConfig, DynamicsConfig,
    Capsule, Panels, Place, Prop, GraphConfig, *(get_puzzle_kind(name).config_type for name in list_puzzles()),
]


def find_hints(part, name):
    """The annotations that a value of a field may answer to, None left out."""
    hint = typing.get_type_hints(part, include_extras=True)[name]
    return [h for h in (typing.get_args(hint) if isinstance(hint, types.UnionType) or typing.get_origin(hint) is
                        typing.Union else (hint,)) if h is not type(None)]


def find_number(part, name):
    """The type and range of a number's field, or None."""
    (hint, *_) = find_hints(part, name)
    if hint in (int, float):
        return hint, None
    return typing.get_args(hint) if typing.get_origin(hint) is typing.Annotated else None


FIELDS = [(part, field) for part in PARTS for field in describe_fields(part)]
NUMBERS = [(p, f) for p, f in FIELDS if find_number(p, f.name)]


def test_every_field_is_documented_and_every_number_has_a_range():
    assert len(NUMBERS) > 50
    for part, field in FIELDS:
        assert field.document, (part, field.name)
    for part, field in NUMBERS:
        _, limits = find_number(part, field.name)
        assert math.isfinite(limits.low) and math.isfinite(limits.high), (part, field.name)


@given(st.sampled_from(NUMBERS), st.floats(1e-6, 1e9), st.booleans())
def test_a_number_outside_its_range_is_refused_by_name(where, beyond, above):
    part, field = where
    kind, limits = find_number(part, field.name)
    value = limits.high + beyond if above else limits.low - beyond
    value = (math.ceil(value) if above else math.floor(value)) if kind is int else value
    with pytest.raises(ConfigError) as error:
        part(**{field.name: value})
    assert error.value.field.endswith(field.name)
    assert repr(value) in str(error.value)
    assert format(limits.low, "g") in error.value.allowed


ODDITIES = [math.nan, math.inf, "seven", b"7", True, 1.5, 3, [], {}, object(), None]


@given(st.sampled_from(FIELDS), st.sampled_from(ODDITIES))
def test_a_value_of_another_type_is_refused_by_name(where, value):
    part, field = where
    hints = find_hints(part, field.name)
    kinds = [typing.get_origin(h) or h if typing.get_origin(h) is not typing.Annotated else typing.get_args(h)[0]
             for h in hints]
    fits = (
        (value is None and "None" in field.allowed)
        or (float in kinds and type(value) in (int, float) and math.isfinite(value))
        or (int in kinds and type(value) is int)
        or (bool in kinds and type(value) is bool)
        or (str in kinds and type(value) is str)
        or (tuple in kinds and value == [])
        or (field.is_section and value == {})
    )
    if fits:
        return
    with pytest.raises(ConfigError) as error:
        part(**{field.name: value})
    assert field.name in error.value.field


@pytest.mark.parametrize("name", thin(sorted(all_configs()), 3))
def test_a_room_configuration_survives_its_dict(name):
    import json

    config = all_configs()[name]
    assert RoomConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_unknown_fields_and_puzzles_are_named():
    with pytest.raises(UnknownNameError, match="unknown config section 'rom'; did you mean 'room'"):
        RoomConfig.from_dict({"rom": {"width": 30}})
    with pytest.raises(UnknownNameError, match="unknown robot field 'body_radus'; did you mean 'body_radius'"):
        RoomConfig.from_dict({"robot": {"body_radus": 1}})
    with pytest.raises(UnknownNameError, match="did you mean 'buttons'"):
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
