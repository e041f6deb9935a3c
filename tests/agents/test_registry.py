"""Agents by name: prefixes, recipes, settings, strangers; and what every registered agent must do."""

import functools
import inspect
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import Agent, get_recipe, list_agents, make_agent
from hrl_escape.agents.agent import FixedPolicy, LearningSettings
from hrl_escape.agents.registry import agents, get_agent_class, join_name, register_agent, split_name
from hrl_escape.agents.single_env import serve_one
from hrl_escape.errors import AgentSettingsError, ConfigError, PluginError, UnknownNameError, UnsupportedSpaceError
from tests.agents.running import interact
from tests.agents.small_envs import ButtonGrid
from tests.agents.training.test_resuming import SMALL
from tests.covering import thin
from tests.forks import run_fork

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", list_agents())
def test_the_prefix_names_the_same_implementation_and_the_same_recommended_settings(name):
    assert get_agent_class(join_name(name, True)) is get_agent_class(name)
    assert get_recipe(join_name(name, True)) == get_recipe(name)
    assert split_name(join_name(name, True)) == (name, True) and split_name(name) == (name, False)


def test_a_class_of_ones_own_is_named_like_itself_and_keeps_the_hooks_of_its_other_bases():
    made = []

    class Registering:
        def __init_subclass__(cls, mark: str = "", **named):
            super().__init_subclass__(**named)
            made.append((cls.__name__, mark))

    class Mine(Agent, Registering, mark="first"):
        pass

    class Named(Mine):
        name = "my-own"

    assert made == [("Mine", "first"), ("Named", "")]
    assert (Mine.name, Named.name, type("Later", (Named,), {}).name) == ("Mine", "my-own", "my-own")


@dataclass(frozen=True)
class OwnSettings(LearningSettings):
    rate: float = 0.5


def test_the_annotation_of_settings_says_their_class_which_must_be_found():
    @dataclass(frozen=True)
    class Hidden(LearningSettings):
        pass

    class Mine(Agent):
        settings: "OwnSettings"

    assert Mine.Settings is OwnSettings and type("Heir", (Mine,), {}).Settings is OwnSettings
    with pytest.raises(TypeError, match="Lost: its module has no Hidden"):
        type("Lost", (Mine,), {"__annotations__": {"settings": "Hidden"}})
    told = type("Told", (Mine,), {"__annotations__": {"settings": "Hidden"}, "Settings": Hidden})
    assert told.Settings is Hidden


@pytest.mark.parametrize("name", ["option-critic", "fun", "hamq", "ppo"])
def test_a_loaded_agent_has_forgotten_the_evaluation_that_ran(name):
    env = ButtonGrid(trace=True)
    agent = make_agent(name, env.observation_space, env.action_space, 0)
    rng = np.random.default_rng(0)
    agent.act_greedy(env.reset(seed=0)[0], np.ones(env.action_space.n, bool), rng)
    assert agent.recall(rng) is not None and agent.recall(np.random.default_rng(0)) is None
    agent.load_state_dict(agent.state_dict())
    assert agent.recall(rng) is None


@pytest.mark.parametrize("name", list_agents())
def test_every_agent_keeps_the_protocol(name):
    env = ButtonGrid(trace=True)
    agent = make_agent(name, env.observation_space, env.action_space, 0)
    assert isinstance(agent, Agent)
    assert agent.gamma == agent.settings.gamma


@pytest.mark.nightly_for("torchrl-sac", "rainbow", "torchrl-dqn", "torchrl-ppo")
@pytest.mark.parametrize("name", thin(list_agents(), 3, 2))
def test_trap_11_no_agent_ever_takes_an_illegal_action(name):
    """Least of all the one that it likes best, once that is forbidden."""
    env = ButtonGrid(trace=True, horizon=40)
    agent = make_agent(name, env.observation_space, env.action_space, 0, **SMALL.get(name, {}))
    rng = np.random.default_rng(0)
    for number, transition in enumerate(interact(agent, env, 100)):
        if number % 20:
            continue
        observation, mask = transition.next_observation, np.ones(7, np.bool_)
        for _ in range(3):
            mask[agent.act_greedy(observation, mask, rng)] = False
            assert mask[agent.act_greedy(observation, mask, rng)]
            assert all(mask[serve_one(agent).act(observation, mask)] for _ in range(3))


read_source = functools.cache(inspect.getsource)


@pytest.mark.parametrize("name", list_agents())
def test_every_setting_has_its_sentence(name):
    """The command line shows it; a class that changes a default alone leaves the sentence to the one that brings it."""
    settings = get_agent_class(name).Settings
    source = "\n".join(read_source(c) for c in settings.__mro__ if c.__module__.startswith("hrl_escape"))
    lines = source.splitlines()
    for field in fields(settings):
        declared = [i for i, line in enumerate(lines) if line.startswith(f"    {field.name}: ")]
        assert declared, field.name
        assert lines[declared[-1] + 1].strip().startswith('"""'), field.name  # the class that brings it comes last


def test_the_named_settings_of_2019_are_what_the_published_program_had():
    dqn, sarsa, ddpg = (get_recipe(name, "keras-rl-2019") for name in ("dqn", "sarsa", "ddpg"))
    for settings in (dqn, sarsa, ddpg):
        assert (settings.discounting, settings.bootstrap_on_truncation, settings.clock) == (
            "decision",
            False,
            "decision",
        )
        assert (settings.learning_rate, settings.hidden, settings.gamma) == (1e-3, (16, 16, 16), 0.99)
    assert (sarsa.replay_capacity, sarsa.target_rate, sarsa.expected, sarsa.late_terminal) == (0, 1.0, False, True)
    assert (dqn.exploration, dqn.temperature, sarsa.exploration) == ("boltzmann", 1.0, "boltzmann")
    assert (dqn.boltzmann_clip, sarsa.boltzmann_clip, get_recipe("sarsa").boltzmann_clip) == (500, 500, 0)
    assert (dqn.warmup, dqn.replay_capacity, dqn.target_rate, dqn.batch_size) == (1_000, 50_000, 0.01, 32)
    assert (dqn.n_step, dqn.target_every, dqn.average_rate) == (1, 1, 0)
    assert (ddpg.warmup, ddpg.actor_warmup, ddpg.target_rate, ddpg.max_grad_norm) == (1_000, 100, 1e-3, 1.0)
    widths = [get_recipe(f"smdp-{name}", "keras-rl-2019").hidden[0] for name in ("dqn", "sarsa", "ddpg")]
    assert widths == [3, 32, 4], "the program's widths with meta-actions on"


def test_an_unknown_agent_is_answered_with_the_closest():
    with pytest.raises(UnknownNameError, match="did you mean 'smdp-sarsa'"):
        get_agent_class("smdp-sarsaa")


def test_an_unknown_recipe_or_setting_is_answered_with_what_there_is():
    env = ButtonGrid()
    with pytest.raises(UnknownNameError, match="default, keras-rl-2019, patient"):
        get_recipe("smdp-dqn", "papr")
    with pytest.raises(UnknownNameError, match="did you mean 'learning_rate'"):
        make_agent("dqn", env.observation_space, env.action_space, 0, learning_rte=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gamma": 1.5}, r"DQNSettings.gamma = 1.5 is not possible: a number from 0 to 1"),
        ({"hidden": (64, 0)}, r"hidden\[1\] = 0 is not possible: a whole number of at least 1"),
        ({"hidden": 64}, r"hidden = 64"),
        ({"loss": "l1"}, r"one of 'huber', 'squared'"),
        ({"batch_size": 2.5}, r"whole number"),
        ({"double": 1}, r"true or false"),
        ({"learning_rate": float("nan")}, r"a number above 0"),
        ({"learning_rate": 0}, r"above 0"),
    ],
)
def test_an_impossible_setting_names_field_value_and_range(changes, message):
    env = ButtonGrid()
    with pytest.raises(AgentSettingsError, match=message):
        make_agent("dqn", env.observation_space, env.action_space, 0, **changes)


def test_settings_that_exclude_each_other_are_refused():
    env = ButtonGrid()
    with pytest.raises(AgentSettingsError, match="replay_capacity = 0"):
        make_agent("sarsa", env.observation_space, env.action_space, 0, late_terminal=True)


@pytest.mark.parametrize("name", list_agents())
def test_continuous_actions_are_refused_by_agents_of_discrete_ones(name):
    box = gymnasium.spaces.Box(-1, 1, (3,))
    if "box" in get_agent_class(name).acts_in:
        assert make_agent(name, box, box, 0).made_for == (3,)
        return
    with pytest.raises(UnsupportedSpaceError, match=r"Discrete\(n\) actions"):
        make_agent(name, box, box, 0)


STRANGER = '''
from dataclasses import dataclass
from hrl_escape.agents import Agent

@dataclass(frozen=True)
class AlwaysSettings:
    gamma: float = 0.99
    action: int = 0
    """Which action to take."""

class Always(Agent):
    Settings = AlwaysSettings
    def __init__(self, observation_space, action_space, seed, settings):
        self.settings = settings
    def act(self, observation, action_mask):
        return self.settings.action
    def act_greedy(self, observation, action_mask, rng):
        return self.settings.action
    def observe(self, transition):
        return {}
    def state_dict(self):
        return {}
    def load_state_dict(self, state):
        pass
'''

USE_STRANGER = """
from hrl_escape.agents import list_agents, train
from tests.agents.small_envs import ButtonGrid
assert "always" in list_agents()
result = train("smdp-always", ButtonGrid(), primitives=30, settings={"action": 4}, eval_episodes=1)
print(result.settings, result.evaluations[-1].lengths)
"""


@pytest.mark.nightly
def test_a_strangers_agent_arrives_through_its_entry_point(tmp_path):
    (tmp_path / "stranger.py").write_text(STRANGER)
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hrl_escape.agents]\nalways = stranger:Always\n")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n" + USE_STRANGER
    done = run_fork(code, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("{'gamma': 0.99, 'action': 4}")


def test_an_agent_that_declares_nothing_can_do_no_more_than_the_protocol_asks():
    class Minimal(Agent):
        Settings = dict
        act = act_greedy = observe = state_dict = load_state_dict = lambda *_: 0

    agent = Minimal()
    assert not agent.needs_trace and not agent.recipes
    for ability in (agent.compute_values, agent.compute_preferences, agent.compute_state_value):
        assert ability(None) is None
    assert agent.get_graph() is None


@pytest.mark.nightly_for("monte-carlo-model", "torchrl-sac", "fun", "vigorito-barto")
@pytest.mark.parametrize("name", thin(list_agents(), 3, 1))
def test_every_agent_can_do_what_it_declares(name):
    env = ButtonGrid(trace=True, horizon=40)
    agent = make_agent(name, env.observation_space, env.action_space, 0, **SMALL.get(name, {}))
    (*_, last) = interact(agent, env, 100)
    for numbers in (agent.compute_values(last.observation), agent.compute_preferences(last.observation)):
        assert numbers is None or numbers.shape == (7,)
    value, graph = agent.compute_state_value(last.observation), agent.get_graph()
    assert value is None or np.isfinite(value)
    assert graph is None or all(parent != child for parent, child in graph)
    assert (graph is not None) == (name in (
        "factored-r-max", "hrc", "met-r-max", "monte-carlo-model", "vigorito-barto"))
    assert agent.needs_trace == (name == "intra-option-q")


def test_a_strangers_class_that_is_no_agent_is_refused(monkeypatch):
    from importlib.metadata import EntryPoint

    point = EntryPoint("odd", "collections:OrderedDict", "hrl_escape.agents")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point])
    with pytest.raises(PluginError, match="odd.*hrl_escape.agents.Agent"):
        get_agent_class("smdp-odd")


def test_a_registered_agent_is_made_by_its_name_with_and_without_the_prefix(request):
    class Second(FixedPolicy):
        def __init__(self, observation_space, action_space, seed, settings):
            self.settings = settings

        def act(self, observation, action_mask):
            return int(action_mask.nonzero()[0][0])

    register_agent("first-legal", Second)
    request.addfinalizer(lambda: agents.unregister("first-legal"))
    assert "first-legal" in list_agents()
    for name in ("first-legal", "smdp-first-legal"):
        env = ButtonGrid()
        made = make_agent(name, env.observation_space, env.action_space, 0)
        assert type(made) is Second and made.act(None, np.array([False, True, True])) == 1
    with pytest.raises(ConfigError, match="no other agent has"):
        register_agent("dqn", Second)
    with pytest.raises(ConfigError, match="hrl_escape.agents.Agent"):
        register_agent("number", int)  # type: ignore[arg-type]


def test_tables_and_names_load_no_torch():
    code = """
import sys
from hrl_escape.agents import list_agents, train
from tests.agents.small_envs import ButtonGrid
list_agents(); train("q-learning", ButtonGrid(), primitives=50); train("random", ButtonGrid(), primitives=50)
print("torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
