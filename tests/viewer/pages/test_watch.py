"""The scene of watch mode belongs to the same moment as its panel, also without a limit of pace."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from hrl_escape.env.config import StartConfig
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.viewer.pages.watch import WatchPage, run_in_thread
from hrl_escape.viewer.server import Server
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch
from tests.viewer.pages.test_clients import wait_until


@pytest.mark.nightly
def test_the_scene_never_lags_the_panel(server: Server, two_buttons, monkeypatch):
    view = WatchPage(server, Watch(open_driver("oracle", two_buttons), Gate(None)))
    behind: list[Any] = []
    refresh = view._refresh

    def check() -> None:
        refresh()
        if view.page._pose != view.page.scene.model.make_pose(view.watch.states[-1]):
            behind.append(len(view.watch.states))

    monkeypatch.setattr(view, "_refresh", check)
    view.run(episodes=3)
    assert view.problem == "all episodes are over" and view.watch.episode == 3
    assert not behind, f"the panel was ahead of the scene after {behind} states"


@pytest.mark.nightly
def test_the_path_of_a_rectangular_base_begins_at_its_heading(server: Server, monkeypatch):
    """Along a wall that leaves no room for the base across."""
    preset = get_preset("paper-one-button")
    robot = dataclasses.replace(preset.robot, footprint="rectangle", body_length=1.6, body_width=0.5)
    start = StartConfig(place="fixed", x=9.5, y=0.0, heading_deg=90.0)
    room = generate(dataclasses.replace(preset, robot=robot, start=start), 0)
    view = WatchPage(server, Watch(open_driver("oracle", room), Gate(None)))
    drawn: list[list[tuple[float, float]]] = []
    monkeypatch.setattr(view.page.scene, "draw_path", drawn.append)
    view.run(episodes=1)
    assert [path[0] for path in drawn if path][0] == (9.5, 0.0)


def test_the_buttons_pause_run_and_let_one_step_through(server: Server, two_buttons):
    gate = Gate(None)
    view = WatchPage(server, Watch(open_driver("oracle", two_buttons), gate))
    view._turn("Pause")
    assert gate.is_paused
    thread = run_in_thread(view)
    for what, count in (("1 primitive", 1), ("1 primitive", 2)):
        view._turn(what)
        wait_until(lambda count=count: view.watch.primitives == count, what)
        assert gate.is_paused
    view._turn("1 decision")
    wait_until(lambda: len(view.watch.decisions) == 1, "one decision")
    view._turn("toggle")
    assert not gate.is_paused
    view._turn("toggle")
    assert gate.is_paused
    view._turn("Run")
    assert not gate.is_paused
    gate.stop()
    thread.join(600)
    assert not thread.is_alive()
