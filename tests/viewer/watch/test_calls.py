"""Watch mode lists the running calls of an agent that has a stack, and labels their goals."""

from __future__ import annotations

import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.hierarchies import HierarchyEnv
from hrl_escape.viewer.pages.watch import WatchPage
from hrl_escape.viewer.server import Server
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, ShownCall, Watch


def make_run(folder, agent, kind, room):
    env = HierarchyEnv(EscapeRoomEnv(instance=room), kind, "planned")
    train(agent, env, primitives=150, out=folder, eval_episodes=0, progress=False)
    return folder


@pytest.fixture(scope="module")
def maxq_run(tmp_path_factory, two_buttons):
    return make_run(tmp_path_factory.mktemp("runs") / "maxq", "maxq-q", "maxq", two_buttons)


def watch_calls(watch: Watch) -> list[tuple[int, tuple[ShownCall, ...]]]:
    """(primitives of the episode, running calls) at every choice of one episode."""
    seen = []
    watch.on_change = lambda step: seen.append((len(watch.rewards), watch.calls)) if step is None else None
    watch.run(1)
    return seen


def check_calls(seen, rewards, most=3):
    for at, calls in seen:
        assert [call.name for call in calls][0] == "escape" and 2 <= len(calls) <= most
        assert calls[0].call.primitives == at, "the root runs for the whole episode"
        for outer, inner in zip(calls, calls[1:], strict=False):
            assert outer.began <= inner.began and outer.call.primitives >= inner.call.primitives
        for call in calls:
            assert call.began + call.call.primitives == at
            assert call.reward == sum(rewards[call.began : at])
            assert call.ending == "goes on", "a call that is over runs no more"


def test_a_trained_stack_is_shown_with_lengths_and_rewards(maxq_run, two_buttons):
    watch = Watch(open_driver(str(maxq_run), two_buttons), Gate(None))
    seen = watch_calls(watch)
    check_calls(seen, watch.rewards)
    names = [[call.name for call in calls] for _, calls in seen]
    assert names[0] == ["escape", "press-button-1", "touch button-1"]
    assert ["escape", "press-button-2", "touch button-2"] in names and names[-1] == ["escape", "exit"]
    over = [event for event in watch.events if "is over" in event]
    assert any("press-button-1 is over" in event for event in over)
    length = names.index(["escape", "press-button-2", "touch button-2"])
    assert any(event.endswith(f"press-button-1 is over: {length} primitives, reward {-length}") for event in over)


def test_the_running_machines_of_a_program_are_shown_with_arguments_lengths_and_rewards(tmp_path, two_buttons):
    watch = Watch(open_driver(str(make_run(tmp_path / "ham", "hamq", "ham", two_buttons)), two_buttons), Gate(None))
    seen = watch_calls(watch)
    check_calls(seen, watch.rewards, most=4)
    names = [[call.name for call in calls] for _, calls in seen]
    press = ["escape", "apply(press-button-2)", "touch(button-2)", "step(button-2)"]
    assert names[0] == [name.replace("2", "1") for name in press]
    assert press in names and names[-1] == ["escape", "leave_room", "step(exit)"]
    assert all(calls[-1].call.primitives == 0 for _, calls in seen), "each step is a call of its own"
    length = names.index(press)
    assert any(event.endswith(f"apply(press-button-1) is over: {length} primitives, reward {-length}")
               for event in watch.events)


@pytest.mark.parametrize("agent", ["maxq-q", "hamq"])
def test_an_agent_that_learns_with_a_hierarchy_shows_its_calls(agent, two_buttons):
    watch = Watch(open_driver(AgentSpec(agent, low_level="planned"), two_buttons), Gate(None))
    seen = []

    def note(step):
        if step is None:
            seen.append((len(watch.rewards), watch.calls))
        if watch.primitives == 60:
            watch.gate.stop()

    watch.on_change = note
    watch.run()
    check_calls(seen[:30], [-1.0] * 30, most=4)


@pytest.mark.nightly
def test_an_agent_without_a_stack_shows_no_calls(two_buttons, run):
    watch = Watch(open_driver(str(run), two_buttons), Gate(None))
    assert all(calls == () for _, calls in watch_calls(watch))


def test_the_page_lists_the_calls_and_labels_their_goals(server: Server, maxq_run, two_buttons, monkeypatch):
    view = WatchPage(server, Watch(open_driver(str(maxq_run), two_buttons), Gate(None)))
    shown = []
    refresh = view._refresh

    def note():
        refresh()
        shown.append((view._calls.content, {text for text, _ in view.page.scene._goals.values()}))

    monkeypatch.setattr(view, "_refresh", note)
    monkeypatch.setattr("hrl_escape.viewer.pages.watch.REFRESH", 0.0)
    view.run(episodes=1)
    assert any("press-button-1" in page and "touch button-1" in page for page, _ in shown)
    assert {"press-button-1, touch button-1"} in [goals for _, goals in shown]
    assert shown[-1][1] == {"exit"}
