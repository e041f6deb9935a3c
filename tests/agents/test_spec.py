"""Agent specs: one text means the same agent wherever an agent is named, and a label of version 0.3 never runs."""

import dataclasses
import pickle

import cloudpickle
import gymnasium
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hrl_escape.agents import Agent, AgentSpec, make_agent, register_agent, train
from hrl_escape.agents.algorithms.dqn import DQN
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.old_specs import NEW_NAMES, convert_label
from hrl_escape.agents.registry import agents, get_agent_class, list_agents, list_hierarchy_agents, list_offline_agents
from hrl_escape.agents.spec import PARTS, REFERENCES, OptionsView
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.errors import AgentSettingsError, UnknownNameError
from hrl_escape.hierarchies import HierarchyEnv
from hrl_escape.options.memory import DecisionMemory
from hrl_escape.options.options_env import OptionsEnv

READER = "smdp-ppo+objects+memory"


def make_room(observation: str = "features", **options: bool) -> OptionsEnv:
    return OptionsEnv(make_flat(observation), **options)


def make_flat(observation: str = "features") -> gymnasium.Env:
    return gymnasium.make("hrl_escape/PaperOneButton-v1", observation=observation)


# --- the grammar -------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "spec"), [
    ("dqn", AgentSpec("dqn")),
    ("smdp-dqn", AgentSpec("smdp-dqn", options=OptionsView(include_primitives=False))),
    ("smdp-dqn+primitives", AgentSpec("smdp-dqn", options=OptionsView(include_primitives=True))),
    (READER, AgentSpec("smdp-ppo", settings={"network": "objects"}, options=OptionsView(memory=True))),
    ("dqn@patient", AgentSpec("dqn", recipe="patient")),
    ("h-dqn@table+planned", AgentSpec("h-dqn", recipe="table", low_level="planned")),
    ("maxq-q+gru+learned", AgentSpec("maxq-q", settings={"memory": "gru"}, low_level="learned")),
    ("dqn(gamma=0.9,hidden=[8,16],loss=squared)",
     AgentSpec("dqn", settings={"gamma": 0.9, "hidden": (8, 16), "loss": "squared"})),
    ("smdp-dqn(options.max_duration=5)+interruptible",
     AgentSpec("smdp-dqn", options=OptionsView(interruptible=True, max_duration=5))),
    ("random-options+primitives", AgentSpec("random-options", options=OptionsView(include_primitives=True))),
    ("search-nearest", AgentSpec("search-nearest")),
])
def test_a_spec_is_read_and_written_alike(text: str, spec: AgentSpec):
    assert AgentSpec.parse(text) == spec and str(spec) == spec.label == text


NAMES_OF_LEARNERS = sorted({*list_agents(), *list_hierarchy_agents(), *list_offline_agents()} - {"random"})
VALUES = st.one_of(st.booleans(), st.integers(-10**6, 10**6), st.floats(allow_nan=False, allow_infinity=False),
                   st.text(st.sampled_from("ab,=()[]{}\"'+@ .1"), max_size=6), st.none(),
                   st.lists(st.integers(0, 99), max_size=3))


@pytest.mark.nightly
@given(name=st.sampled_from(NAMES_OF_LEARNERS), over_options=st.booleans(), settings=st.dictionaries(
    st.sampled_from(["gamma", "hidden", "network", "memory", "max_parents"]), VALUES), recipe=st.sampled_from(
        ["default", "patient", "keras-rl-2019"]), low_level=st.sampled_from([None, "planned", "learned"]),
    options=st.builds(OptionsView, st.booleans(), st.sampled_from(["press", "press-with-ancestors", "press-markov"]),
                      st.booleans(), st.one_of(st.none(), st.integers(1, 99)), st.booleans()))
def test_every_spec_survives_its_text(name, over_options, settings, recipe, low_level, options):
    spec = AgentSpec(f"smdp-{name}" if over_options else name, recipe=recipe, settings=settings, low_level=low_level,
                     options=options)
    again = AgentSpec.parse(str(spec))
    assert again == spec and hash(again) == hash(spec) and pickle.loads(pickle.dumps(spec)) == spec
    assert AgentSpec.from_dict(spec.to_dict()) == spec


def test_settings_of_a_spec_cannot_be_changed():
    spec = AgentSpec("dqn", settings={"hidden": [8]})
    for change in (lambda: spec.settings.update(gamma=1), lambda: spec.settings.pop("hidden"),
                   lambda: spec.settings.__setitem__("gamma", 0.5), lambda: spec.settings.setdefault("gamma", 0.5)):
        with pytest.raises(TypeError, match="cannot be changed"):
            change()
    assert spec.settings == {"hidden": (8,)}


@pytest.mark.parametrize(("text", "error"), [
    ("smdp-dqn+object", "did you mean 'smdp-dqn\\+objects'"),
    ("smdp-dqm+memory", "did you mean 'smdp-dqn'"),
    ("serch-nearest", "did you mean 'search-nearest'"),
    ("dqn+memory", "dqn, which acts with primitives, or smdp-dqn\\+memory, which chooses among options"),
    ("hamq+planned+learned", "either \\+planned or \\+learned"),
    ("dqn(gamma)", "name=value"),
    ("dqn)gamma(", "dqn"),
    ("bayes+primitives", "bayes, which chooses among options alone"),
    ("smdp-random", "random-options"),
    (7, "text of a spec"),
    (dict, "text of a spec"),
])
def test_a_spec_that_means_nothing_is_refused(text: object, error: str):
    with pytest.raises((UnknownNameError, AgentSettingsError), match=error):
        AgentSpec.parse(text)


def test_what_an_agent_chooses_among_is_no_matter_of_its_name():
    assert {name: AgentSpec(name).chooses_options for name in ("random", "random-options", "oracle", "bayes", "sweep",
                                                              TEXT_AGENT, "smdp-dqn", "dqn", "maxq-q")} == {
        "random": False, "random-options": True, "oracle": False, "bayes": True, "sweep": True, TEXT_AGENT: True,
        "smdp-dqn": True, "dqn": False, "maxq-q": False}
    assert not any(AgentSpec(name).learns for name in ("random", "random-options", TEXT_AGENT, *REFERENCES))
    assert all(AgentSpec(name).is_reference for name in (TEXT_AGENT, *REFERENCES))


@pytest.mark.parametrize(("text", "title"), [
    ("dqn", "DQN"),
    ("smdp-dqn", "DQN over options"),
    ("smdp-dqn+primitives", "DQN over options and primitives"),
    (READER, "PPO over options, with memory"),
    ("ppo+objects", "PPO, with object rows"),
    ("smdp-q-learning+reactive", "Q-learning over reactive options"),
    ("maxq-q+planned", "MAXQ-Q, with a planned low level"),
    ("dqn@keras-rl-2019", "DQN, keras-rl-2019 settings"),
    ("dqn(gamma=0.9)", "DQN, gamma 0.9"),
    ("random-options", "random policy over options"),
    ("bayes", "Bayes planner"),
])
def test_a_title_is_for_people(text: str, title: str):
    assert AgentSpec.parse(text).title == title


def test_every_shipped_agent_has_a_title_of_its_own():
    titles = {name: AgentSpec(name).title for name in (*NAMES_OF_LEARNERS, "random", *REFERENCES, TEXT_AGENT)}
    assert len(set(titles.values())) == len(titles)
    assert [name for name, title in titles.items() if title == name] == [
        name for name in titles if name in ("eigenoptions", "option-critic", "oracle")], "these are words"


# --- labels of version 0.3 ---------------------------------------------------------------------


@pytest.mark.parametrize(("label", "spec"), [
    ("smdp-dqn+no-primitives", "smdp-dqn"),
    ("smdp-dqn@paper", "smdp-dqn@keras-rl-2019+primitives"),
    ("dqn@corrected", "dqn"),
    ("dqn+patient", "dqn@patient"),
    ("smdp-factored-r-max+three-parents+no-primitives", "smdp-factored-r-max@three-parents"),
    ("smdp-q-learning+markov", "smdp-q-learning+reactive+primitives"),
    ("smdp-random", "random-options+primitives"),
    ("smdp-random+no-primitives", "random-options"),
    *((old, new) for old, new in NEW_NAMES.items() if old != "smdp-random"),
])
def test_a_label_of_version_0_3_is_refused_with_its_spec(label: str, spec: str):
    assert convert_label(label) == spec == str(AgentSpec.parse(spec))
    for make in (lambda: AgentSpec.parse(label), lambda: train(label, make_room(), primitives=10),
                 lambda: make_agent(label, gymnasium.spaces.Discrete(2), gymnasium.spaces.Discrete(2), 0)):
        with pytest.raises(AgentSettingsError) as refused:
            make()
        assert f"it is {spec} now" in str(refused.value)


def test_an_agent_over_options_of_version_0_3_chose_primitives_too():
    assert convert_label("smdp-dqn") == "smdp-dqn+primitives" and convert_label("dqn") == "dqn"
    assert convert_label("smdp-dqn+objects+memory") == "smdp-dqn+objects+memory+primitives"
    assert convert_label("smdp-iql") == "smdp-iql", "one that learns from data has the choices of the data"
    assert convert_label("maxq-q+planned") == "maxq-q+planned"


# --- the entry points --------------------------------------------------------------------------


def test_make_agent_takes_specs_and_classes():
    env = make_room("objects")
    agent = make_agent("smdp-dqn@keras-rl-2019+objects", env.observation_space, env.action_space, 0, gamma=0.9)
    spec = AgentSpec("smdp-dqn", recipe="keras-rl-2019", settings={"network": "objects"})
    plain = make_agent(spec, env.observation_space, env.action_space, 0, gamma=0.9)
    assert agent.settings == plain.settings and agent.settings.network == "objects"
    made = make_agent(DQN, env.observation_space, env.action_space, 0, network="objects")
    assert type(made) is DQN and made.settings == DQN.Settings(network="objects")


def test_a_class_and_an_instance_are_specs_of_their_names():
    env = make_flat()
    agent = QLearning(env.observation_space, env.action_space, 0, QLearning.Settings(gamma=0.9))
    assert AgentSpec.parse(QLearning) == AgentSpec("q-learning")
    assert AgentSpec.parse(agent) == AgentSpec("q-learning", settings={"gamma": 0.9})

    class Own(QLearning):
        pass

    register_agent("own-learner", Own)
    try:
        assert AgentSpec.parse(Own) == AgentSpec.parse("own-learner")
    finally:
        agents.unregister("own-learner")


def test_a_class_without_a_registered_name_gets_its_own_and_the_latest_definition_counts():
    first, second = (type("Fresh", (QLearning,), {"__module__": __name__}) for _ in range(2))
    clash = type("Clash", (QLearning,), {"name": "dqn"})
    try:
        assert AgentSpec.parse(first) == AgentSpec("Fresh") and get_agent_class("smdp-Fresh") is first
        assert AgentSpec.parse(second) == AgentSpec("Fresh") and get_agent_class("Fresh") is second
        with pytest.raises(AgentSettingsError, match="no other agent has.*register_agent"):
            AgentSpec.parse(clash)
        with pytest.raises(AgentSettingsError, match="defines act, act_greedy, observe too"):
            AgentSpec.parse(Agent)
    finally:
        agents.unregister("Fresh")


def test_a_class_travels_with_its_spec_to_a_process_that_lacks_it():
    spec = AgentSpec.parse(type("Traveller", (QLearning,), {"__module__": "__main__"}))
    packed = cloudpickle.dumps(dataclasses.replace(spec, name="smdp-Traveller", label=""))
    agents.unregister("Traveller")
    try:
        assert pickle.loads(packed).name == "smdp-Traveller" and issubclass(get_agent_class("Traveller"), QLearning)
    finally:
        agents.unregister("Traveller")


def test_train_takes_specs_where_the_environment_agrees():
    made = train("smdp-r-max", make_room(include_primitives=False), primitives=60, eval_episodes=1)
    plain = train(AgentSpec("smdp-r-max"), make_room(include_primitives=False), primitives=60, eval_episodes=1)
    assert made.episodes == plain.episodes and made.agent_name == "smdp-r-max"
    assert train("smdp-q-learning+primitives", make_room(), primitives=60, eval_episodes=0).agent_name == (
        "smdp-q-learning")
    env = DecisionMemory(make_room("objects", include_primitives=False))
    assert train(READER, env, primitives=60, eval_episodes=0).agent.settings.network == "objects"


def test_the_environment_decides_for_a_class():
    for env in (make_flat(), make_room(), make_room(include_primitives=False)):
        assert train(QLearning, env, primitives=60, eval_episodes=0).agent_name == "q-learning"


@pytest.mark.parametrize(("spec", "env", "mends"), [
    ("smdp-r-max", make_room(), ("smdp-r-max+primitives", "OptionsEnv(env, include_primitives=False)")),
    ("smdp-r-max+primitives", make_room(include_primitives=False), ("smdp-r-max,", "OptionsEnv(env)")),
    ("dqn", make_room(), ("smdp-dqn+primitives", "without OptionsEnv")),
    ("random", make_room(include_primitives=False), ("random-options,", "without OptionsEnv")),
    ("smdp-dqn+memory+primitives", make_room(), ("DecisionMemory(OptionsEnv(env))",)),
    ("smdp-dqn+reactive+primitives", make_room(), ("OptionsEnv(env, option_set='press-reactive')",)),
    ("maxq-q+planned", make_flat(), ("HierarchyEnv(env, low_level='planned')",)),
    ("maxq-q+planned", HierarchyEnv(make_flat(), "maxq", "learned"), ("HierarchyEnv(env, low_level='planned')",)),
])
def test_train_refuses_an_environment_that_disagrees(spec: str, env: gymnasium.Env, mends: tuple[str, ...]):
    with pytest.raises(AgentSettingsError) as refused:
        train(spec, env, primitives=60)
    assert all(mend in str(refused.value) for mend in mends), refused.value


def test_every_part_changes_what_it_says():
    plain = AgentSpec("smdp-ppo")
    changed = {word: AgentSpec.parse(f"smdp-ppo+{word}") for word in PARTS if PARTS[word].low_level is None}
    assert len({plain, *changed.values()}) == 1 + len(changed)
    assert all(AgentSpec.parse(f"maxq-q+{word}").low_level == word for word in ("planned", "learned"))
