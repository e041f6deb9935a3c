"""The dial of option quality: planned options stand where they were degraded to, learned ones where they belong."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.env import EscapeRoomEnv
from hrl_escape.errors import EscapeError
from hrl_escape.options import OptionDegradation, OptionsEnv
from studies.learned.option_dial import measure_option, place_on_dial

LENGTH = 9
"""Primitives of press-button-1 in the paper's rooms."""
WHOLE = 0.99**LENGTH
CURVE = {failure: [(1 - failure) * WHOLE] * 10 for failure in (0.0, 0.25, 0.5, 1.0)}


def press(calls, seed=0, **degradation):
    env = OptionsEnv(EscapeRoomEnv("paper-two-button"), OptionDegradation(seed=seed, **degradation))
    return measure_option(env, "press-button-1", lambda observation, info: bool(info["buttons_on"][0]), calls, seed)


@pytest.fixture(scope="module")
def curve():
    return {failure: press(150, failure=failure) for failure in (0.0, 0.25, 0.5, 0.75, 1.0)}


@pytest.mark.nightly
def test_a_call_is_worth_its_discount_where_it_arrives_and_nothing_elsewhere(curve):
    assert curve[0.0] == pytest.approx(np.full(150, WHOLE)) and not curve[1.0].any()
    assert set(np.round(curve[0.5], 9)) == {0.0, round(WHOLE, 9)}
    assert press(3, detour=6) == pytest.approx(np.full(3, 0.99 ** (LENGTH + 6)))
    assert not press(2, missing=1.0).any(), "it may not start"


@pytest.mark.nightly
def test_a_planned_option_that_fails_in_four_of_ten_calls_is_placed_there(curve):
    place = place_on_dial(curve, press(400, seed=7, failure=0.4))
    assert place.failure == pytest.approx(0.4, abs=4 * (0.24 / 400 + 0.25 / 150) ** 0.5)
    assert place.low < 0.4 < place.high and place.high - place.low < 0.15


def test_the_place_follows_from_the_curve():
    assert place_on_dial(CURVE, [0.6 * WHOLE] * 50).failure == pytest.approx(0.4)
    assert place_on_dial(CURVE, [0.05 * WHOLE] * 50).failure == pytest.approx(0.95)
    detour = place_on_dial(CURVE, [WHOLE * 0.99**20] * 50)
    assert detour.failure == pytest.approx(1 - 0.99**20), "twenty primitives more are as bad"
    assert place_on_dial(CURVE, [1.0] * 10)[:2] == (0.0, 0.0)
    assert place_on_dial(CURVE, [0.0] * 10).failure == 1.0
    wide, narrow = (place_on_dial(CURVE, np.resize([0.0, WHOLE], runs)) for runs in (4, 400))
    assert wide.low < narrow.low < 0.5 < narrow.high < wide.high


def test_a_curve_that_is_bent_by_chance_is_made_monotone():
    bent = {0.0: [0.9], 0.2: [0.7], 0.4: [0.8], 0.6: [0.3]}
    assert place_on_dial(bent, [0.525] * 20).failure == pytest.approx(0.5)


@pytest.mark.parametrize(("call", "match"), [
    (lambda: press(0), "calls = 0 is not possible"),
    (lambda: measure_option(OptionsEnv(EscapeRoomEnv("paper-two-button")), "press", lambda *_: True, 1),
     "no action is called 'press': there are forward,"),
    (lambda: place_on_dial({0.0: [1.0]}, [1.0]), "needs two points and one run, not 1 and 1"),
    (lambda: place_on_dial(CURVE, []), "not 4 and 0"),
], ids=["no calls", "no option", "no curve", "no run"])
def test_errors_say_what_is_missing(call, match):
    with pytest.raises(EscapeError, match=match):
        call()
