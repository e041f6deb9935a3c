"""Values show themselves in a notebook: one line as text, a figure or a moving map as a picture."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import gymnasium
import pytest

from hrl_escape import EscapeRoomEnv, OptionsEnv, RoomInstance, RoomPlanner, generate, get_preset, train
from hrl_escape.benchmark.comparison import read_comparison, run_grid
from hrl_escape.benchmark.grid import Grid, RoomSpec
from hrl_escape.benchmark.summary import summarise
from hrl_escape.benchmark.verdict import write_verdict
from hrl_escape.planning import ArmPlanner
from hrl_escape.planning.plan import Plan
from hrl_escape.sets import load_benchmark
from hrl_escape.text import RoomSession


@pytest.fixture(scope="module")
def room() -> RoomInstance:
    return generate(get_preset("inner-doors"), 1)


@pytest.fixture(scope="module")
def plan(room: RoomInstance) -> Plan:
    return RoomPlanner(room).solve(make_env(room).get_state())


def make_env(room: RoomInstance) -> EscapeRoomEnv:
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room).unwrapped
    assert isinstance(env, EscapeRoomEnv)
    env.reset(seed=0)
    return env


def is_line(value: object, *parts: str) -> bool:
    text = repr(value)
    return "\n" not in text and len(text) < 200 and all(part in text for part in parts)


def count_shapes(svg: str) -> int:
    return len(list(ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}path")))


def read_map(frame: str) -> dict:
    """What the script inside a frame is given."""
    page = html.unescape(re.search(r'srcdoc="([^"]*)"', frame)[1])  # type: ignore[index]  # there is one
    assert not re.search(r"(?:src|href)=|https?:|@import|fetch\(", page), "the page would load something"
    return json.loads(re.search(r"const data = (.*);\n", page)[1])  # type: ignore[index]  # there is one


def test_a_room_and_a_set_are_drawn(room: RoomInstance):
    assert is_line(room, "inner-doors", "seed 1", room.id)
    rung = load_benchmark("ladder-1")["pair"]
    assert is_line(rung, "pair") and is_line(rung.train, "1000 rooms")
    few, many = rung.train[:1], rung.train[:6]
    assert count_shapes(rung._repr_svg_()) == count_shapes(many._repr_svg_()) > 3 * count_shapes(few._repr_svg_())
    assert count_shapes(room._repr_svg_()) > len(room.solids)


def test_a_plan_plays_its_own_states(room: RoomInstance, plan: Plan):
    assert is_line(plan, "escape", f"{plan.cost} primitives", f"return {plan.compute_return():g}")
    data = read_map(plan._repr_html_())
    frames, puzzle = data["replay"]["frames"], room.puzzle
    assert frames["x"] == [round(state.x, 3) for state in plan.states]
    assert sum(count for _, count, _ in data["replay"]["decisions"]) == plan.cost
    shut = dict(frames["shut"])
    now: list[int] = []
    for number, state in enumerate(plan.states):
        now = shut.get(number, now)
        assert now == [door for door in range(len(room.inner_doors)) if puzzle.get_shut(state.puzzle) >> door & 1]
    assert len(shut) > 1 and dict(frames["open"]) == {0: False, max(dict(frames["open"])): True}


def test_an_execution_says_how_it_ended(room: RoomInstance, plan: Plan):
    assert is_line(plan.execute(make_env(room)), f"{plan.cost} primitives", "escaped", ", as predicted")


def test_a_result_draws_its_curve():
    env = OptionsEnv(gymnasium.make("hrl_escape/PaperOneButton-v1"))
    result = train(agent="smdp-q-learning+primitives", env=env, primitives=300, seed=0)
    assert is_line(result, "smdp-q-learning", f"{result.primitives:,} primitives")
    line = result.plot("success_rate", "decisions").axes[0].lines[0]
    assert line.get_xydata().tolist() == [[e.decisions, e.success_rate] for e in result.evaluations]
    assert count_shapes(result._repr_svg_()) > 5
    together = result.plot(beside=[result])
    assert len(together.axes[0].lines) == len(together.axes[0].collections) == 1  # equal agents: a line and a band
    assert count_shapes(together._repr_svg_()) > 5  # type: ignore[attr-defined]


@pytest.mark.nightly
def test_a_reach_map_draws_itself():
    small = generate(get_preset("arm-two-button"), 1)
    arm = ArmPlanner(small)
    reach = arm.map_reach(arm.rules.get_hand(arm.rules.make_state(small.starts[0])))
    assert is_line(reach, f"{reach.share.max():.0%}") and count_shapes(reach._repr_svg_()) > len(small.solids)


def test_a_comparison_draws_its_agents_curves(tmp_path: Path):
    grid = Grid(agents=("random", "random-options"), rooms=(RoomSpec("paper-one-button"),), runs=1,
                primitives=200)
    run_grid(grid, tmp_path)
    comparison = read_comparison(tmp_path)
    assert is_line(comparison, "2 agents", "2 finished runs")
    assert count_shapes(comparison._repr_svg_()) > 5
    summary = summarise(comparison)
    assert is_line(summary, "2 agents", "random-options") and is_line(summary.agents[0]) and is_line(
        summary.agents[0].curve)
    assert summary._repr_svg_() == comparison._repr_svg_()
    verdict = write_verdict(summary)
    assert repr(verdict).splitlines()[0] == verdict[0].text and len(repr(verdict).splitlines()) == len(verdict)
    page = verdict._repr_html_()
    assert page.count("<li>") == len(verdict) - 1 and "<code>random-options</code>" in page and "`" not in page


def test_options_show_their_actions_the_mask_and_the_last_decision():
    env = OptionsEnv(gymnasium.make("hrl_escape/PaperTwoButton-v1"))
    assert "No episode has begun" in env._repr_html_() and ">yes<" not in env._repr_html_()
    env.reset(seed=0)
    env.step(env.action_names.index("press-button-1"))
    shown = ElementTree.fromstring(env._repr_html_())
    rows = [[cell.text for cell in row] for row in shown.iter("tr")]
    assert rows[0] == ["action", "name", "legal", "kind"] and len(rows) == 1 + len(env.action_names)
    assert [legal == "yes" for _, _, legal, _ in rows[1:]] == env.action_masks().tolist()
    caption, decision = shown.find("figcaption").text, env.last_decision  # type: ignore[union-attr]
    length, reward = decision["duration"], decision["summed_reward"]
    assert f"press-button-1, {length} primitives, reached, reward {reward:g}" in caption


def test_a_session_shows_its_room_and_its_last_turns():
    session = RoomSession(OptionsEnv(gymnasium.make("hrl_escape/PaperTwoButton-v1")))
    assert is_line(session, "0 turns") and count_shapes(session._repr_svg_()) > 4
    session.reset(seed=0)
    session.call("run_option", {"option": "press-button-1"})
    assert is_line(session, "2 turns")
    assert "run_option {'option': 'press-button-1'}" in html.unescape(session._repr_html_())


def test_moving_maps_have_a_caption_and_a_still_picture(plan: Plan):
    assert repr(plan).strip("<>").replace(">", "") in plan._repr_html_().partition("<figcaption>")[2]
    assert count_shapes(plan._repr_svg_()) > len(plan.instance.solids)
