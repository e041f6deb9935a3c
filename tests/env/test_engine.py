"""The factory of engines: one entry, and the environment runs on it."""

import dataclasses
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from hrl_escape.env import engine
from hrl_escape.env.engine import EngineEntry, film, make_engine, make_renderer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ClosedError, UnknownNameError

RULES_ONLY = '''
from hrl_escape.env.kinematics import Kinematics


class RulesOnly:
    """An engine that is the rules alone, without a body in any simulator."""

    def __init__(self, instance, window=False):
        self.instance, self.rules = instance, Kinematics(instance)
        self.reset(instance.starts[0])

    def reset(self, start, noise_key=0):
        self.state = self.rules.make_state(start, noise_key)
        return self.state

    def set_state(self, state):
        self.state = state

    def step(self, action):
        transition = self.rules.step(self.state, action)
        self.state = transition.state
        return transition

    def close(self):
        pass


class Blind:
    def __init__(self, instance):
        pass
'''


def test_an_engine_of_ones_own_takes_one_entry_and_gives_the_same_episodes(tmp_path, monkeypatch):
    (tmp_path / "planted_engine.py").write_text(RULES_ONLY)
    monkeypatch.syspath_prepend(tmp_path)
    engine.engines.register("rules-only", EngineEntry("planted_engine:RulesOnly", "planted_engine:Blind"))
    config = get_preset("clutter")
    config = dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1))
    envs = [gymnasium.make("hrl_escape/EscapeRoom-v1", config=config, engine=name) for name in ("bullet", "rules-only")]
    seen = [env.reset(seed=5)[0] for env in envs]
    assert np.array_equal(*seen)
    for action in np.random.default_rng(0).integers(6, size=60).tolist():
        ours, theirs = (env.step(action) for env in envs)
        assert np.array_equal(ours[0], theirs[0]) and ours[1:4] == theirs[1:4]
    assert type(envs[1].unwrapped.room).__name__ == "RulesOnly"
    for env in envs:
        env.close()


def test_unknown_engines_and_cameras_are_named_with_the_closest():
    instance = generate(get_preset("paper-one-button"), 0)
    with pytest.raises(UnknownNameError, match="bullet"):
        make_engine(instance, "bulet")
    with pytest.raises(UnknownNameError, match="chase"):
        next(film(instance, [make_engine(instance).state], "chasse"))


def test_a_room_without_a_window_is_drawn_and_closes():
    room = make_engine(generate(get_preset("paper-one-button"), 0))
    assert make_renderer(room.instance).render(room.state, "overhead", 40, 30).shape == (30, 40, 3)
    room.close()
    with pytest.raises(ClosedError):
        room.step(0)


@pytest.mark.nightly
def test_commands_load_no_engine_until_they_need_one():
    script = "import sys, hrl_escape.commands.list, hrl_escape.commands.room; print('pybullet' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", script], text=True).strip() == "False"
