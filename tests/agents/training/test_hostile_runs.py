"""Run folders from strangers, a thousand of them: none imports a planted module, none writes outside itself."""

from __future__ import annotations

import json
import random
import shutil
import sys
from contextlib import suppress

import pytest

from hrl_escape.agents.training.train import load_agent, load_env, train
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import CheckpointError, EscapeError, TrustError, UnsupportedError
from hrl_escape.viewer.watch.drivers import find_run_room, open_driver

FOREIGN = (
    "planted_payload:Payload", "planted_payload:run", "planted_package.inner:Payload", "os:_exit", "os:system",
    "builtins:exec", "builtins:eval", "subprocess:run", "pathlib:Path.write_text", "shutil:rmtree",
    "gymnasium.wrappers.rendering:RecordVideo", "gymnasium.wrappers:RecordVideo", "gymnasium:make",
    "gymnasium.envs.registration:load_env_creator", "stable_baselines3.common.monitor:Monitor",
    "hrl_escape.files:write_text", "hrl_escape.agents.training.run_folder:RunFolder", "importlib:import_module",
    "hrl_escape.env.escape_room:np.save", "gymnasium.envs.classic_control.cartpole:CartPoleEnv.__init__.__globals__",
    "planted_payload", "", ":", ".:", "../planted_payload:Payload", 7, None, ["planted_payload:Payload"], {},
)
"""Code that no folder may run, and names that are none."""


class Watch:
    """Files opened for writing while `is_on`, and programs started; an audit hook cannot be taken away again."""

    def __init__(self) -> None:
        self.is_on, self.seen = False, []
        sys.addaudithook(self._hear)

    def _hear(self, event, arguments):
        if self.is_on and (event in ("os.system", "subprocess.Popen", "os.exec", "os.remove", "os.rename", "os.mkdir")
                           or (event == "open" and set(str(arguments[1] or "")) & set("wax+"))):
            self.seen.append((event, arguments))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Finished runs: a plain environment, and options in a room with a wrapper above."""
    import gymnasium

    from hrl_escape.options.options_env import OptionsEnv

    folder = tmp_path_factory.mktemp("runs")
    room = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features")
    train("q-learning", gymnasium.make("FrozenLake-v1"), primitives=60, eval_episodes=0, out=folder / "lake")
    train("smdp-q-learning+primitives", OptionsEnv(room), primitives=60, eval_episodes=0, out=folder / "room",
          eval_env=gymnasium.wrappers.TransformReward(OptionsEnv(room), abs))
    return folder


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """Modules that leave a file where they are imported, found before all others."""
    code = f"open({str(tmp_path / 'was-imported')!r}, 'w')\ndef run(*a, **k): open({str(tmp_path / 'ran')!r}, 'w')\n"
    (tmp_path / "code" / "planted_package").mkdir(parents=True)
    for name in ("planted_payload.py", "planted_package/__init__.py", "planted_package/inner.py"):
        (tmp_path / "code" / name).write_text(code + "class Payload:\n    __init__ = run\n")
    monkeypatch.syspath_prepend(tmp_path / "code")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def craft(described, chance: random.Random):
    """Description of a run with foreign code at some place of it."""
    described = json.loads(json.dumps(described))
    env, name = described["environment"], chance.choice(FOREIGN)
    parts = [env, *env["wrappers"]]
    settings, floor = {"settings": name, "fields": {}}, {"class": name, "arguments": {}, "wrappers": []}
    argument = chance.choice([{"function": name}, settings, [{"function": name}], floor, {"deep": settings}])
    kind = chance.randrange(5)
    if kind == 0:
        chance.choice(parts)["class"] = name
    elif kind == 1:
        chance.choice(parts)["arguments"][chance.choice(["map_name", "config", "options", "planner"])] = argument
    elif kind == 2:
        arguments = chance.choice([{}, {"filename": "../outside"}, {"func": argument}, {"video_folder": "outside"}])
        env["wrappers"].insert(chance.randrange(len(env["wrappers"]) + 1), {"class": name, "arguments": arguments})
    elif kind == 3:
        wrapper = {"class": "gymnasium.wrappers.transform_reward:TransformReward", "arguments": {"func": argument}}
        env["wrappers"].append(wrapper)
    else:
        floor = {"class": env["class"], "arguments": env["arguments"], "wrappers": [{"class": name, "arguments": {}}]}
        env["wrappers"].append({"class": "hrl_escape.sets.sequence:SequenceEnv", "arguments": {"then": [floor]}})
    return described


def list_files(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.name != "run.json"}


@pytest.mark.parametrize("count", [30, pytest.param(1_000, marks=pytest.mark.nightly)])
def test_crafted_folders_import_nothing_and_write_nothing(runs, planted, count):
    chance, watch, room = random.Random(20), Watch(), generate(get_preset("paper-two-button"), 0)
    described = {name: json.loads((runs / name / "run.json").read_text()) for name in ("lake", "room")}
    for name in described:
        shutil.copytree(runs / name, planted / name)
    opened = {"lake": (load_env, load_agent), "room": (load_env,)}
    watched = (load_env, load_agent, find_run_room, lambda folder: open_driver(str(folder), room))
    before, refused = list_files(planted), 0
    for round_ in range(count):
        name = chance.choice(["lake", "room"])
        folder = planted / name
        (folder / "run.json").write_text(json.dumps(craft(described[name], chance)))
        watch.is_on = True
        for read in watched if name == "room" and round_ % 10 == 0 else opened[name]:
            try:
                read(folder)
            except TrustError as error:
                refused += read is load_env
                assert "which may do anything on this machine" in str(error)
            except (CheckpointError, UnsupportedError):  # the viewer shows rooms only
                assert read is not load_env, "code that is not known is refused as such"
        watch.is_on = False
        (folder / "run.json").unlink()
    assert not watch.seen
    assert list_files(planted) == before
    assert not {"planted_payload", "planted_package"} & sys.modules.keys()
    assert refused == count, "each of them names foreign code"


def test_what_is_trusted_does_run(runs, planted):
    """The planted modules are found where imports are allowed, so that their absence above says something."""
    described = json.loads((runs / "lake" / "run.json").read_text())
    described["environment"]["class"] = "planted_payload:Payload"
    shutil.copytree(runs / "lake", planted / "lake")
    (planted / "lake" / "run.json").write_text(json.dumps(described))
    with suppress(EscapeError):
        load_env(planted / "lake", trust=True)
    del sys.modules["planted_payload"]
    assert (planted / "was-imported").exists()
