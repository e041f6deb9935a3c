"""Named option sets: one of your own works wherever a shipped one does, and a wrong name is answered."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from hrl_escape import OptionsEnv, train
from hrl_escape.agents.spec import AgentSpec, OptionsView
from hrl_escape.benchmark.grid import Grid
from hrl_escape.cli import main
from hrl_escape.env import EscapeRoomContinuousEnv, EscapeRoomEnv
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.options import (
    BatchedOptionsEnv,
    OptionDegradation,
    find_best_with_options,
    make_go_to,
    make_meta_options,
    register_option_set,
)
from hrl_escape.options.option_sets import option_sets

NAMES = ("press-button-2", "go-home")


def make_second_or_home(planner):
    """Press the second button, or go to the middle of the room."""
    return [make_meta_options(planner.instance, "press", planner)[1], make_go_to(planner, "0,0", "go-home")]


@pytest.fixture(autouse=True)
def registered():
    register_option_set("second-or-home", make_second_or_home)
    yield
    option_sets.unregister("second-or-home")


def test_a_set_of_ones_own_makes_the_options_of_any_room():
    env = OptionsEnv(EscapeRoomEnv("four-button-chain", resample_instance=True), option_set="second-or-home")
    assert env.action_names[-2:] == NAMES
    rooms = set()
    for seed in range(3):
        env.reset(seed=seed)
        rooms.add(env.unwrapped.instance.id)
        info = env.step(env.action_names.index("press-button-2"))[4]
        assert info["option"]["ended"] == "reached" and info["pressed"][1] and not info["also_pressed"].any()
    assert len(rooms) == 3
    one = gymnasium.make("hrl_escape/PaperTwoButtonOptions-v1", option_set="second-or-home", include_primitives=False)
    assert one.get_wrapper_attr("action_names") == NAMES
    worse = OptionsEnv(EscapeRoomEnv(), OptionDegradation(detour=3, option_set="second-or-home"))
    assert worse.action_names[-2:] == NAMES


def test_it_is_trained_on_by_name_and_the_run_keeps_the_name(tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["train", "smdp-q-learning", "--option-set", "second-or-home", "--primitives", "100",
                 "--eval-episodes", "0", "--out", str(out)]) == 0
    assert '"option_set": "second-or-home"' in (out / "run.json").read_text()
    capsys.readouterr()
    assert main(["list", "option-sets"]) == 0
    assert "Press the second button, or go to the middle of the room" in " ".join(capsys.readouterr().out.split())


def test_a_comparison_takes_it():
    spec = AgentSpec("smdp-q-learning", options=OptionsView(option_set="second-or-home"))
    grid = Grid(name="own", agents=(spec,))
    assert Grid.from_dict(grid.to_dict()).agents[0].options.option_set == "second-or-home"
    made = OptionsEnv(EscapeRoomEnv(), option_set=spec.options.option_set, include_primitives=False)
    assert train("smdp-q-learning", made, primitives=50, eval_episodes=0, progress=False).agent is not None


def test_the_best_return_with_it_counts_its_options_alone():
    env = EscapeRoomEnv("paper-two-button")
    env.reset(seed=0)
    state = env.get_state()
    alone = find_best_with_options(env.instance, state, "second-or-home")
    assert alone.primitives is None, "nothing leaves the room"
    assert find_best_with_options(env.instance, state, "press").primitives


@pytest.mark.parametrize("ask", [
    lambda name: OptionsEnv(EscapeRoomEnv(), option_set=name), lambda name: BatchedOptionsEnv(1, option_set=name),
    lambda name: OptionDegradation(option_set=name),
    lambda name: Grid(agents=(AgentSpec("smdp-dqn", options=OptionsView(option_set=name)),)),
    lambda name: make_meta_options(EscapeRoomEnv().instance, name),
    lambda name: find_best_with_options(EscapeRoomEnv().instance, None, name),
    lambda name: OptionsEnv(EscapeRoomContinuousEnv(), option_set=name),
], ids=["one room", "batch", "degraded", "comparison", "options", "best return", "velocities"])
def test_an_unknown_name_is_answered_with_the_closest_and_with_all(ask):
    with pytest.raises(UnknownNameError, match="'second-or-hom'; did you mean 'second-or-home'.* press-with-ancestors"):
        ask("second-or-hom")
    with pytest.raises(UnknownNameError, match="'press-markov'; did you mean 'press-reactive'"):
        ask("press-markov")


def test_what_is_no_name_is_refused_too():
    with pytest.raises(UnknownNameError, match="unknown option set"):
        OptionsEnv(EscapeRoomEnv(), option_set=np.zeros(2))  # type: ignore[arg-type]  # wrong on purpose


def test_a_set_without_a_batched_form_is_refused_by_batches_and_over_velocities():
    with pytest.raises(UnsupportedError, match="'second-or-home' has no batched form: a batch has press and "
                                               "press-with-ancestors; OptionsEnv has every option set"):
        BatchedOptionsEnv(2, option_set="second-or-home")
    with pytest.raises(UnsupportedError, match="options over velocities are those of 'press'"):
        OptionsEnv(EscapeRoomContinuousEnv(), option_set="second-or-home")


def test_a_name_is_taken_once_and_by_functions_alone():
    with pytest.raises(ConfigError, match="a name that no other option set has"):
        register_option_set("press", make_second_or_home)
    with pytest.raises(ConfigError, match="a function of a RoomPlanner"):
        register_option_set("mine", "press")  # type: ignore[arg-type]
