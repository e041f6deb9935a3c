"""Profiles by axis: numbers, radar and the choice of rungs, from made-up efficiencies."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.references import choose_levels
from hrl_escape.benchmark.reporting.figures import AxisScore, draw_radar, list_references, make_profiles
from hrl_escape.benchmark.rung_references import RungReferences
from hrl_escape.sets.manifest import AxisRecord

AXES = (AxisRecord("depth", ("depth-1", "depth-2")), AxisRecord("noise", ("noise-1", "noise-2")),
        AxisRecord("arm", ("arm-1",)))


def test_an_axis_has_a_value_once_all_its_rungs_were_run():
    profiles = make_profiles(AXES, {"me": {"depth-1": 0.9, "depth-2": 0.5, "noise-1": 0.4}, "other": {"arm-1": 1.0}})
    assert profiles["me"]["depth"].value == pytest.approx(0.7) and str(profiles["me"]["depth"]) == "0.70 (0.90 0.50)"
    assert profiles["me"]["noise"] == AxisScore((0.4, None)) and profiles["me"]["noise"].value is None
    assert str(profiles["me"]["noise"]) == "(0.40 -)"
    assert set(profiles["me"]) == {"depth", "noise"} and set(profiles["other"]) == {"arm"}


def test_references_are_columns_of_their_own():
    found = list_references({"depth-1": RungReferences(0.3, 0.8, "search-random", 1.0, 0.9),
                             "arm-1": RungReferences(0.1, 0.2, "search-backtrack", 1.0)})
    assert found == {"random policy": {"depth-1": 0.3, "arm-1": 0.1},
                     "best search baseline": {"depth-1": 0.8, "arm-1": 0.2}, "Bayes planner": {"depth-1": 0.9}}
    assert list_references({}) == {}


def test_the_radar_draws_each_value_on_its_spoke_and_breaks_where_none_is():
    profiles = make_profiles(AXES, {"me": {"depth-1": 0.8, "depth-2": 0.6, "arm-1": 0.25},
                         "random policy": {"arm-1": 0.1}})
    panel, = draw_radar(profiles, AXES).axes
    lines = {line.get_label(): line for line in panel.get_lines()}
    assert np.allclose(lines["me"].get_xdata(), np.array([0, 1, 2, 0]) * 2 * math.pi / 3)
    assert np.allclose(lines["me"].get_ydata(), [0.7, math.nan, 0.25, 0.7], equal_nan=True)
    assert lines["random policy"].get_color().startswith("#8b") and not lines["me"].get_color().startswith("#8b")
    assert [text.get_text() for text in panel.get_xticklabels()] == ["depth", "noise", "arm"]


@pytest.mark.parametrize(("curve", "chosen"), [
    ([0.95, 0.84, 0.6, 0.5, 0.31], [1, 2, 4]),
    ([0.95, 0.9, 0.9, 0.9], [1, 2, 3]),  # what never falls is taken from its end
    ([0.2, 0.1, 0.05], [0, 1, 2]),
])
def test_rungs_are_the_candidates_nearest_to_the_targets_in_order(curve, chosen):
    assert choose_levels(curve, (0.85, 0.6, 0.3)) == chosen
