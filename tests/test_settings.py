"""Settings: checks at construction, dicts both ways, documentation from the source, errors that name the field."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.errors import AgentSettingsError, ConfigError, UnknownNameError
from hrl_escape.settings import Range, Settings, describe_fields, read_field_documents, replace_settings


@dataclasses.dataclass(frozen=True)
class Wheel(Settings):
    """One wheel."""

    _section = "wheel"
    radius: Annotated[float, Range(0, 2, "m", open_low=True)] = 0.5
    """Radius,
    without the tyre."""
    spokes: Annotated[int, Range(3)] = 8
    """Number of spokes."""


@dataclasses.dataclass(frozen=True)
class Cart(Settings):
    """A cart with wheels."""

    _section = "cart"
    wheels: tuple[Wheel, ...] = (Wheel(), Wheel())
    """Wheels from front to back."""
    spare: Wheel | None = None
    """Spare wheel."""
    axle: Wheel = Wheel(0.1)
    """The axle, as a small wheel."""
    colour: Literal["red", "blue"] = "red"
    """Colour of the cart."""
    size: tuple[Annotated[float, Range(0, 9)], Annotated[float, Range(0, 9)]] = (1.0, 2.0)
    """Length and width."""
    places: Literal["any"] | tuple[int, ...] = "any"
    """Where it may stand."""
    extras: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Anything else."""
    covered: bool = False
    slip: Annotated[float, Range(0, 1, open_high=True)] = 0.0
    """Share of slip."""

    def check(self) -> None:
        """Refuse a covered red cart."""
        if self.covered and self.colour == "red":
            raise ConfigError("cart.covered", True, "False for a red cart")


@pytest.mark.nightly
@given(st.builds(
    Cart,
    wheels=st.lists(st.builds(Wheel, st.floats(1e-3, 2), st.integers(3, 99)), max_size=3).map(tuple),
    spare=st.none() | st.builds(Wheel), colour=st.sampled_from(["red", "blue"]),
    places=st.just("any") | st.lists(st.integers(), max_size=3).map(tuple), extras=st.just({"a": [1]}),
))
def test_settings_survive_json(cart):
    assert Cart.from_dict(json.loads(json.dumps(cart.to_dict()))) == cart


def test_a_zero_below_zero_is_plain_zero_so_that_equal_settings_are_written_alike():
    below = Cart(slip=-0.0, size=(-0.0, 1))
    assert json.dumps(below.to_dict()) == json.dumps(Cart(slip=0.0, size=(0.0, 1.0)).to_dict())


def test_plain_values_are_converted_at_construction():
    cart = Cart(wheels=[{"radius": 1}, Wheel()], size=[3, 4])  # type: ignore[arg-type]  # what is tested
    assert cart.wheels == (Wheel(1.0), Wheel()) and cart.size == (3.0, 4.0)
    assert isinstance(cart.wheels[0].radius, float) and isinstance(cart.size[0], float)


@pytest.mark.parametrize(("changes", "field", "allowed"), [
    ({"colour": "rad"}, "cart.colour", "one of 'red', 'blue'"),
    ({"size": (1, 10)}, "cart.size[1]", "a number from 0 to 9"),
    ({"size": (1, 2, 3)}, "cart.size", "a list of 2 values"),
    ({"places": "some"}, "cart.places", "one of 'any', or a list, each a whole number"),
    ({"places": (1, True)}, "cart.places", "one of 'any', or a list, each a whole number"),
    ({"spare": 3}, "cart.spare", "a table of fields, or nothing (None)"),
    ({"wheels": 3}, "cart.wheels", "a list of tables"),
    ({"covered": 1}, "cart.covered", "true or false"),
    ({"covered": True}, "cart.covered", "False for a red cart"),
    ({"slip": 1}, "cart.slip", "a number from 0 to below 1"),
    ({"slip": math.nan}, "cart.slip", "a number from 0 to below 1"),
    ({"extras": []}, "cart.extras", "a table"),
])
def test_an_impossible_value_is_refused_by_field_and_what_is_allowed(changes, field, allowed):
    with pytest.raises(ConfigError) as error:
        Cart(**changes)
    assert (error.value.field, error.value.allowed) == (field, allowed)


@pytest.mark.parametrize("radius", [0, -1, 2.1, True, "1", None])
def test_an_impossible_value_of_a_nested_section_names_that_section(radius):
    with pytest.raises(ConfigError, match=r"wheel\.radius = .* is not possible: a number above 0 to 2 m"):
        Cart.from_dict({"spare": {"radius": radius}})


@pytest.mark.parametrize(("data", "message"), [
    ({"colur": "red"}, "unknown cart field 'colur'; did you mean 'colour'?"),
    ({"axel": {"radius": 1}}, "unknown cart section 'axel'; did you mean 'axle'?"),
    ({"wheels": [{"spoke": 4}]}, "unknown wheel field 'spoke'; did you mean 'spokes'?"),
    ({1: 2}, "unknown cart field 1. Known:"),
])
def test_an_unknown_field_names_the_closest(data, message):
    with pytest.raises(UnknownNameError) as error:
        Cart.from_dict(data)
    assert message in str(error.value)


def test_a_missing_field_is_named():
    @dataclasses.dataclass(frozen=True)
    class Axle(Settings):
        length: float

    with pytest.raises(ConfigError, match="a table with the field 'length'"):
        Axle.from_dict({})
    with pytest.raises(ConfigError, match="Axle = 3 is not possible: a table of fields"):
        Axle.from_dict(3)


def test_a_family_of_settings_raises_its_own_error():
    @dataclasses.dataclass(frozen=True)
    class ToySettings(AgentSettings):
        gamma: Annotated[float, Range(0, 1)] = 0.9

    with pytest.raises(AgentSettingsError, match=r"ToySettings\.gamma = 2 is not possible: a number from 0 to 1"):
        ToySettings(gamma=2)
    with pytest.raises(AgentSettingsError, match="a table of fields"):
        ToySettings.from_dict([])
    with pytest.raises(UnknownNameError, match="unknown setting of ToySettings 'gama'; did you mean 'gamma'?"):
        replace_settings(ToySettings(), {"gama": 1})
    assert replace_settings(ToySettings(), {"gamma": 0.5}).gamma == 0.5


def test_descriptions_come_from_annotations_and_the_sentences_under_the_fields():
    radius, spokes = describe_fields(Wheel)
    assert (radius.default, radius.allowed) == (0.5, "a number above 0 to 2 m")
    assert radius.document == "Radius, without the tyre."
    assert spokes.allowed == "a whole number of at least 3"
    assert {field.name for field in describe_fields(Cart) if field.is_section} == {"axle", "spare"}
    assert "covered" not in read_field_documents(Cart)


def test_a_class_without_source_code_has_no_documents():
    space: dict[str, Any] = {}
    exec("import dataclasses\nfrom hrl_escape.settings import Settings\n"
         "@dataclasses.dataclass(frozen=True)\nclass Bare(Settings):\n    width: float = 1.0\n", space)
    assert read_field_documents(space["Bare"]) == {}
    assert space["Bare"](width=2).width == 2.0


def test_no_source_code_is_read_before_documents_are_asked_for():
    program = ("import inspect\ninspect.getsource = None\nfrom hrl_escape.env.config import RoomConfig\n"
               "RoomConfig.from_dict(RoomConfig().to_dict())")
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stderr == ""
