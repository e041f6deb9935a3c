"""State goes out and comes back whole: every agent, every recipe, also when a run is killed."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hrl_escape.agents import Callback, load_agent, load_result, make_agent, train
from hrl_escape.agents.registry import list_agents, list_recipes
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.checkpoint import compute_state_digest, load_checkpoint, save_checkpoint
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.run_folder import RunFolder
from hrl_escape.errors import CheckpointError, FileReadError, FileWriteError, RunBusyError, RunMismatchError
from hrl_escape.signals import Ended, end_by_signal
from tests.agents.running import interact
from tests.agents.small_envs import ButtonGrid
from tests.covering import thin
from tests.forks import run_fork

SMALL = {
    "dqn": {
        "hidden": (8,),
        "batch_size": 8,
        "warmup": 20,
        "updates_per_step": 0.05,
        "n_step": 3,
        "replay_capacity": 60,
    },
    "rainbow": {"hidden": (8,), "batch_size": 8, "warmup": 20, "updates_per_step": 0.05, "replay_capacity": 60,
                "atoms": 11, "noise": 0.5},
    "sarsa": {"hidden": (8,), "batch_size": 8, "warmup": 20, "updates_per_step": 0.05, "replay_capacity": 60},
    "ddpg": {"hidden": (8,), "batch_size": 8, "warmup": 20, "actor_warmup": 40, "updates_per_step": 0.05},
    **dict.fromkeys(("ppo", "dac", "diayn"), {"hidden": (8,), "rollout": 16, "batch_size": 8, "epochs": 2}),
    "a2oc": {"hidden": (8,), "rollout": 5},
    "fun": {"hidden": (8,), "rollout": 7, "horizon": 3},
    **dict.fromkeys(("torchrl-dqn", "torchrl-sac"), {"hidden": (8,), "batch_size": 8, "warmup": 20,
                                                      "updates_per_step": 0.05, "replay_capacity": 60}),
    "torchrl-ppo": {"hidden": (8,), "rollout": 16, "batch_size": 8, "epochs": 2},
    "monte-carlo-model": {"redraws": 2},
    "ppoc": {"hidden": (8,), "rollout": 16, "batch_size": 8, "epochs": 2, "least_samples": 8,
             "termination_rate": 1e-3},
}
WARM = {"dqn": {"warmup": 20}, "ddpg": {"warmup": 20, "actor_warmup": 30}}
VARIANTS = [
    *((name, "default", SMALL.get(name, {})) for name in list_agents()),
    *(
        (name, "keras-rl-2019", WARM.get(name, {}))
        for name in list_agents()
        if "keras-rl-2019" in list_recipes(name)
    ),
    *((name, "default", SMALL.get(name, {}) | {"bonus_weight": 2.0}) for name in ("dqn", "q-learning", "ppo")),
    ("sarsa", "default", {"replay_capacity": 0, "expected": False, "warmup": 5, "hidden": (8,)}),
]
NAMES = [f"{name}-{recipe}" for name, recipe, _ in VARIANTS]
IDS = [name if NAMES.index(name) == index else f"{name}-changed" for index, name in enumerate(NAMES)]


class Interrupting(ButtonGrid):
    """Raises KeyboardInterrupt at the n-th step of its life."""

    def __init__(self, after):
        super().__init__(trace=True, horizon=40)
        self.left = after

    def step(self, action):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().step(action)


def make_env():
    return Interrupting(10**9)


def make(name, recipe, changes, seed=0):
    env = make_env()
    return make_agent(AgentSpec(name, recipe=recipe), env.observation_space, env.action_space, seed, **changes)


def flatten(tree, where=""):
    """Leaves of a state tree with their paths, arrays as bytes with dtype and shape."""
    if isinstance(tree, dict):
        return {k: v for key in tree for k, v in flatten(tree[key], f"{where}/{key}").items()}
    if isinstance(tree, list | tuple):
        return {k: v for i, item in enumerate(tree) for k, v in flatten(item, f"{where}/{i}").items()}
    if isinstance(tree, np.ndarray) or hasattr(tree, "detach"):
        array = np.asarray(tree)
        return {where: (array.dtype.str, array.shape, array.tobytes())}
    return {where: repr(tree.item() if isinstance(tree, np.generic) else tree)}


@pytest.mark.nightly_for(
    "torchrl-dqn-default", "torchrl-sac-default", "dac-default", "dqn-keras-rl-2019", "vigorito-barto-default",
    "sarsa-default-changed", "sarsa-keras-rl-2019")
@pytest.mark.parametrize(("name", "recipe", "changes"), thin(VARIANTS, 4, 1), ids=IDS)
def test_a_restored_agent_goes_on_to_the_same_bits(tmp_path, name, recipe, changes):
    for before in (3, 60):
        agent, restored = make(name, recipe, changes), make(name, recipe, changes, seed=1)
        steps = interact(agent, make_env(), 10**6)
        for _ in range(before):
            transition = next(steps)
        while not (transition.terminated or transition.truncated):
            transition = next(steps)
        save_checkpoint(tmp_path / "agent.npz", agent.state_dict())
        restored.load_state_dict(load_checkpoint(tmp_path / "agent.npz"))
        assert flatten(restored.state_dict()) == flatten(agent.state_dict())
        one, other = interact(agent, make_env(), 50, seed=5), interact(restored, make_env(), 50, seed=5)
        assert [t.action for t in one] == [t.action for t in other]
        assert flatten(restored.state_dict()) == flatten(agent.state_dict())


LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text()
    | hnp.arrays(st.sampled_from([np.float32, np.int64, np.bool_, np.uint8]), hnp.array_shapes(min_dims=0, min_side=0))
)
TREES = st.dictionaries(
    st.text(max_size=5),
    st.recursive(LEAVES, lambda c: st.lists(c, max_size=3) | st.dictionaries(st.text(), c, max_size=3)),
)


@pytest.mark.nightly
@settings(max_examples=25)
@given(tree=TREES)
def test_any_state_tree_survives_a_checkpoint(tmp_path_factory, tree):
    path = tmp_path_factory.mktemp("checkpoint") / "x.npz"
    save_checkpoint(path, tree)
    assert flatten(load_checkpoint(path)) == flatten(tree)


def test_state_trees_with_the_same_bytes_of_another_kind_or_shape_have_another_digest():
    """Sixteen bytes of zeros each, and lists of zeros; the order in memory is no part of the values."""
    arrays = [np.zeros(shape, kind) for shape, kind in (
        (4, np.float32), (4, np.int32), (2, np.float64), (2, np.int64), (16, np.uint8), (16, np.bool_), ((2, 2), "f4"),
        ((4, 1), "f4"), ((1, 4), "f4"))]
    digests = {compute_state_digest({"weights": each}) for each in [*arrays, [0.0] * 4, [0] * 4, [False] * 4]}
    assert len(digests) == len(arrays) + 3
    table = np.arange(6.0).reshape(2, 3)
    assert compute_state_digest({"weights": table}) == compute_state_digest({"weights": np.asfortranarray(table)})
    pair = {"a": arrays[0], "b": np.ones(4, np.float32)}
    assert compute_state_digest(pair) != compute_state_digest({"a": pair["b"], "b": pair["a"]})


def test_a_state_tree_with_something_else_is_refused_with_its_place(tmp_path):
    with pytest.raises(TypeError, match=r"state\.agent\[1\] is a set"):
        save_checkpoint(tmp_path / "x.npz", {"agent": [1, {2}]})
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def heeding_ctrl_c():
    """A shell starts what runs in its background with Ctrl-C ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


# --- runs ---------------------------------------------------------------------------------


def run(name, recipe, changes, env, out=None, **more):
    arguments = {"primitives": 300, "seed": 3, "eval_every": 100, "eval_episodes": 2, "checkpoint_seconds": 0}
    return train(AgentSpec(name, recipe=recipe), env, settings=changes, out=out, **(arguments | more))


def read_log(folder):
    """Rows without what the wall clock decides."""
    rows = [json.loads(line) for line in (Path(folder) / "log.jsonl").read_text().splitlines()]
    return [{key: value for key, value in row.items() if not key.startswith("time/")} for row in rows]


@pytest.mark.nightly_for(
    "rainbow-default", "factored-r-max-default", "monte-carlo-model-default", "a2oc-default", "fun-default",
    "sarsa-default", "met-r-max-default", "dqn-default-changed", "ppo-default-changed", "torchrl-ppo-default",
    "ppoc-default", "diayn-default", "ddpg-default", "ddpg-keras-rl-2019", "q-learning-default",
    "skill-chaining-default")
@pytest.mark.parametrize(("name", "recipe", "changes"), thin(VARIANTS, 4, 2), ids=IDS)
def test_an_interrupted_run_resumes_to_the_result_of_an_uninterrupted_one(tmp_path, name, recipe, changes):
    whole = run(name, recipe, changes, counting := make_env(), tmp_path / "whole")
    steps = 10**9 - counting.left
    interruptions = 0
    for share in (0.4, 0.4, 1, 1):
        try:
            pieces = run(name, recipe, changes, Interrupting(int(share * steps)), tmp_path / "pieces")
            break
        except KeyboardInterrupt:
            interruptions += 1
    assert interruptions == 2
    assert pieces == whole
    assert flatten(pieces.agent.state_dict()) == flatten(whole.agent.state_dict())
    assert read_log(tmp_path / "pieces") == read_log(tmp_path / "whole")
    assert load_result(tmp_path / "pieces") == whole == run(name, recipe, changes, make_env())


KILLABLE = """
import sys, time
from hrl_escape.agents import train
from tests.agents.small_envs import ButtonGrid
class Grid(ButtonGrid):
    def step(self, action):
        time.sleep({pause})
        return super().step(action)
train("q-learning", Grid(horizon=40), primitives=3_000, seed=3, eval_every=500, eval_episodes=2, checkpoint_seconds=0,
      out=sys.argv[1])
"""


def start(folder, pause):
    command = [sys.executable, "-c", KILLABLE.format(pause=pause), folder]
    return subprocess.Popen(command, cwd=Path(__file__).parents[3])


def count_rows(folder):
    log = folder / "log.jsonl"
    return log.read_bytes().count(b"\n") if log.exists() else 0


@pytest.mark.nightly
def test_a_run_killed_again_and_again_gives_the_same_bits(tmp_path):
    pieces, whole = tmp_path / "pieces", tmp_path / "whole"
    chance = random.Random(0)
    for target in (1, 40):  # rows of the log after which to kill, a random moment later
        process = start(pieces, pause=0.002)
        while count_rows(pieces) < target:
            assert process.poll() is None, "it finished before it could be killed"
            time.sleep(0.005)
        time.sleep(chance.uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    assert not (pieces / "result.json").exists()
    assert start(pieces, pause=0).wait(600) == start(whole, pause=0).wait(600) == 0
    assert load_result(pieces) == load_result(whole)
    assert read_log(pieces) == read_log(whole)
    for name in ("checkpoint.npz", "best.npz"):
        one, other = (load_checkpoint(folder / name)["agent"] for folder in (pieces, whole))
        assert flatten(one) == flatten(other)


class Pressing(ButtonGrid):
    """Ctrl-C is pressed once, or at every step, from the n-th step of its life on; or another signal comes."""

    def __init__(self, after, again=False, number=signal.SIGINT):
        super().__init__(trace=True, horizon=40)
        self.left, self.again, self.number = after, again, number

    def step(self, action):
        self.left -= 1
        if self.left == 0 or (self.left < 0 and self.again):
            os.kill(os.getpid(), self.number)
        return super().step(action)


def test_ctrl_c_saves_the_episode_that_is_running_and_the_run_goes_on_from_its_end(tmp_path, heeding_ctrl_c):
    with pytest.raises(KeyboardInterrupt, match="continues it"):
        run("q-learning", "default", {}, Pressing(13), tmp_path, checkpoint_seconds=1e9, eval_episodes=0)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    saved, rows = load_checkpoint(tmp_path / "checkpoint.npz"), read_log(tmp_path)
    assert 0 < saved["primitives"] == rows[-1]["primitives"] < 300
    assert rows[-1]["train/end"] in ("terminated", "truncated"), "the episode that ran has ended"
    resumed = run("q-learning", "default", {}, Pressing(10**9), tmp_path, eval_episodes=0)
    assert resumed == run("q-learning", "default", {}, make_env(), eval_episodes=0)


def test_a_second_ctrl_c_stops_at_once(tmp_path, heeding_ctrl_c):
    env = Pressing(13, again=True)
    with pytest.raises(KeyboardInterrupt):
        run("q-learning", "default", {}, env, tmp_path, checkpoint_seconds=1e9, eval_episodes=0)
    assert env.left == -1 and not (tmp_path / "checkpoint.npz").exists()


@pytest.fixture(params=[signal.SIGTERM, signal.SIGHUP])
def ending_signal(request):
    """A signal that raises `Ended`, as in the command line."""
    before = signal.signal(request.param, end_by_signal)
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_to_end_saves_the_episode_that_is_running_and_is_acted_on_after_that(tmp_path, ending_signal):
    ends = []

    class Watch(Callback):
        def on_end(self, result):
            ends.append((result, signal.getsignal(ending_signal)))

    with pytest.raises(Ended) as ended:
        run("q-learning", "default", {}, Pressing(13, number=ending_signal), tmp_path, checkpoint_seconds=1e9,
            eval_episodes=0, callbacks=[Watch()])
    assert ended.value.number == ending_signal and signal.getsignal(ending_signal) is end_by_signal
    ((result, handler),) = ends
    assert result is None and handler is not end_by_signal, "callbacks end their own work before the process does"
    saved, rows = load_checkpoint(tmp_path / "checkpoint.npz"), read_log(tmp_path)
    assert 0 < saved["primitives"] == rows[-1]["primitives"] < 300
    assert rows[-1]["train/end"] in ("terminated", "truncated"), "the episode that ran has ended"
    resumed = run("q-learning", "default", {}, Pressing(10**9, number=ending_signal), tmp_path, eval_episodes=0)
    assert resumed == run("q-learning", "default", {}, make_env(), eval_episodes=0)


def test_a_second_signal_to_end_is_acted_on_at_once(tmp_path, ending_signal):
    env = Pressing(13, again=True, number=ending_signal)
    with pytest.raises(Ended):
        run("q-learning", "default", {}, env, tmp_path, checkpoint_seconds=1e9, eval_episodes=0)
    assert env.left == -1 and not (tmp_path / "checkpoint.npz").exists()


def test_a_signal_in_the_last_episode_ends_the_process_once_the_result_is_written(tmp_path, ending_signal):
    with pytest.raises(Ended):
        run("q-learning", "default", {}, Pressing(1, number=ending_signal), tmp_path, primitives=9,
            eval_episodes=0)
    assert load_result(tmp_path) == run("q-learning", "default", {}, make_env(), primitives=9, eval_episodes=0)


@pytest.mark.nightly
def test_a_signal_without_a_handler_kills_the_process_after_the_checkpoint(tmp_path):
    script = """if True:
        import signal, sys
        from hrl_escape.agents import train
        from tests.agents.training.test_resuming import Pressing
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        train("q-learning", Pressing(13, number=signal.SIGTERM), primitives=300, out=sys.argv[1], eval_episodes=0,
              checkpoint_seconds=1e9)
        """
    assert run_fork(script, str(tmp_path)).returncode == -signal.SIGTERM
    assert 0 < load_checkpoint(tmp_path / "checkpoint.npz")["primitives"] < 300


@pytest.mark.nightly
def test_the_best_checkpoint_is_that_of_the_best_evaluation(tmp_path):
    env = ButtonGrid(trace=True)
    whole = run("q-learning", "default", {}, env, tmp_path, primitives=2500, eval_every=250)
    returns = [evaluation.mean_return for evaluation in whole.evaluations]
    best = whole.evaluations[returns.index(max(returns))]
    assert 0 < best.primitives < whole.primitives, "neither the first evaluation nor the last"
    assert load_checkpoint(tmp_path / "best.npz")["primitives"] == best.primitives
    again = evaluate(load_agent(tmp_path, env, best=True), env, 2, 0, primitives=best.primitives,
                     decisions=best.decisions)
    assert again == best
    assert flatten(load_agent(tmp_path, env).state_dict()) == flatten(whole.agent.state_dict())


def test_a_finished_run_is_returned_without_training_again(tmp_path):
    whole = run("q-learning", "default", {}, make_env(), tmp_path)
    assert run("q-learning", "default", {}, Interrupting(0), tmp_path) == whole


def test_the_trained_agent_can_be_loaded_from_its_folder(tmp_path):
    whole = run("smdp-dqn", "default", SMALL["dqn"], make_env(), tmp_path)
    assert flatten(load_agent(tmp_path, make_env()).state_dict()) == flatten(whole.agent.state_dict())


def test_a_folder_of_another_run_is_left_alone_and_the_difference_named(tmp_path):
    run("q-learning", "default", {}, make_env(), tmp_path)
    before = (tmp_path / "log.jsonl").read_bytes()
    with pytest.raises(RunMismatchError, match="seed: 3 there, 4 now"):
        run("q-learning", "default", {}, make_env(), tmp_path, seed=4)
    assert (tmp_path / "log.jsonl").read_bytes() == before
    with pytest.raises(RunMismatchError, match=r"differs in settings\.gamma: 0\.99 there, 0\.9 now\. Choose"):
        run("q-learning", "default", {"gamma": 0.9}, make_env(), tmp_path)


def test_two_processes_cannot_train_into_one_folder(tmp_path):
    class Nested(ButtonGrid):
        def step(self, action):
            run("q-learning", "default", {}, make_env(), tmp_path)

    with pytest.raises(RunBusyError, match="another process"):
        run("q-learning", "default", {}, Nested(), tmp_path)


def interrupt(folder):
    """Leave an unfinished run with a checkpoint."""
    with pytest.raises(KeyboardInterrupt):
        run("q-learning", "default", {}, Interrupting(150), folder)


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other"])
def test_a_damaged_checkpoint_is_named_and_nothing_is_overwritten(tmp_path, damage):
    interrupt(tmp_path)
    path = tmp_path / "checkpoint.npz"
    content = path.read_bytes()
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 255]) + content[middle + 1 :]
    path.write_bytes({"cut": content[:middle], "flip": flipped, "empty": b"", "other": b"hello"}[damage])
    with pytest.raises(CheckpointError, match=r"checkpoint\.npz: this checkpoint is damaged"):
        run("q-learning", "default", {}, make_env(), tmp_path)
    assert path.read_bytes() != content


def test_a_log_that_is_a_link_is_refused_and_its_target_kept(tmp_path):
    interrupt(tmp_path / "run")
    log = tmp_path / "run" / "log.jsonl"
    log.rename(tmp_path / "mine")
    with open(tmp_path / "mine", "ab") as file:
        file.write(b"what resuming would cut off")
    log.symlink_to(tmp_path / "mine")
    before = (tmp_path / "mine").read_bytes()
    with pytest.raises(FileWriteError, match=r"log\.jsonl: it is a link"):
        run("q-learning", "default", {}, make_env(), tmp_path / "run")
    assert (tmp_path / "mine").read_bytes() == before


class Deleting:
    """Stands where a tensor would in a state, and deletes its run's folder while the state is packed."""

    def __init__(self, folder):
        self.folder = folder

    def detach(self):
        shutil.rmtree(self.folder)
        return self

    def cpu(self):
        return self

    def numpy(self):
        return np.zeros(3)


@pytest.mark.parametrize("save", ["save", "save_best"])
def test_a_folder_that_is_deleted_meanwhile_does_not_come_back_as_a_lone_checkpoint(tmp_path, save):
    folder = RunFolder(tmp_path / "run", {"format": 3})
    with pytest.raises(FileWriteError, match=r"log\.jsonl was deleted or moved while its run was writing it"):
        getattr(folder, save)({"agent": Deleting(tmp_path / "run")})
    folder.close()
    assert not (tmp_path / "run").exists()


def test_a_checkpoint_that_would_unpickle_is_refused(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    np.savez(tmp_path / "x.npz", tree=np.array(Bomb(), dtype=object))
    with pytest.raises(CheckpointError):
        load_checkpoint(tmp_path / "x.npz")
    assert not (tmp_path / "exploded").exists()


def test_a_log_shorter_than_its_checkpoint_says_is_refused(tmp_path):
    interrupt(tmp_path)
    log = tmp_path / "log.jsonl"
    log.write_bytes(log.read_bytes()[:50])
    with pytest.raises(CheckpointError, match=r"log\.jsonl: this log is damaged"):
        run("q-learning", "default", {}, make_env(), tmp_path)


def test_an_unfinished_run_has_no_result_yet(tmp_path):
    interrupt(tmp_path)
    with pytest.raises(FileReadError, match="no such result of a run"):
        load_result(tmp_path)


@pytest.mark.nightly
@settings(max_examples=20)
@given(decisions=st.integers(0, 60), seed=st.integers(0, 3), variant=st.sampled_from(VARIANTS))
def test_a_state_dict_taken_at_any_decision_goes_on_to_the_same_bits(tmp_path_factory, decisions, seed, variant):
    """Also in the middle of an episode, where an environment that can be saved would let a run go on."""
    agent, restored, env = make(*variant, seed=seed), make(*variant, seed=9), make_env()
    steps = interact(agent, env, decisions + 20, seed)
    for _ in range(decisions):
        next(steps)
    path = tmp_path_factory.mktemp("state") / "agent.npz"
    save_checkpoint(path, agent.state_dict())
    restored.load_state_dict(load_checkpoint(path))
    assert flatten(restored.state_dict()) == flatten(agent.state_dict())
    for transition in steps:
        assert serve_one(restored).act(transition.observation, transition.action_mask) == transition.action
        serve_one(restored).observe(transition)
    assert flatten(restored.state_dict()) == flatten(agent.state_dict())


def test_of_equally_good_evaluations_the_first_is_kept(tmp_path):
    whole = run("random", "default", {}, ButtonGrid(trace=True), tmp_path, primitives=900, eval_every=100,
                eval_episodes=1)
    returns = [evaluation.mean_return for evaluation in whole.evaluations]
    first = whole.evaluations[returns.index(max(returns))]
    assert returns.count(max(returns)) > 1, "the same episode by the same policy"
    assert load_checkpoint(tmp_path / "best.npz")["primitives"] == first.primitives
