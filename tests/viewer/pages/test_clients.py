"""Clients that come and go: nothing of them stays, and those who remain notice nothing."""

from __future__ import annotations

import gc
import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from hrl_escape.planning.planner import get_planner
from hrl_escape.viewer.pages.panels import WIDTH, KnownEdges, make_graph, make_pair
from hrl_escape.viewer.pages.play import PlayPage
from hrl_escape.viewer.pages.room import VIEWS, RoomPage
from hrl_escape.viewer.play.commands import Command
from hrl_escape.viewer.play.episode import Episode
from hrl_escape.viewer.server import Server

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts in /proc")

CAMERA = {"type": "ViewerCameraMessage", "wxyz": (1, 0, 0, 0), "position": (0, -20, 20), "fov": 0.9, "near": 0.1,
          "far": 100.0, "image_height": 800, "image_width": 900, "look_at": (0, 0, 0), "up_direction": (0, 0, 1)}


def wait_until(condition: Callable[[], Any], what: str, seconds: float = 600.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.005)


def open_client(server: Server) -> ClientConnection:
    """What a page does when it opens: connect, take in the scene, tell its camera."""
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    address = f"127.0.0.1:{server.get_port()}"
    client = connect(f"ws://{address}/?token={server.guard.token}", origin=Origin(f"http://{address}"),
                     subprotocols=[protocol], max_size=None, compression=None)
    client.recv(timeout=600)
    client.send(msgspec.msgpack.encode(CAMERA))
    return client


def come_and_go(server: Server, game: PlayPage, rounds: int, clients: int = 10) -> None:
    """In each round so many clients come, the robot drives, and they go: politely, or torn off in the middle."""
    for number in range(rounds):
        pages = [open_client(server) for _ in range(clients)]
        wait_until(lambda: len(server.get_clients()) == clients, "all clients are there")
        wait_until(lambda: len(game.page._cameras) == clients, "all have been welcomed")
        if number % 10 == 3:
            game.page._choose(next(iter(server.get_clients().values())), "follow")
        game.put("w" if number % 2 else "s")
        for index, page in enumerate(pages):
            if index % 2:
                page.socket.shutdown(socket.SHUT_RDWR)  # as when its process is killed: no goodbye
            else:
                page.close()
        wait_until(lambda: not server.get_clients(), "all clients are gone")


def count_left(server: Server, game: PlayPage) -> dict[str, int]:
    wait_until(lambda: not game.page._cameras, "no camera is left")
    gc.collect()
    inner = server._websock_server
    return {"clients": len(inner._client_state_from_id), "connections": len(inner._live_connections),
            "cursors": len(inner._broadcast_buffer.generator_cursors), "cameras": len(game.page._cameras),
            "files": len(os.listdir("/proc/self/fd"))}


def measure_memory() -> int:
    """Resident bytes of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture
def game(server: Server, two_buttons):
    game = PlayPage(server, Episode(two_buttons), stride=0.0)
    thread = threading.Thread(target=game.run, daemon=True)
    thread.start()
    yield game
    game.put("q")
    thread.join(600)
    assert not thread.is_alive()


@pytest.mark.nightly
def test_ten_clients_come_and_go_and_nothing_of_them_stays(server: Server, game: PlayPage):
    come_and_go(server, game, rounds=3)
    before = count_left(server, game)
    come_and_go(server, game, rounds=5)
    after = count_left(server, game)
    assert after["files"] <= before["files"]
    assert [after[name] for name in ("clients", "connections", "cursors", "cameras")] == [0, 0, 0, 0]
    wait_until(lambda: len(game.episode.steps) == 8, "every key was taken")


def test_cameras_that_follow_move_with_the_robot_and_one_in_orbit_stays(server: Server, game: PlayPage):
    pages = [open_client(server) for _ in VIEWS]
    wait_until(lambda: len(game.page._cameras) == len(VIEWS), "all have been welcomed")
    clients = dict(zip(VIEWS, server.get_clients().values(), strict=True))
    for view, client in clients.items():
        game.page._choose(client, view)
    game.page._cameras[99] = "follow"  # one that has left is passed over

    def list_places() -> list[Any]:
        pose = game.page._pose
        x, y, cos, sin = pose.x, pose.y, math.cos(pose.heading), math.sin(pose.heading)
        ends = [client.camera.position for client in clients.values()], [c.camera.look_at for c in clients.values()]
        away = [np.array([[p[0] - x, p[1] - y] for p in end]) @ [[cos, -sin], [sin, cos]] for end in ends]
        return [ends[0][0], np.round(away[0][1:], 6), np.round(away[1][1:], 6)]  # along and across, seen from the robot

    orbit, *before = list_places()
    game.put("w")
    wait_until(lambda: len(game.episode.steps) == 1 and game.page._pose.x == game.episode.state.x, "it has driven")
    wait_until(lambda: np.allclose(before, list_places()[1:], atol=1e-5), "two cameras have followed")
    game.page._cameras.pop(99)
    assert tuple(list_places()[0]) == tuple(orbit)
    for back, eye in before:
        assert np.allclose([back[1], eye[1]], 0.0, atol=1e-5), "straight ahead or behind"
    (back, eye), (ahead, there) = before
    assert back[0] < -3.5 and -0.5 < eye[0] < 0.0 < 1.5 < there[0] < ahead[0]
    for page in pages:
        page.close()
    wait_until(lambda: not server.get_clients(), "all clients are gone")


def test_the_graph_is_whole_hidden_or_beside_what_an_agent_believes(server: Server, two_buttons):
    state, puzzle = Episode(two_buttons).state, two_buttons.puzzle
    page = RoomPage(server, two_buttons, state)
    assert page._graph.content == make_graph(puzzle, state.puzzle, WIDTH)
    believed = KnownEdges(frozenset({(1, 0)}))
    page.show_belief(state, believed, "what it learned")
    assert page._graph.content == make_pair(
        ("the room's graph", make_graph(puzzle, state.puzzle, WIDTH // 2)),
        ("what it learned", make_graph(puzzle, state.puzzle, WIDTH // 2, believed, drawing="learned")))
    hidden = Episode(two_buttons, is_hidden=True)
    page = RoomPage(server, two_buttons, hidden.state, discovery=hidden.discovery)
    assert hidden.discovery is not None
    found = KnownEdges(*hidden.discovery.list_edges())
    assert page._graph.content == make_graph(puzzle, state.puzzle, WIDTH, found, True)


def test_a_hidden_graph_is_shown_at_the_escape_and_not_when_the_exit_opens(server: Server, two_buttons):
    plan, puzzle = get_planner(two_buttons).solve(Episode(two_buttons).state), two_buttons.puzzle
    hidden = Episode(two_buttons, is_hidden=True)
    page = RoomPage(server, two_buttons, hidden.state, discovery=hidden.discovery)
    assert hidden.discovery is not None and puzzle.is_solved(plan.states[-2].puzzle)
    for state in plan.states[:-1]:
        page.show(state)
        found = KnownEdges(*hidden.discovery.list_edges())
        assert page._graph.content == make_graph(puzzle, state.puzzle, WIDTH, found, True)
    page.show(plan.states[-1])
    assert page._graph.content == make_graph(puzzle, plan.states[-1].puzzle, WIDTH)


@pytest.mark.nightly
def test_a_client_that_goes_while_everything_is_busy_leaves_no_buttons(server: Server, game: PlayPage):
    """Buttons of a client that had gone before they were made stood in the page's folder for ever, and it with them."""
    free = threading.Event()
    busy = [server._thread_executor.submit(free.wait, 60) for _ in range(server._thread_executor._max_workers)]
    page = open_client(server)
    wait_until(server.get_clients, "it has come")
    page.close()
    wait_until(lambda: not server._websock_server._live_connections and not server.get_clients(), "it has gone")
    free.set()
    for each in busy:
        each.result(60)
    come_and_go(server, game, rounds=1, clients=2)
    count_left(server, game)
    assert not game.page.view_folder._children


@pytest.mark.slow
def test_ten_clients_a_hundred_times_leave_memory_and_threads_as_they_were(server: Server, game: PlayPage):
    come_and_go(server, game, rounds=20)
    count_left(server, game)
    memory, threads = measure_memory(), threading.active_count()
    come_and_go(server, game, rounds=100)
    left = count_left(server, game)
    assert left["clients"] == left["connections"] == left["cursors"] == 0
    assert threading.active_count() <= threads + 32  # of viser's pool; a thread a client would be a thousand
    gc.collect()
    assert not [thing for thing in gc.get_objects() if isinstance(thing, viser.ClientHandle)]
    assert measure_memory() - memory < 60e6, "a thousand clients that each took in a scene of 100 kB"


def test_hidden_play_shows_the_best_known_return_when_the_game_is_over(server: Server, two_buttons, tmp_path: Path):
    for is_hidden in (False, True):
        game = PlayPage(server, Episode(two_buttons, is_hidden=is_hidden), tmp_path, stride=0.0)
        game.page.find_best()
        game._show_facts()
        shown = f">{game.page.best:g}<"
        assert (shown in game._facts.content) is not is_hidden
        for name in ("press-button-1", "press-button-2", "press-button-1", "go-to-exit"):
            game.handle(Command("act", game.episode.names.index(name)))
        assert game.episode.is_over and shown in game._facts.content
