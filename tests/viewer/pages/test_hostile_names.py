"""Names that try to be code: in every page and picture they are text, and nothing of them runs."""

from __future__ import annotations

import dataclasses
import re
import threading
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from hrl_escape.env.config import ButtonsConfig, RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.pictures.maps import make_map_image, save_map
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.viewer.pages.offline import make_replay, save_replay
from hrl_escape.viewer.pages.play import PlayPage
from hrl_escape.viewer.pages.watch import WatchPage, run_in_thread
from hrl_escape.viewer.play.episode import Episode
from hrl_escape.viewer.recording import EpisodeRecording, record_driver
from hrl_escape.viewer.server import Server, get_url
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch
from tests.viewer.browser import Browser, Page

HOSTILE = ("<img src=x onerror=window.__pwned=1>", "</script><script>window.__pwned=2</script>", "@DATA@",
           "{{ data }}", "<!--<script>", "\"' onload=window.__pwned=3 x='", "</title><script>window.__pwned=4</script>",
           "javascript:window.__pwned=5", "]]><svg onload=window.__pwned=6>", "$\\frac{$", "\ud800")
CODE = HOSTILE[0] + HOSTILE[1]
SAFE = "window.__pwned === undefined"


@pytest.fixture(scope="module")
def hostile() -> RoomInstance:
    """A room whose own name and whose buttons' names are code."""
    instance = generate(RoomConfig(name=CODE, puzzle=ButtonsConfig(count=2)), 0)
    return rename(instance, (CODE, HOSTILE[5]))


@dataclasses.dataclass(frozen=True)
class NamedPuzzle(ButtonsPuzzle):
    """Buttons with names of one's own, as a puzzle of somebody else's may give them."""

    names: tuple[str, ...] = ()

    @property
    def target_names(self) -> tuple[str, ...]:
        return self.names


def rename(instance: RoomInstance, names: tuple[str, ...]) -> RoomInstance:
    old: Any = instance.puzzle
    fields = {field.name: getattr(old, field.name) for field in dataclasses.fields(old)} | {"names": names}
    targets = [dataclasses.replace(target, name=name) for target, name in zip(instance.targets, names, strict=True)]
    return dataclasses.replace(instance, targets=tuple(targets), puzzle=NamedPuzzle(**fields))


@pytest.fixture(scope="module")
def recording(hostile: RoomInstance) -> EpisodeRecording:
    recorded = record_driver(open_driver("oracle", hostile))
    names = [*HOSTILE, *(len(recorded.decisions) * [CODE])]
    decisions = tuple((name, count) for name, (_, count) in zip(names, recorded.decisions, strict=False))
    return dataclasses.replace(recorded, decisions=decisions, driver=CODE)


def open_and_wait(browser: Browser, url: str, ready: str) -> Page:
    page = browser.open(url)
    page.wait(ready)
    time.sleep(0.5)
    return page


@pytest.mark.nightly
def test_a_recorded_page_of_hostile_names_runs_nothing(recording: EpisodeRecording, browser: Browser, tmp_path: Path):
    for number, name in enumerate(HOSTILE):
        at = dataclasses.replace(recording, driver=name,
                                 instance=dataclasses.replace(recording.instance, name=name))
        if number in (1, 6):  # each page takes seconds to open
            save_replay(tmp_path / "page.html", at)
            page = open_and_wait(browser, (tmp_path / "page.html").as_uri(),
                                 "Number(document.querySelector('#replay')?.dataset.step) > 0")
            assert page.run(SAFE), name
            assert page.run("document.querySelectorAll('#replay img, #replay script').length") == 0
            assert page.run("document.querySelector('#replay h1').innerText").startswith(name[:6])
            assert page.run("document.title").startswith(name[:6])
            page.close()
        else:
            assert make_replay(at).encode("utf-8")


def test_a_recorded_page_holds_no_markup_of_others(recording: EpisodeRecording):
    plain = make_replay(dataclasses.replace(recording, driver="oracle", decisions=()))
    hostile = make_replay(dataclasses.replace(recording, driver=HOSTILE[6]))
    for piece in ("<img src=x", "</title><script", "script>window.__pwned"):
        assert piece not in hostile
    assert hostile.count("<script") == plain.count("<script") and hostile.count("<title") == plain.count("<title")


def test_data_stays_inside_its_script(recording: EpisodeRecording):
    page = make_replay(recording)
    inside = re.search(r'<script type="application/json" id="r-data">(.*?)</script>', page, re.S)
    assert inside is not None and inside[1].startswith("{") and inside[1].endswith("}")
    assert not set(inside[1]) & set("<>&")


@pytest.mark.nightly
def test_manual_mode_shows_hostile_names_as_text(hostile: RoomInstance, server: Server, browser: Browser,
                                                 tmp_path: Path):
    game = PlayPage(server, Episode(hostile), tmp_path, stride=0.0)
    thread = threading.Thread(target=game.run, daemon=True)
    thread.start()
    page = open_and_wait(browser, get_url(server), "!!document.querySelector('#facts')")
    try:
        page.press("m")
        page.press("1")
        page.wait("document.querySelector('#facts').innerText.includes('pressed')")
        page.press("f")
        page.wait("document.querySelector('#facts').innerText.includes('Saved as')")
        assert page.run(SAFE) and page.run("document.title").startswith("<img")
        assert len(list(tmp_path.iterdir())) == 1
    finally:
        page.close()
        game.put("q")
        thread.join(600)


@pytest.mark.nightly
def test_watch_mode_shows_hostile_names_as_text(hostile: RoomInstance, server: Server, browser: Browser):
    gate = Gate(None, paused=True)
    driver = dataclasses.replace(open_driver("oracle", hostile), name=CODE)
    view = WatchPage(server, Watch(driver, gate))
    thread = run_in_thread(view)
    page = open_and_wait(browser, get_url(server), "!!document.querySelector('#facts')")
    try:
        page.click("1 decision")
        page.wait("document.querySelector('#facts').dataset.decisions === '1'")
        page.click("Preview")
        page.click("Preview this option")
        page.wait("document.querySelector('#preview')?.innerText.includes('presses') || "
                  "document.querySelector('#preview')?.innerText.includes('cannot')")
        page.click("Log")
        page.wait("document.querySelector('#log')?.innerText.includes('pressed')")
        assert page.run(SAFE)
        assert page.run("document.querySelectorAll('#facts img, #log img, #preview img').length") == 0
    finally:
        page.close()
        gate.stop()
        thread.join(600)


@pytest.mark.nightly_for(
    "<img src=x onerror=window.__pwned=1>", "{{ data }}", "<!--<script>", '"\' onload=window.__pwned=3 x=\'',
    "</title><script>window.__pwned=4</script>")
@pytest.mark.parametrize("name", HOSTILE[:-1])
def test_a_map_of_hostile_names_is_a_picture_without_scripts(hostile: RoomInstance, name: str, tmp_path: Path):
    instance = rename(dataclasses.replace(hostile, name=name), (name, name + "2"))
    save_map(tmp_path / "map.svg", instance)
    root = ElementTree.parse(tmp_path / "map.svg").getroot()
    for element in root.iter():
        assert element.tag.rpartition("}")[2] not in ("script", "foreignObject", "image", "a")
        assert not [key for key in element.attrib if key.lower().startswith("on")]
    assert make_map_image(instance).any()


@pytest.mark.nightly
def test_a_map_opened_in_a_browser_runs_nothing(hostile: RoomInstance, browser: Browser, tmp_path: Path):
    save_map(tmp_path / "map.svg", hostile)
    page = open_and_wait(browser, (tmp_path / "map.svg").as_uri(), "!!document.querySelector('svg')")
    assert page.run(SAFE)
    page.close()
