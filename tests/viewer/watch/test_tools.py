"""Watching a caller of tools: the page shows the talk beside the room, and what is said is text."""

from __future__ import annotations

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.text.text_env import ToolCall, Turn
from hrl_escape.viewer.pages.watch import WatchPage, make_talk
from hrl_escape.viewer.server import Server
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch


def test_the_page_shows_the_talk(server: Server, two_buttons):
    spec = AgentSpec("text-agent", settings={"model": "search-nearest", "reveal": "places"})
    driver = open_driver(spec, two_buttons)
    assert driver.text_env is not None and not driver.trains
    view = WatchPage(server, Watch(driver, Gate(None)))
    view.run(episodes=1)
    assert view._talk is not None and driver.text_env.score().escaped
    shown = view._talk.content
    assert "press-button-" in shown and "The game is over: escaped." in shown and "You drive a robot" in shown
    assert shown.index("You drive a robot") < shown.index("The game is over"), "the oldest is on top"
    assert shown.index('data-speaker="Room"') < shown.index('data-speaker="Caller"')


def test_the_true_graph_of_a_caller_s_room_is_shown_on_request_only(server: Server, two_buttons):
    spec = AgentSpec("text-agent", settings={"model": "search-nearest", "reveal": "names"})
    driver = open_driver(spec, two_buttons)
    view = WatchPage(server, Watch(driver, Gate(None)))
    assert "data-edge" not in view.page._graph.content and view.page.scene.is_hidden
    view._reveal(True)
    assert "data-edge" in view.page._graph.content and not view.page.scene.is_hidden
    view.run(episodes=1)
    assert driver.text_env is not None and driver.text_env.score().escaped
    shown = view.page._graph.content
    view._reveal(False)
    assert view.page._graph.content != shown and view.page.scene.is_hidden, "an escape is no request"


def test_another_driver_has_no_talk(server: Server, two_buttons):
    assert WatchPage(server, Watch(open_driver("oracle", two_buttons), Gate(None)))._talk is None


def test_what_is_said_is_no_markup():
    turns = [Turn(None, "<b>begin"), Turn(ToolCall("<i>", {"option": "<script>"}), "&<u>", True),
             Turn(ToolCall("look", ["<p>"]), "seen")]
    shown = make_talk(turns)
    assert not any(tag in shown for tag in ("<b>begin", "<i>", "<script>", "<u>", "<p>"))
    assert "&lt;script&gt;" in shown and shown.index("begin") < shown.index("seen")
