"""Recordings: from whoever drove, as pages and videos. That a page plays is in `test_in_browser.py`."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zstandard
from PIL import Image

from hrl_escape.cli import main
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.viewer.pages.offline import CONFETTI, make_replay
from hrl_escape.viewer.play.episode import Episode, load_episode, save_episode
from hrl_escape.viewer.recording import record_driver, record_saved
from hrl_escape.viewer.watch.drivers import open_driver


def read_recorded(page: str) -> tuple[dict, list[bytes]]:
    """What viser recorded into a page: its messages, each with its time, and the buffers that these point into."""
    recorded = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)[1])
    inner = zstandard.ZstdDecompressor().decompressobj().decompress(recorded[8:])
    end = 8 + int.from_bytes(inner[:8], "little")
    content, buffers = msgspec.msgpack.decode(inner[8:end]), []
    for length in content["binaryBufferLengths"]:
        begin = end + -end % 8
        end = begin + length
        buffers.append(inner[begin:end])
    return content, buffers


def test_a_recorded_driver_is_the_episode_it_drove(two_buttons):
    recording = record_driver(open_driver("oracle", two_buttons))
    assert recording.end == "escaped" and len(recording.states) == len(recording.rewards) + 1
    assert [name for name, _ in recording.decisions] == ["press-button-1", "press-button-2", "go-to-exit"]
    assert sum(count for _, count in recording.decisions) == len(recording.rewards)
    assert two_buttons.exit.contains(recording.states[-1].x, recording.states[-1].y)


def test_a_saved_episode_is_recorded_as_it_was_played(two_buttons, tmp_path: Path):
    episode = Episode(two_buttons)
    for name in ("forward", "press-button-1"):
        episode.do(episode.names.index(name))
    save_episode(tmp_path / "mine.json", episode.to_saved())
    recording = record_saved(load_episode(tmp_path / "mine.json"), "mine")
    assert list(recording.states) == episode.states and recording.end == "stopped"


@pytest.mark.nightly
def test_a_page_holds_everything_and_asks_for_nothing(two_buttons):
    page = make_replay(record_driver(open_driver("oracle", two_buttons)))
    assert page.count("</body>") == 1
    assert not re.search(r"""<(script|img|link|iframe)[^>]+(src|href)=["']?(https?:)?//""", page)
    data = json.loads(re.search(r'id="r-data">(\{.*?\})</script>', page, re.S)[1])
    assert data["end"] == "escaped" and data["returns"][0] == "0" and len(data["graph"]) == len(data["returns"])


@pytest.mark.nightly
def test_a_page_lets_its_own_scripts_run_and_asks_nobody(two_buttons):
    page = make_replay(record_driver(open_driver("oracle", two_buttons)))
    assert page == make_replay(record_driver(open_driver("oracle", two_buttons))), "its nonce is no random number"
    (policy,) = re.findall(r'<head><meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == "'none'"
    assert "unsafe-inline" not in rules["script-src"] and "http" not in policy
    (nonce,) = re.findall(r"'nonce-([^']+)'", rules["script-src"])
    assert page.count(f'e.nonce="{nonce}"') == 1, "viser's client adds its script in other words: see UNPACKED"
    ours = re.search(r"<script>(\s*\(\(\) => .*?)</script>", page, re.S)[1]
    assert f"'sha256-{base64.b64encode(hashlib.sha256(ours.encode()).digest()).decode()}'" in rules["script-src"]


@pytest.mark.nightly
def test_the_command_writes_page_and_animation(tmp_path: Path, capfd):
    outs = [str(tmp_path / name) for name in ("a.html", "a.gif")]
    assert main(["record", "--room", "paper-one-button", "--out", *outs]) == 0
    assert "escaped after" in capfd.readouterr().out
    assert (tmp_path / "a.html").stat().st_size > 500_000
    with Image.open(tmp_path / "a.gif") as animation:
        assert getattr(animation, "n_frames", 1) > 5


@pytest.mark.parametrize(("arguments", "message"), [
    (["--out", "a.avi"], "must end in .html, .gif, .mp4"),
    (["smdp-dqn"], "train smdp-dqn"),
    (["none.json"], "no such recorded episode"),
])
def test_what_cannot_be_recorded_gives_one_message(arguments, message: str, capfd):
    assert main(["record", *arguments, "--room", "paper-one-button"]) == 2
    said = capfd.readouterr().err.strip()
    assert message in said and len(said.splitlines()) == 1


def test_a_page_is_named_after_its_room_and_fades_in_no_environment(two_buttons):
    page = make_replay(record_driver(open_driver("oracle", two_buttons)))
    assert "<title>paper-two-button, seed 0: " in page and "<title>Viser" not in page
    content, _ = read_recorded(page)
    maps = [message for _, message in content["messages"] if message["type"] == "EnvironmentMapMessage"]
    assert maps and all(message["hdri_data"] is None for message in maps)


@pytest.mark.nightly
def test_an_escape_is_told_beside_the_best_known_and_celebrated(two_buttons):
    recording = record_driver(open_driver("oracle", two_buttons))
    page = make_replay(recording)
    assert f"Escaped with a return of {sum(recording.rewards):g}: the best known!" in page
    assert '"initialCameraPosition": "0.000,' in page, "upright screens have a camera of their own"
    content, _ = read_recorded(page)
    scraps = [message for _, message in content["messages"] if "confetti" in str(message.get("name"))]
    assert len(scraps) > CONFETTI
    stopped = make_replay(dataclasses.replace(recording, end=EpisodeEnd.TRUNCATED))
    content, _ = read_recorded(stopped)
    assert "best known!" not in stopped
    assert len([1 for _, message in content["messages"] if "confetti" in str(message.get("name"))]) < CONFETTI


def test_a_page_draws_the_whole_way_from_its_first_point(one_button):
    recording = record_driver(open_driver("oracle", one_button))
    content, buffers = read_recorded(make_replay(recording))
    lines = [message["props"] for _, message in content["messages"]
             if message["type"] == "LineSegmentsMessage" and message["name"] == "/room/trail"]
    points = np.frombuffer(buffers[lines[-1]["points"]["__binary_index"]], dtype=np.float32).reshape(-1, 2, 3)
    places = [(state.x, state.y) for state in recording.states]
    way = [pair for pair in zip(places, places[1:], strict=False) if pair[0] != pair[1]]
    assert way[0] == tuple(places[:2]), "it begins with no turn"
    np.testing.assert_allclose(points[:, :, :2], way, atol=1e-5)
