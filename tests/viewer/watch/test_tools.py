"""Watching a caller of tools: the page shows the talk beside the room, and what is said is text."""

from __future__ import annotations

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.text.text_env import ToolCall, Turn
from hrl_escape.viewer.pages.panels import make_lines
from hrl_escape.viewer.pages.watch import WatchPage, _list_turns
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
    assert shown.index("The game is over") < shown.index("You drive a robot"), "the latest is on top"


def test_another_driver_has_no_talk(server: Server, two_buttons):
    assert WatchPage(server, Watch(open_driver("oracle", two_buttons), Gate(None)))._talk is None


def test_what_is_said_is_no_markup():
    turns = [Turn(None, "<b>begin"), Turn(ToolCall("<i>", {"option": "<script>"}), "&<u>", True),
             Turn(ToolCall("look", ["<p>"]), "seen")]
    shown = make_lines(_list_turns(turns), "talk")
    assert not any(tag in shown for tag in ("<b>begin", "<i>", "<script>", "<u>", "<p>"))
    assert "&lt;script&gt;" in shown and shown.index("seen") < shown.index("begin")
