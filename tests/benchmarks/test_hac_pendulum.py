"""The pendulum of HAC against MuJoCo's, its episodes, and the tables of runs."""

import numpy as np
import pytest

from benchmarks.hac_pendulum import (
    GOALS,
    MOST_ACTIONS,
    TOLERANCE,
    Pendulums,
    compare,
    draw_state,
    measure,
    run,
    summarise,
    swing,
)
from hrl_escape.agents.decisions import Policy
from hrl_escape.agents.training import many_envs


@pytest.mark.parametrize(("begin", "torques", "end"), [
    ((2.0, 0.3), [1.0] * 50, (4.285680314590032, -3.010553742823223)),
    ((-0.5, -4.0), [2.0, -2.0] * 25, (-5.307533574152411, 1.3985758849711116)),
    ((3.1, 0.0), [-2.0] * 100, (2.5932486642749057, -0.9345987716477435))])
def test_motion_is_that_of_mujoco(begin, torques, end):
    state = np.array(begin)[:, None]
    for torque in torques:
        state = swing(state, np.array([torque]))
    np.testing.assert_allclose(state[:, 0], end, atol=1e-12)  # of MuJoCo 3.17 with the authors' model


def test_episodes_end_within_the_tolerance_or_after_the_last_action():
    env, still = Pendulums(3), np.zeros((3, 1), np.float32)
    seen, _ = env.reset(seed=3)
    assert (np.abs(seen["desired_goal"]) <= GOALS).all() and seen["desired_goal"][0, 0] != seen["desired_goal"][1, 0]
    goal = seen["desired_goal"][0]
    env._state = np.array([[goal[0] + 0.9 * TOLERANCE[0], goal[0] + 1.2 * TOLERANCE[0], np.pi], [goal[1], goal[1], 0]])
    env._goal[:] = goal
    after, reward, terminated, truncated, infos = env.step(still)
    assert terminated.tolist() == [True, False, False] and reward.tolist() == [0, -1, -1] and not truncated.any()
    assert infos["_final_obs"].tolist() == [True, False, False]
    assert (infos["final_obs"]["desired_goal"][0] == goal).all() and (after["desired_goal"][0] != goal).any()
    env._state[:, 1:] = np.array([[np.pi], [0]])  # at rest below
    for _ in range(MOST_ACTIONS - 2):
        assert not env.step(still)[3].any()
    assert env.step(still)[3].tolist() == [False, True, True], "the first began one step later"


class Pump(Policy):
    """Brings the energy to that of rest at the top, and holds the pendulum there."""

    def begin_episode(self, rng, num_envs=1):
        pass

    def act(self, batch):
        angle, speed = batch.observation[:, 0].numpy(), batch.observation[:, 1].numpy()
        energy = 0.5 * 0.251 * speed**2 + 9.81 * 0.5 * (np.cos(angle) - 1)
        pump = np.where(energy < 0, np.where(speed >= 0, 2.0, -2.0), -0.1 * speed)
        hold = (-12 * angle - 2.5 * speed).clip(-2, 2)
        return np.where(np.abs(angle) < 0.35, hold, pump)[:, None]


def test_a_controller_reaches_the_top_and_a_still_one_does_not():
    assert measure(Pump())[0] > 0.95
    still = Pump()
    still.act = lambda batch: np.zeros((len(batch.env), 1))
    assert measure(still) == (0.0,)
    angle, speed = draw_state(np.random.default_rng(0), 1_000)
    assert np.cos(angle).max() <= np.cos(np.pi / 4) and np.abs(speed).max() <= 0.05


def test_a_run_is_evaluated_after_equal_parts(monkeypatch):
    monkeypatch.setattr(many_envs, "SEGMENT_PRIMITIVES", 64)  # evaluations are made between segments
    scores = run(2, 0, 512, num_envs=4)
    assert [primitives for primitives, _ in scores] == [64 * number for number in range(1, 9)]
    assert all(0 <= success <= 1 for _, success in scores)


def test_tables_have_means_over_seeds():
    rows = [{"levels": levels, "seed": seed, "primitives": 200, "seconds": 100.0,
             "scores": [[100, 0.1 * levels], [200, 0.2 * levels + 0.01 * seed], [300, 0.1]]}
            for levels in (1, 2) for seed in range(10)]
    lines = summarise(rows).splitlines()
    assert "| 1 | 1000 | 10 | 0.10 (0.10 to 0.10) | 0.25 (0.23 to 0.26) | 0.15" in lines[2]
    assert "| 2 | 32 | 10 | 0.10 (0.10 to 0.10) | 0.45 (0.43 to 0.46) | 0.25" in lines[3]


def test_levels_are_compared_in_the_same_seeds():
    rows = [{"levels": levels, "seed": seed, "scores": [[100, 0.9], [200, 0.1 * (levels - 1) * (seed + 1)]]}
            for levels in (1, 2) for seed in range(10)]
    line = compare(rows).splitlines()[-1]
    assert line.startswith("| 2 - 1 | 10 | +0.55 | +0.") and line.endswith("| 0.002 |")  # 2 of 2^10 signs
    assert compare(rows[:19]) == "", "nine pairs"
