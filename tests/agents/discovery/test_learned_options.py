"""What agents learned, taken over by others as options: through training, a folder, and `OptionsEnv`."""

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from hrl_escape.agents import load_agent, make_agent, train
from hrl_escape.options import OptionsEnv, make_learned_options
from tests.classic.four_rooms import FourRooms

ALL = np.ones(4, np.bool_)


@pytest.mark.nightly
def test_eigenoptions_learned_in_one_task_serve_another_agent_in_another_task(tmp_path):
    """Learned without a goal, saved, loaded, run as options to a goal that was never seen."""
    settings = {"epsilon_end": 1.0, "directions": 4, "gamma": 0.9}
    train("eigenoptions", FourRooms(None, "none"), primitives=6_000, seed=1, settings=settings, eval_episodes=0,
          out=tmp_path / "run")
    agent = load_agent(tmp_path / "run", env=FourRooms(None, "none"))
    options = make_learned_options(agent, 4)
    assert [option.name for option in options] == [f"direction-{n}{sign}" for n in range(1, 5) for sign in "+-"]
    assert all(option.is_markov and option.origin["agent"] == "eigenoptions" for option in options)
    peak = next(cell for cell in range(104) if options[0].termination(cell) == 1.0)
    goal = peak
    env = OptionsEnv(FourRooms(goal, "none", starts=[cell for cell in range(104) if cell != goal]), list(options))
    for seed in range(20):
        _, info = env.reset(seed=seed)
        assert info["action_mask"][4]
        _, _, terminated, _, info = env.step(4)
        assert terminated and info["option"]["name"] == "direction-1+"
    result = train("smdp-q-learning+primitives", env, primitives=300, seed=0, eval_episodes=0)
    assert result.decisions < result.primitives / 2, "another agent learns over them"


def test_options_of_option_critic_draw_from_the_caller_s_generator():
    agent = make_agent("option-critic", Discrete(3), Discrete(4), 0, temperature=1.0)
    rng = np.random.default_rng(0)
    for table in agent._claim(2):
        table[...] = rng.normal(size=table.shape)
    options = make_learned_options(agent, 4)
    assert [option.name for option in options] == [f"option-{n}" for n in range(4)]
    policies, endings = agent.compute_policies(2, ALL), agent.compute_terminations(2)
    for number, option in enumerate(options):
        draws = [[option.sample_action(2, rng) for _ in range(400)] for rng in
                 (np.random.default_rng(seed) for seed in (0, 0))]
        assert draws[0] == draws[1]
        assert np.abs(np.bincount(draws[0], minlength=4) / 400 - policies[number]).max() < 0.1
        assert option.termination(2) == pytest.approx(endings[number])
    assert np.ptp(policies, axis=0).max() > 0.2, "options differ"
