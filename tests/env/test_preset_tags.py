"""Tags of presets agree with their room configurations, and find them."""

from __future__ import annotations

import pytest

from hrl_escape.env import PRESETS, generate, get_preset, list_presets
from hrl_escape.env.presets import TAGS
from hrl_escape.errors import UnknownNameError


@pytest.mark.nightly_for("puddle-world")
@pytest.mark.parametrize("name", PRESETS)
def test_tags_agree_with_the_configuration(name: str):
    config = get_preset(name)
    facts = {
        "buttons": config.puzzle.kind == "buttons",
        "grid world": config.dynamics.blocked == "stay",
        "arm": config.robot.joints > 0,
        "gripper": config.robot.gripper,
        "obstacles": config.obstacles.count != 0,
        "physics": config.dynamics.kind == "physics",
        "stochastic": config.dynamics.is_random or generate(config, 0).puzzle.is_random,
    }
    assert {tag: tag in TAGS[name] for tag in facts} == facts


def test_presets_are_found_by_all_of_several_tags():
    assert list_presets() == list(PRESETS) == list(TAGS)
    assert list_presets("grid world", "gripper") == ["taxi", "foraging", "door-key", "key-corridor", "multi-room"]
    with pytest.raises(UnknownNameError, match="grid world"):
        list_presets("grid-world")
