"""Where the viewer listens, and what it says when it cannot."""

from __future__ import annotations

import contextlib
import inspect
import re
import socket
import time
from pathlib import Path

import pytest

import hrl_escape
from hrl_escape.cli import main
from hrl_escape.commands.play import PlayArgs
from hrl_escape.errors import AddressError
from hrl_escape.viewer import HOST, PORT
from hrl_escape.viewer.server import get_url, open_server
from tests.forks import run_fork


def test_it_listens_on_this_machine_only(server):
    port = server.get_port()
    listening = [line.split()[1] for line in open("/proc/net/tcp").readlines()[1:]
                 if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")]
    assert listening == [f"0100007F:{port:04X}"]
    assert get_url(server) == f"http://127.0.0.1:{port}/?token={server.guard.token}"


def test_commands_and_servers_have_one_default_address():
    defaults = [parameter.default for parameter in inspect.signature(open_server).parameters.values()]
    assert defaults == [HOST, PORT] == [PlayArgs().host, PlayArgs().port]
    package = Path(hrl_escape.__file__).parent
    written = re.compile(r'\b8080\b|\bhost\b.* ?= ?"127\.0\.0\.1"', re.IGNORECASE)
    told = [path.relative_to(package).as_posix() for path in sorted(package.rglob("*.py"))
            if written.search(path.read_text(encoding="utf-8"))]
    assert told == ["viewer/__init__.py"], "it is written once"


def test_it_opens_no_tunnel(server):
    assert server.request_share_url() is None


def test_it_stops_at_once_though_a_browser_keeps_a_connection_for_later():
    server = open_server(port=0)
    with socket.create_connection((HOST, server.get_port())) as idle:
        while not server.guard.connections:
            time.sleep(0.01)
        begun = time.monotonic()
        server.stop()
        assert time.monotonic() - begun < 4.0, "viser alone waits for six seconds"
        idle.settimeout(60.0)
        with contextlib.suppress(ConnectionResetError):
            assert idle.recv(1) == b"", "it is closed"
    with pytest.raises(OSError):
        socket.create_connection((HOST, server.get_port()))


@pytest.mark.parametrize("command", [["play"], ["watch"]])
def test_a_port_in_use_gives_one_message_and_exit_code_2(capfd, command):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main([*command, "--no-open", "--port", str(port), "--room", "paper-one-button"]) == 2
    said = capfd.readouterr().err.strip()
    assert f"127.0.0.1:{port}" in said and "--port 0" in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(("host", "port"), [("203.0.113.7", 8080), ("no.such.host.invalid", 0), ("127.0.0.1", 70000)])
def test_an_impossible_address_is_refused_at_once(host: str, port: int):
    with pytest.raises(AddressError):
        open_server(host, port)


@pytest.mark.nightly
def test_without_the_extra_one_message_names_it_and_rooms_do_without():
    """In one process, for its imports are slow: three commands that need the extra and one that does not."""
    code = ("import sys; sys.modules['viser'] = sys.modules['trimesh'] = None\n"
            "from hrl_escape.cli import main\n"
            "print([main(line.split()) for line in sys.argv[1:]])")
    lines = ["play --no-open", "watch --no-open", "record",
             "room --room paper-one-button"]
    done = run_fork(code, *lines, timeout=600)
    assert done.stdout.splitlines()[-1] == "[2, 2, 2, 0]", done.stderr
    hint = "pip install -c constraints.txt '.[viewer]' in a checkout of hrl-escape"
    assert done.stderr.strip().splitlines() == 3 * [f"hrl-escape: The viewer needs viser: {hint}"]
