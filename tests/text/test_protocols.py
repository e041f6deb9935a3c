"""The loops of frameworks that play text games, run over the adapters of `examples`; hubs' manifests replay.

BALROG and TextArena are not installed: the loops are written here as their evaluators call an environment. OpenEnv and
verifiers run themselves, each in a virtual environment of its own.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks.hub_manifest import MANIFEST, check_entry
from hrl_escape import EscapeRoomEnv, OptionsEnv
from hrl_escape.errors import VerificationError
from hrl_escape.text import TextEnv
from tests.text.fake_endpoint import run_endpoint
from tests.text.rooms import get_room, make_session

ROOT = Path(__file__).parents[2]
OPENENV, VERIFIERS = "openenv==0.10.0", "verifiers==0.4.0"
ENTRIES = {entry["rung"]: entry for entry in json.loads(MANIFEST.read_text(encoding="utf-8"))["rungs"]}


def load_example(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, ROOT / f"examples/{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_balrog_s_loop_plays_a_room_and_counts_invalid_actions():
    env = load_example("tools_balrog").EscapeRoomText(
        TextEnv(OptionsEnv(EscapeRoomEnv(instance=get_room("pair", 3)), include_primitives=False)))
    replies = iter(["press-button-1", "open sesame", "press-button-2", "press-button-1", "go-to-exit"])
    observation, _ = env.reset(seed=0)
    assert observation["text"]["long_term_context"] == env.get_instruction_prompt()
    over, total = False, 0.0
    for _ in range(20):
        action = env.check_action_validity(next(replies))
        observation, reward, terminated, truncated, _ = env.step(action)
        total += reward
        assert isinstance(observation["text"]["long_term_context"], str) and action in env.language_action_space
        if over := terminated or truncated:
            break
    assert over and total > 0 and env.get_stats() == {"progression": 1.0, "failed_candidates": ["open sesame"]}


def test_textarena_s_loop_plays_a_room_to_its_rewards():
    env = load_example("tools_textarena").EscapeRoom()
    replies = iter(["[look]", "Perhaps [fly]?",
                    '[{"tool": "move", "arguments": {"primitive": "forward", "times": "2"}}]',
                    "[press-button-1]", "[press-button-2]", "[press-button-1]", "[press-button-2]", "[go-to-exit]"])
    with pytest.raises(ValueError, match="one player"):
        env.reset(num_players=2)
    env.reset(num_players=1, seed=0)
    done, heard = False, []
    while not done:
        player, observation = env.get_observation()
        heard.append(observation)
        assert player == 0
        done, _ = env.step(action=next(replies))
    rewards, info = env.close()
    assert "Options: press-button-1" in heard[0] and 0 < rewards[0] < 1 and info[0]["escaped"]
    assert info[0]["invalid_calls"] >= 1 and "Wrong call" in heard[2] and "Took 2 primitives" in heard[3]


def test_a_manifest_replays_and_a_changed_one_is_found():
    entry = ENTRIES["pair"]
    check_entry(entry)
    assert entry["golden"]["reward"] == 1.0 and entry["floor"]["idle"] == 0.0 and len(entry["canaries"]) >= 6
    for change in ({"golden": {**entry["golden"], "calls": entry["golden"]["calls"][:-1]}}, {"room_sha256": "0"},
                   {"canaries": [{"name": "paid", "calls": entry["golden"]["calls"], "reward": 1.0}]}):
        with pytest.raises(VerificationError, match="pair/test#0"):
            check_entry({**entry, **change})


@pytest.mark.nightly
@pytest.mark.parametrize("rung", [rung for rung in ENTRIES if rung not in ("pair", "house")])
def test_every_rung_has_a_manifest_that_replays(rung: str):
    check_entry(ENTRIES[rung])


def make_venv(folder: Path, *requirements: str) -> Path:
    """Python of a virtual environment with packages of its own, over the packages installed here."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    fetched = subprocess.run([*pip, "download", "--quiet", "--no-deps", "--dest", folder / "wheels", *requirements],
                             text=True, capture_output=True)
    if fetched.returncode:
        pytest.skip(f"{', '.join(requirements)} cannot be had: {fetched.stderr.strip().splitlines()[-1]}")
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / "bin/python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-compile", *requirements], check=True)
    here = next(path for path in sys.path if path.endswith("site-packages"))
    (next(folder.glob("lib/python*/site-packages")) / "here.pth").write_text(f"{ROOT}\n{here}\n")
    return python


def run_in(python: Path, *words: str, **variables: str) -> str:
    """Output of a command in a virtual environment."""
    path = f"{python.parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run([python, *words], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          env={**os.environ, "PATH": path, **variables})
    assert done.returncode == 0, done.stdout
    return done.stdout


def find_port() -> int:
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        return made.getsockname()[1]


@pytest.mark.slow
def test_openenv_plays_a_room_and_reads_the_package_in_an_environment_of_its_own(tmp_path: Path):
    python = make_venv(tmp_path / "venv", OPENENV)
    alone = run_in(python, "examples/tools_openenv.py")
    assert alone.endswith("The game is over: escaped. 87.0 True\n")
    port = find_port()
    server = subprocess.Popen([python, "examples/tools_openenv.py", "--serve", "--port", str(port)], cwd=ROOT)
    try:
        for _ in range(600):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
                break
            time.sleep(0.5)
        assert run_in(python, "examples/tools_openenv.py", "--connect", f"http://127.0.0.1:{port}") == alone
    finally:
        server.terminate()
        server.wait(60)
    subprocess.run([sys.executable, "-m", "benchmarks.hub_manifest", "--rungs", "pair", "--package",
                    tmp_path / "package"], cwd=ROOT, check=True)
    done = subprocess.run([tmp_path / "venv/bin/openenv", "validate", tmp_path / "package", "--level", "static",
                           "--skip-build", "--json"], text=True, capture_output=True)
    report = json.loads(done.stdout[done.stdout.index("{"):])
    results = {result["check_id"]: result["status"] for result in report["results"]}
    assert results["static.manifest"] == "pass", done.stdout


@pytest.mark.slow
def test_verifiers_plays_a_room_in_an_environment_of_its_own(tmp_path: Path):
    python = make_venv(tmp_path / "venv", VERIFIERS, "uv")
    with run_endpoint() as endpoint:
        said = run_in(python, "examples/tools_verifiers.py", "--endpoint", endpoint.url, "--rooms", "2",
                      OPENAI_API_KEY="sk-none", XDG_CACHE_HOME=str(tmp_path / "cache"))
    scores, turns = [float(score) for score in re.findall(r"ok=True \[\{'efficiency': ([\d.]+)\}\] \[\]", said)], 0
    for number, score in enumerate(scores):
        session = make_session(get_room("pair", number))
        options: Any = session.tools()[0]["inputSchema"]["properties"]["option"]["enum"]
        for option in itertools.cycle(options):
            turns += 1
            session.call("run_option", {"option": option})
            if session.env.is_over:
                break
        assert score == pytest.approx(session.score().efficiency) and score > 0
    assert len(scores) == 2 and len(endpoint.requests) == turns, said
