"""Labels of agents: one text means the same agent wherever an agent is named."""

import gymnasium
import pytest

from hrl_escape.agents.label import AgentLabel
from hrl_escape.agents.registry import make_agent
from hrl_escape.agents.training.train import train
from hrl_escape.comparison.grid import AgentSpec, OptionsView
from hrl_escape.errors import AgentSettingsError, UnknownNameError
from hrl_escape.options.memory import DecisionMemory
from hrl_escape.options.options_env import OptionsEnv

LABEL = "smdp-ppo+objects+memory+no-primitives"


def make_room(observation: str = "features", **options: bool) -> OptionsEnv:
    return OptionsEnv(gymnasium.make("hrl_escape/PaperOneButton-v1", observation=observation), **options)


def test_a_label_is_name_recipe_settings_options_and_leaves():
    label = AgentLabel.parse(LABEL)
    assert (label.name, label.recipe, label.settings) == ("smdp-ppo", "", {"network": "objects"})
    assert label.options == {"memory": True, "include_primitives": False} and label.leaves is None
    given = "h-dqn@table+planned"
    assert AgentLabel.parse(given) == AgentLabel(given, "h-dqn", "table", leaves="planned")
    spec = AgentSpec.parse(LABEL)
    assert (spec.label, spec.options) == (LABEL, OptionsView(include_primitives=False, memory=True))
    assert AgentSpec.parse("maxq-q+gru+planned").label == "maxq-q+gru+planned"


@pytest.mark.parametrize(("text", "error"), [
    ("smdp-dqn+object", "unknown trait of an agent 'object'; did you mean 'objects'"),
    ("dqn+no-primitives", "smdp-dqn with \\+no-primitives"),
    ("hamq+planned+learned", "either \\+planned or \\+learned"),
])
def test_a_label_that_means_nothing_is_refused(text, error):
    with pytest.raises((UnknownNameError, AgentSettingsError), match=error):
        AgentLabel.parse(text)


def test_make_agent_takes_labels():
    env = make_room("objects")
    agent = make_agent("smdp-dqn@paper+objects", env.observation_space, env.action_space, 0, gamma=0.9)
    plain = make_agent("smdp-dqn", env.observation_space, env.action_space, 0, "paper", network="objects", gamma=0.9)
    assert agent.settings == plain.settings and agent.settings.network == "objects"
    with pytest.raises(AgentSettingsError, match="table, as in h-dqn@table, or left out"):
        make_agent("h-dqn@table", env.observation_space, env.action_space, 0, "paper")


def test_train_takes_labels_where_the_environment_agrees():
    made = train("smdp-r-max+no-primitives", make_room(include_primitives=False), primitives=60, eval_episodes=1)
    plain = train("smdp-r-max", make_room(include_primitives=False), primitives=60, eval_episodes=1)
    assert made.episodes == plain.episodes and made.agent_name == "smdp-r-max"
    env = DecisionMemory(make_room("objects", include_primitives=False))
    assert train(LABEL, env, primitives=60, eval_episodes=0).agent.settings.network == "objects"


@pytest.mark.parametrize(("label", "needed"), [
    ("smdp-r-max+no-primitives", "OptionsEnv(env, include_primitives=False)"),
    ("smdp-dqn+memory", "DecisionMemory(OptionsEnv(env))"),
    ("smdp-dqn+markov", "OptionsEnv(env, option_set='press-reactive')"),
    ("maxq-q+planned", "HierarchyEnv(env, leaves='planned')"),
])
def test_train_refuses_an_environment_that_disagrees(label, needed):
    with pytest.raises(AgentSettingsError) as refused:
        train(label, make_room(), primitives=60)
    assert needed in str(refused.value)
