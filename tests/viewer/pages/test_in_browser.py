"""The pages in a real headless Chromium, driven by keys and clicks only."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hrl_escape.agents.training.train import load_agent, train
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.planner import get_planner
from hrl_escape.viewer.pages.offline import save_replay
from hrl_escape.viewer.pages.play import PlayPage
from hrl_escape.viewer.pages.watch import WatchPage, run_in_thread
from hrl_escape.viewer.play.episode import Episode, load_episode
from hrl_escape.viewer.recording import record_driver
from hrl_escape.viewer.server import Server, get_url, open_server
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch
from tests.viewer.browser import Browser, Page

KEYS = ("w", "s", "a", "d", "ArrowLeft", "ArrowRight")  # of the primitives, in action order
FACTS = "document.querySelector('#facts')?.dataset"


@contextmanager
def playing(instance: RoomInstance, browser: Browser, folder: Path) -> Iterator[tuple[PlayPage, Page]]:
    """Manual mode with one tab open."""
    server = open_server(port=0)
    game = PlayPage(server, Episode(instance, get_preset(instance.name)), folder, stride=0.02)
    thread = threading.Thread(target=game.run, daemon=True)
    thread.start()
    page = browser.open(get_url(server))
    try:
        page.wait(f"{FACTS}?.steps === '0'")
        yield game, page
    finally:
        page.close()
        game.put("q")
        thread.join(600)
        server.stop()
        assert not thread.is_alive()


def wait_until(condition: Callable[[], Any], seconds: float = 600.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def wait_for(page: Page, **facts: object) -> None:
    page.wait(" && ".join(f"{FACTS}?.{name} === {json.dumps(str(value))}" for name, value in facts.items()))


@pytest.mark.nightly
def test_play_escapes_by_key_presses_alone_and_undo_returns_the_exact_state(one_button, browser, tmp_path: Path):
    with playing(one_button, browser, tmp_path) as (game, page):
        start = game.episode.state
        plan = get_planner(one_button).solve(start)
        for number, primitive in enumerate(plan.primitives, 1):
            page.press(KEYS[primitive])
            if number % 5 == 0:
                wait_for(page, steps=number)
        wait_for(page, steps=plan.cost, state="escaped")
        assert game.episode.states == [state._replace(noise_key=start.noise_key) for state in plan.states]
        assert "Escaped with a return of" in page.get_text()
        lit = page.run("[...document.querySelectorAll('#puzzle .node')].map(n => n.dataset.lit).join()")
        assert lit == "1", "the graph's node lights up"

        page.press("z")
        wait_for(page, steps=plan.cost - 1, state="stopped")
        assert game.episode.state == plan.states[-2]._replace(noise_key=start.noise_key)
        for _ in range(plan.cost - 1):
            page.press("z")
        wait_for(page, steps=0)
        assert game.episode.state == start


@pytest.mark.slow
def test_meta_keys_press_buttons_and_buttons_on_the_page_do_the_same(two_buttons, browser, tmp_path: Path):
    with playing(two_buttons, browser, tmp_path) as (game, page):
        page.press("m")
        page.press("1")
        page.wait("document.querySelector('#puzzle .node[data-name=button-1]').dataset.lit === '1'")
        assert game.episode.instance.puzzle.get_lit(game.episode.state.puzzle) == (True, False)
        page.press("m")
        page.press("2")
        page.wait("document.querySelector('#puzzle .node[data-name=button-2]').dataset.lit === '1'")
        pressed = [i for step in game.episode.steps for i in step.pressed]
        assert pressed == [0, 1]
        before = game.episode.moves[-1].steps[0].before
        page.click("Undo")
        page.wait("document.querySelector('#puzzle .node[data-name=button-2]').dataset.lit === '0'")
        assert game.episode.state == before
        page.click("press-button-2")
        page.click("go-to-exit")
        wait_for(page, state="escaped")
        page.click("Save episode")
        page.wait("document.body.innerText.includes('Saved as')")
        (file,) = tmp_path.glob("paper-two-button-0-*.json")
        assert load_episode(file).primitives == tuple(step.primitive for step in game.episode.steps)
        page.press("n")
        following = generate(get_preset("paper-two-button"), 1)
        page.wait(f"{FACTS}?.room === '{following.id}' && {FACTS}?.steps === '0'")
        page.press("r")
        page.wait("document.body.innerText.includes('Started again')")


@pytest.mark.slow
def test_driving_keys_leave_the_camera_alone_and_cameras_follow_when_asked(one_button, browser, tmp_path: Path):
    with playing(one_button, browser, tmp_path) as (game, page):
        (client,) = game.server.get_clients().values()
        wait_until(lambda: client.camera.position[2] > 10)  # the room's first view has arrived
        before = np.array(client.camera.position)
        for key in ("w", "a", "ArrowLeft"):
            page.press(key)
        wait_for(page, steps=3)
        np.testing.assert_allclose(client.camera.position, before, atol=1e-6)
        page.click("follow")
        state = game.episode.state
        wait_until(lambda: np.hypot(*(client.camera.position[:2] - (state.x, state.y))) < 7.0)


@pytest.mark.slow
def test_a_client_that_vanishes_mid_episode_harms_nothing(two_buttons, browser, tmp_path: Path):
    with playing(two_buttons, browser, tmp_path) as (game, page):
        other = browser.open(get_url(game.server))
        other.wait(f"{FACTS}?.steps === '0'")
        other.press("m")
        other.press("1")
        other.close()
        page.wait("document.querySelector('#puzzle .node[data-name=button-1]').dataset.lit === '1'")
        page.press("w")
        wait_for(page, steps=len(game.episode.steps))


# --- watching ----------------------------------------------------------------------------------------


@pytest.fixture
def watched(two_buttons, server: Server, tmp_path: Path) -> Iterator[tuple[WatchPage, Path]]:
    """A trained run, paused at its first decision."""
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    train("smdp-dqn+primitives", env, primitives=150, seed=0, out=tmp_path, eval_episodes=0, progress=False)
    gate = Gate(None, paused=True)
    page = WatchPage(server, Watch(open_driver(str(tmp_path), two_buttons), gate))
    thread = run_in_thread(page)
    yield page, tmp_path
    gate.stop()
    thread.join(600)
    assert not thread.is_alive()


def read_values(page: Page) -> dict[str, float]:
    rows = "[...document.querySelectorAll('#values .action')].map(r => [r.dataset.name, r.dataset.value])"
    return {name: float(value) for name, value in page.run(rows)}


def test_watch_pauses_steps_and_shows_the_agents_own_option_values(watched, two_buttons, browser: Browser):
    view, folder = watched
    page = browser.open(get_url(view.server))
    env = OptionsEnv(EscapeRoomEnv(instance=two_buttons, observation="features"))
    agent, observe = load_agent(folder, env), make_observer("features", Kinematics(two_buttons))
    assert observe is not None
    page.wait("!!document.querySelector('#values .action')")
    wait_for(page, state="paused", primitives=0)
    for steps in (1, 2):
        wait_until(lambda: read_values(page) == dict(zip(env.action_names, map(float, agent.compute_values(
            observe.observe(view.watch.choice.state))), strict=True)))
        page.press("p")
        wait_for(page, state="paused", primitives=steps)
    before = len(view.watch.decisions)
    page.click("1 decision")
    page.wait(f"{FACTS}?.decisions > {before} && {FACTS}?.state === 'paused' && "
              "document.querySelectorAll('#values .action[data-chosen=\"1\"]').length === 1")
    name, step, _ = view.watch.decisions[-1]
    page.click("SMDP")
    row = json.dumps([name, str(step.duration), f"{step.reward:.2f}", f"{step.discount:.4f}"])
    page.wait("JSON.stringify([...(document.querySelector('#smdp tbody tr')?.children ?? [])].slice(0, 4)"
              f".map(c => c.innerText)) === JSON.stringify({row})")
    page.click("Preview")
    page.click("Preview this option")
    page.wait("document.querySelector('#preview')?.innerText.includes('primitives')")
    told = page.run("document.querySelector('#preview').innerText")
    preview = view.watch.previewer.preview("press-button-1", view.watch.states[-1])
    assert f"press-button-1: {len(preview.states) - 1} primitives" in told
    page.click("Run")
    page.wait(f"{FACTS}?.state === 'running'")
    page.click("Pause")
    wait_for(page, state="paused")
    page.close()


# --- recordings --------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_a_recorded_page_opens_from_disk_without_a_network_and_plays_to_the_end(one_button, browser, tmp_path: Path):
    recording = record_driver(open_driver("oracle", one_button))
    save_replay(tmp_path / "escape.html", recording)
    page = browser.open()
    page.call("Network.emulateNetworkConditions", offline=True, latency=0, downloadThroughput=0, uploadThroughput=0)
    page.open((tmp_path / "escape.html").as_uri())
    page.wait("Number(document.querySelector('#replay')?.dataset.step) > 2", 60)
    page.wait("document.querySelector('#replay').dataset.end === 'escaped'", 60)
    assert page.run("document.querySelector('#replay .node').dataset.lit") == "1"
    assert not [event for event in page.events if event["method"] == "Log.entryAdded"
                and "Content Security Policy" in event["params"]["entry"]["text"]]
    page.run("document.body.appendChild(Object.assign(document.createElement('script'), "
             "{textContent: 'window.wasRun = true'})); 0")
    assert page.run("window.wasRun") is None
    assert page.run("fetch('http://127.0.0.1:1/').then(() => 'asked', error => 'refused')") == "refused"
    asked = [event["params"]["request"]["url"] for event in page.events
             if event["method"] == "Network.requestWillBeSent"]
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked)
    assert not [event for event in page.events if event["method"] == "Runtime.exceptionThrown"]
    assert page.run("Math.max(...[...document.querySelectorAll('canvas')].map(c => c.width * c.height))") > 100_000
    page.close()
