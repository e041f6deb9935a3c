"""Rewards as parts: shaping telescopes, engines agree, and a reward of one's own takes one class."""

import dataclasses
from typing import Annotated

import gymnasium
import numpy as np
import pytest

import hrl_escape
from hrl_escape import OptionsEnv, RoomPlanner, generate
from hrl_escape.cli import main
from hrl_escape.env.presets import get_preset
from hrl_escape.env.rewards import PotentialReward, RewardConfig, TimePenaltyReward, rewards
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.settings import Range


@dataclasses.dataclass(frozen=True)
class EverythingReward(RewardConfig):
    """Pays for every event and for every change of the state, each with a number of its own."""

    kind = "everything"
    scale: Annotated[float, Range(0, 10)] = 1.0
    """Factor of all numbers."""

    def compute_extra(self, before, after, events):
        paid = (3.0 * (events.pressed != 0) + 5.0 * (events.turned_on != 0) + 7.0 * (events.turned_off != 0)
                + 11.0 * (events.opened != 0) + 13.0 * (events.closed != 0) + 17.0 * events.escaped
                + 19.0 * events.failed + 23.0 * (after.heading_steps != before.heading_steps)
                + (after.lit - before.lit) + 0.1 * (after.x - before.x) + 0.01 * (after.y - before.y)
                + 29.0 * after.solved)
        return self.scale * paid


@pytest.fixture(autouse=True)
def registered():
    rewards.register("everything", EverythingReward)
    yield
    rewards.unregister("everything")


def make_config(preset, reward, **changes):
    return dataclasses.replace(get_preset(preset), reward=reward, **changes)


def play(env, actions):
    """Rewards of primitives until the episode ends, and whether it terminated."""
    env.reset(seed=1)
    earned, terminated = [], False
    for action in actions:
        _, reward, terminated, truncated, _ = env.step(action)
        earned.append(reward)
        if terminated or truncated:
            break
    return earned, terminated


def escape(config):
    room = generate(config, 0)
    planner = RoomPlanner(room)
    return room, planner.solve(planner.rules.make_state(room.starts[0]))


def test_potential_based_shaping_telescopes_to_minus_the_first_potential_in_an_escape():
    sparse, shaped = (make_config("paper-two-button", reward)
                      for reward in (RewardConfig(), PotentialReward(weight=8.0, gamma=0.9)))
    _, plan = escape(sparse)
    plain, terminated = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=sparse), plan.primitives)
    paid, _ = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=shaped), plan.primitives)
    assert terminated and len(plain) == len(paid) == plan.cost
    extra = np.array(paid) - np.array(plain)
    assert np.count_nonzero(extra) > 2, "presses and standing with lit buttons change the potential"
    discounts = 0.9 ** np.arange(len(extra))
    assert abs(float(discounts @ extra)) < 1e-9, "no button is on at the start, so Phi(s0) = 0"
    half = len(extra) - 1  # still inside: both buttons are on, Phi = 8
    assert float(discounts[:half] @ extra[:half]) == pytest.approx(0.9**half * 8.0)


def test_a_time_penalty_makes_the_return_minus_the_length():
    config = make_config("paper-two-button", TimePenaltyReward())
    _, plan = escape(config)
    earned, terminated = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=config), plan.primitives)
    assert terminated and sum(earned) == -plan.cost == plan.compute_return()


@pytest.mark.nightly_for(
    "inner-doors-time-penalty", "inner-doors-potential", "lights-out-time-penalty", "lights-out-everything",
    "paper-two-button-potential", "inner-doors-everything", "paper-two-button-time-penalty",
    "paper-two-button-everything")
@pytest.mark.parametrize("reward", [PotentialReward(gamma=0.95), TimePenaltyReward(), EverythingReward(0.5)],
                         ids=lambda reward: reward.kind)
@pytest.mark.parametrize("preset", ["paper-two-button", "inner-doors", "lights-out"])
def test_one_text_pays_the_same_in_a_room_and_in_a_batch(preset, reward):
    config = make_config(preset, reward)
    single = gymnasium.make("hrl_escape/EscapeRoom-v1", config=config)
    many = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, config=config)
    single.reset(seed=7), many.reset(seed=7)
    walk = np.random.default_rng(0).integers(6, size=15).tolist()
    ended = [single.step(action)[1:4] + (many.step(np.array([action, 0]))[1],) for action in walk]
    plan = RoomPlanner(single.unwrapped.instance).solve(single.unwrapped.get_state())
    ended += [single.step(action)[1:4] + (many.step(np.array([action, 0]))[1],) for action in plan.primitives]
    assert [float(batch[0]) for *_, batch in ended] == pytest.approx([one for one, *_ in ended], abs=1e-4)
    assert ended[-1][1], "the plan escapes"


@pytest.mark.nightly
def test_an_escape_and_a_failure_pay_alike_in_a_room_and_in_a_batch():
    config = make_config("paper-two-button", EverythingReward())
    _, plan = escape(config)
    many = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=1, config=config)
    many.reset(seed=1)
    batch = [float(many.step(np.array([action]))[1][0]) for action in plan.primitives]
    earned, terminated = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=config), plan.primitives)
    assert terminated and batch == pytest.approx(earned, abs=1e-4)
    assert earned[-1] == pytest.approx(99.0 + 17.0 + 29.0 + 0.1 * (plan.states[-1].x - plan.states[-2].x)
                                       + 0.01 * (plan.states[-1].y - plan.states[-2].y))
    failing = dataclasses.replace(config, puzzle=dataclasses.replace(config.puzzle, on_violation="fail"))
    room = generate(failing, 0)
    planner = RoomPlanner(room)
    start = planner.rules.make_state(room.starts[0])
    order = [f"press-{operator.target}" for operator in room.symbolic_model.operators]
    wrong = next(name for name in order if _fails(planner, start, name))
    primitives = planner.plan(start, wrong).primitives
    earned, terminated = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=failing), primitives)
    assert terminated and earned[-1] >= -1.0 + 3.0 + 19.0 - 0.2


def _fails(planner, start, name):
    plan = planner.plan(start, name)
    return planner.instance.puzzle.is_failed(plan.states[-1].puzzle)


@pytest.mark.nightly
def test_velocities_pay_the_share_of_a_step_and_the_extra_of_events():
    config = make_config("paper-two-button", PotentialReward(weight=8.0, gamma=1.0))
    single = gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", config=config)
    many = gymnasium.make_vec("hrl_escape/EscapeRoomContinuous-v1", num_envs=1, config=config)
    single.reset(seed=3), many.reset(seed=3)
    total = 0.0
    for _ in range(120):
        action = np.array([0.0, 1.0, 0.0], np.float32)  # strafe left, to the button on the left wall
        _, one, terminated, truncated, info = single.step(action)
        _, two, *_ = many.step(action[None])
        assert two[0] == pytest.approx(one, abs=1e-5)
        total += one
    lit = info["buttons_on"].mean()
    assert total == pytest.approx(-0.1 * 120 + 8.0 * lit) and lit == 0.5


def test_options_sum_and_discount_the_shaped_rewards():
    config = make_config("paper-two-button", PotentialReward(weight=8.0, gamma=0.9))
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config=config), discount=0.9, trace=True)
    env.reset(seed=0)
    mask = env.reset(seed=0)[1]["action_mask"]
    option = next(i for i in np.flatnonzero(mask) if i >= env.primitive_count)
    *_, info = env.step(int(option))
    k = info["duration"]
    plain = -(1 - 0.9**k) / (1 - 0.9)
    lit = info["buttons_on"].mean()
    assert info["discounted_reward"] == pytest.approx(plain + 0.9**k * 8.0 * lit) and lit > 0


def test_plans_and_best_known_returns_count_what_a_reward_adds():
    from hrl_escape.planning.best_known import find_best_known

    config = make_config("paper-two-button", EverythingReward())
    room, plan = escape(config)
    earned, _ = play(gymnasium.make("hrl_escape/EscapeRoom-v1", config=config), plan.primitives)
    assert plan.compute_return() == pytest.approx(sum(earned))
    known = find_best_known(room, plan.states[0])
    assert known.upper_bound == np.inf and known.value == pytest.approx(known.plan.compute_return())


def test_a_batch_refuses_rooms_with_different_rewards():
    rooms = [generate(make_config("paper-two-button", PotentialReward(weight=weight)), 0) for weight in (1.0, 2.0)]
    with pytest.raises(UnsupportedError, match="reward"):
        gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=2, instance=rooms)


# --- in configurations ----------------------------------------------------------------------


def test_the_sparse_reward_is_written_as_before_and_other_kinds_by_name():
    assert RewardConfig().to_dict() == {"step": -1.0, "exit": 100.0, "exit_replaces_step": False}
    shaped = make_config("paper-two-button", PotentialReward(weight=3.0))
    table = shaped.to_dict()
    assert table["reward"]["kind"] == "potential" and table["reward"]["weight"] == 3.0
    assert type(shaped).from_dict(table) == shaped
    room = generate(shaped, 0)
    assert type(room).from_dict(room.to_dict()) == room
    assert room.id != generate(get_preset("paper-two-button"), 0).id


def test_wrong_rewards_are_refused_by_name():
    table = get_preset("paper-two-button").to_dict()
    for reward, error, words in (({"kind": "potental"}, UnknownNameError, "did you mean 'potential'"),
                                 ({"kind": "potential", "wait": 1.0}, UnknownNameError, "weight"),
                                 ({"kind": "potential", "weight": -1.0}, ConfigError, "reward.weight"),
                                 ({"kind": 3}, UnknownNameError, "reward"), (7, ConfigError, "a table of fields")):
        with pytest.raises(error, match=words):
            hrl_escape.RoomConfig.from_dict(table | {"reward": reward})


@pytest.mark.nightly
def test_the_command_line_names_a_reward_and_its_fields(capsys, tmp_path):
    path = tmp_path / "room.json"
    assert main(["room", "--set", "reward.kind=potential", "reward.weight=4", "--save", str(path)]) == 0
    room = hrl_escape.RoomInstance.load(path)
    assert room.reward == PotentialReward(weight=4.0)
    run = tmp_path / "run"
    assert main(["train", "q-learning", "--set", "reward.kind=time-penalty", "--primitives", "20",
                 "--eval-episodes", "1", "--out", str(run)]) == 0
    assert main(["room", "--set", "reward.kind=potental"]) == 2
    assert "potential" in capsys.readouterr().err
