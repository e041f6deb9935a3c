"""Inputs of right and wrong kinds for files, the public API and the command line, in thousands.

Run: `python -m benchmarks.fuzzing --calls 10000 --files 10000 --commands 200`. Calls of the API are listed in
`tests/fuzzing.py`, kinds of files in `tests/fuzzed_files.py`. Each input is accepted or refused by an error of the
package, within ten seconds of the processor. Everything else is printed with its seed: errors of other types (raw),
waits, and processes that died. Exits with 1 if there was one, or if a process took more than 2 GB.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
from hypothesis import HealthCheck, Phase, given, seed, settings

from hrl_escape.cli import main as main_of_cli
from hrl_escape.errors import EscapeError
from tests.fuzzed_files import KINDS, FileKind, change_file
from tests.fuzzing import make_calls, run_call

SECONDS, WAIT = 10, 120
"""Most seconds of an input: of the processor, and of a clock on a busy machine."""
LARGEST = 2 * 10**9
"""Most memory of a process, bytes."""
BATCH = 250
"""Inputs of one process."""
COMMANDS = (
    "room --room {room}", "solve --room {room}", "plan --room {room} {goal}",
    "train {agent} --room {room} --primitives 20 --eval-episodes 0 --out {folder}/run",
    "record --room {room} --out {folder}/x.html", "list {word}",
    "list agents {word}", "data list", "data info {path}", "run show {path}", "run pack {path} {folder}/x.zip",
    "run unpack {path} {folder}/out", "convert {path} {folder}/converted", "compare {path} --out {folder}/out",
    "watch --help", "{word} {word}", "ladder run {word} --agent {agent} --out {folder}/out", "ladder report {path}",
    "mcp --room {room} --record {folder}/x.jsonl", "room --room {room} --set {word}",
    "room --room clutter --set {word}",
)
ROOMS = ("clutter", "clutter#3", "clutter#0..1000000000", "clutter#*", "ladder-1/pair/test#0", "ladder-1/x/test", "#",
         "clutter#-1", "clutter x 3", "a + b", "larg-2019(size=4)", "larg-2019(size=10**9)", "larg-2019(size=nan)",
         "()", "paper-two-button#999999999999999999", "ladder-1/pair/train#5..2", "x" * 20_000,
         "{path}", "{path}", "{path}")
WORDS = ("", "-", "--", "--seed", "robot.body_radius=nan", "room.width=1e999", "puzzle.count=1000000000", "agents",
         "horizon=" + "9" * 5000, "robot.joints=99", "button-1", "exit", "1,2", "nan,nan", "--help", "dqn", "../..",
         "[" * 500)
AGENTS = ("q-learning", "smdp-dqn", "dqn(gamma=5)", "smdp-dqn(", "ppo+memory+memory", "nobody", "dqn@x", "", "+",
          "smdp-dqn+objects", "text-agent(model=1)", "dqn(learning_rate=nan)")


def run_calls(first: int, count: int) -> Iterator[str]:
    """Make calls of the API; yields how each ends."""
    ends: list[str] = []

    @seed(first)
    @settings(max_examples=count, deadline=None, database=None, phases=[Phase.generate],
              suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large])
    @given(call=make_calls())
    def fuzz(call: tuple[str, str, tuple[Any, ...]]) -> None:
        ends.append(judge(lambda: "accepted" if run_call(call) else "refused", f"{call!r}"))

    fuzz()
    yield from ends


def run_files(first: int, count: int) -> Iterator[str]:
    """Read changed files; yields how each ends."""
    with tempfile.TemporaryDirectory() as place:
        for number in range(first, first + count):
            chance = random.Random(number)
            name = chance.choice(list(KINDS))
            folder = Path(place) / str(number)
            folder.mkdir()
            path = change_file(KINDS[name], folder, chance)
            yield judge(lambda kind=KINDS[name], path=path: read_file(kind, path), f"{name}, seed {number}")
            shutil.rmtree(folder)


def read_file(kind: FileKind, path: Path) -> str:
    """Read a file, as its kind does."""
    kind.read(path)
    return "accepted"


def judge(read: Callable[[], str], words: str) -> str:
    """Return how an input ends: accepted, refused, or a description that begins with RAW or SLOW."""
    for number in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(number, _stop)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(WAIT)
    try:
        end = read()
    except (EscapeError, gymnasium.error.Error):
        end = "refused"
    except TimeoutError:
        end = f"SLOW {words[:300]}\n{traceback.format_exc()[-1500:]}"
    except Exception:
        end = f"RAW {words[:300]}\n{traceback.format_exc()[-1500:]}"
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
    return end


def _stop(number: int, frame: object) -> None:
    raise TimeoutError


def run_apart(run: Callable[[int, int], Iterator[str]], first: int, count: int) -> tuple[list[str], int]:
    """Run inputs in a fork; returns their ends and the most memory, bytes."""
    source, target = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(source)
        warnings.simplefilter("ignore")
        with os.fdopen(os.open(os.devnull, os.O_WRONLY), "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        with os.fdopen(target, "wb") as pipe:
            for end in run(first, count):
                pipe.write(json.dumps(end).encode() + b"\n")
                pipe.flush()
        os._exit(0)
    os.close(target)
    with os.fdopen(source, "rb", buffering=0) as pipe:
        text, heard = b"", time.monotonic()
        while True:
            ready, _, _ = select.select([pipe], [], [], 1.0)
            if ready:
                if not (more := pipe.read(2**16)):
                    break
                text, heard = text + more, time.monotonic()
            elif time.monotonic() - heard > 600:
                os.kill(child, signal.SIGKILL)
    ends: list[str] = [json.loads(line) for line in text.splitlines()]
    _, status, usage = os.wait4(child, 0)
    if status:
        ends.append(f"DIED {run.__name__}, seeds {first} to {first + count - 1}, after {len(ends)}: status {status}")
    return ends, usage.ru_maxrss * 1024


def run_commands(first: int, count: int) -> Iterator[tuple[str, int]]:
    """Run command lines in forks, which have the libraries already; yields how each ends and its memory, bytes."""
    for number in range(first, first + count):
        with tempfile.TemporaryDirectory() as place:
            child = os.fork()
            if child == 0:
                os.setsid()
                _run_command(number, Path(place))
            end, deadline = "accepted", time.monotonic() + WAIT
            while (found := os.wait4(child, os.WNOHANG))[0] == 0:
                if time.monotonic() > deadline:
                    os.killpg(child, signal.SIGKILL)
                    end, found = "SLOW", os.wait4(child, 0)
                    break
                time.sleep(0.05)
            code = os.waitstatus_to_exitcode(found[1])
            shown, said = ((Path(place) / name).read_text(errors="replace") for name in ("shown", "stderr"))
            if end != "SLOW":
                end = "RAW" if "Traceback" in said else "DIED" if code < 0 else "accepted" if code == 0 else "refused"
            end = end if end.islower() else f"{end} command {number}: {shown}\n{said[-1500:]}"
            yield end, found[2].ru_maxrss * 1024


def _run_command(number: int, folder: Path) -> None:
    """Draw a command line, run it in this process with its files in a folder, and end the process."""
    code: Any = 1
    try:
        for stream, (name, mode) in enumerate(((os.devnull, "r"), (os.devnull, "w"), (folder / "stderr", "w"))):
            with open(name, mode) as file:
                os.dup2(file.fileno(), stream)
        chance = random.Random(number)
        path = change_file(KINDS[chance.choice(list(KINDS))], folder / "file", chance)
        fields = {"folder": str(folder), "path": str(path), "word": chance.choice(WORDS),
                  "agent": chance.choice(AGENTS), "goal": chance.choice(WORDS),
                  "room": chance.choice(ROOMS).replace("{path}", str(path))}
        words = [word.format(**fields) for word in chance.choice(COMMANDS).split(" ")]
        (folder / "shown").write_text(" ".join(word[:80] for word in words))
        os.chdir(folder)
        code = main_of_cli(words)
    except SystemExit as ending:
        code = ending.code
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1 if code else 0)


def main() -> int:
    """Run the inputs and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=10_000, help="calls of the API")
    parser.add_argument("--files", type=int, default=10_000, help="changed files")
    parser.add_argument("--commands", type=int, default=200, help="command lines")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    args = parser.parse_args()
    kinds: list[tuple[Callable[[int, int], Iterator[str]], int]] = [(run_calls, args.calls), (run_files, args.files)]
    failures = 0
    for run, wanted in kinds:
        ends: list[str] = []
        most, at = 0, args.seed
        while at < args.seed + wanted:
            count = min(BATCH, args.seed + wanted - at)
            more, memory = run_apart(run, at, count)
            for end in more:
                if not end.islower():
                    print(end, flush=True)
            ends, most, at = ends + more, max(most, memory), at + count
        failures += _report(run.__name__.removeprefix("run_"), ends, most)
    done: list[tuple[str, int]] = []
    for end, memory in run_commands(args.seed, args.commands):
        done.append((end, memory))
        if not end.islower():
            print(end, flush=True)
    failures += _report("command lines", [end for end, _ in done], max((memory for _, memory in done), default=0))
    return 1 if failures else 0


def _report(what: str, ends: list[str], memory: int) -> int:
    """Print how inputs ended; returns the number that were neither accepted nor refused, and of excess memory."""
    counts = Counter(end.split()[0] for end in ends)
    print(f"{len(ends)} {what}: {counts['accepted']} accepted, {counts['refused']} refused, {counts['RAW']} raw, "
          f"{counts['SLOW']} slow, {counts['DIED']} died; at most {memory / 1e6:,.0f} MB a process", flush=True)
    return counts["RAW"] + counts["SLOW"] + counts["DIED"] + (memory > LARGEST)


if __name__ == "__main__":
    sys.exit(main())
