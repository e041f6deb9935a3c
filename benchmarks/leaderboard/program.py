"""Programs as agents: a process that reads observations and masks as JSON and writes the numbers of actions."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from hrl_escape.agents.agent import FixedPolicy, SMDPTransition
from hrl_escape.errors import ContractError, show_value
from hrl_escape.names import parse_whole

ANSWER_SECONDS = 120.0
"""Time limit of a program for a decision, s; its start counts with the first."""
LONGEST_LINE = 100


class ProgramAgent(FixedPolicy):
    """Agent that is a program in a process of its own; leaving its `with` block ends the process and its children.

    For every decision the program reads one line of JSON from its standard input,

        {"observation": [0.0, 1.0, ...], "mask": [1, 0, 1], "start": true, "words": ["present", ...]}

    with the vector that it observes, 1 for each legal action, whether an episode begins, and then the meaning of the
    numbers in a row of `objects`. It writes one line, the number of its action. The program gets neither room, seed,
    reward nor `info`, and no variable of the caller's environment except PATH. It can still read files
    or use the network, so start only programs that you have read.

    Args:
        name: of the agent, for messages.
        command: that starts the program, such as `("python", "agent.py")`.
        folder: with the program's files; its working folder.
        words: meaning of the numbers in a row, if the observation has rows.
    """

    def __init__(self, name: str, command: Sequence[str], folder: Path, words: Sequence[str] = ()) -> None:
        self._name, self._words, self._is_start = name, list(words), True
        self._log = folder / "stderr.txt"
        first, *others = command
        variables = {"PATH": os.environ.get("PATH", os.defpath), "HOME": str(folder), "TMPDIR": str(folder),
                     "LANG": "C.UTF-8", "OMP_NUM_THREADS": "1"}
        try:
            with open(self._log, "wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable if first == "python" else first, *others], cwd=folder, env=variables,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=0, start_new_session=True)
        except (OSError, ValueError) as error:
            reason = str(getattr(error, "strerror", None) or error)
            raise ContractError(name, f"{show_value(first)} can be started", reason) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in filter(None, (self._process.stdin, self._process.stdout)):
            with suppress(OSError):
                pipe.close()

    def act(self, observation: NDArray[np.floating], action_mask: NDArray[np.bool_]) -> int:
        """Return the program's action.

        Raises:
            ContractError: the program has ended, does not answer, or answers with an illegal action.
        """
        look = {"observation": np.asarray(observation, np.float64).tolist(),
                "mask": np.asarray(action_mask).astype(int).tolist(), "start": self._is_start}
        look |= {"words": self._words} if self._is_start else {}
        self._is_start = False
        answer = self._ask(json.dumps(look).encode() + b"\n")
        action = parse_whole(answer.strip())
        if action is None or action >= len(action_mask) or not action_mask[action]:
            legal = ", ".join(map(str, np.flatnonzero(action_mask)))
            raise ContractError(self._name, f"it answers with a legal action's number ({legal[:LONGEST_LINE]})",
                                show_value(answer[:LONGEST_LINE]))
        return action

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Announce the start of an episode in the program's next line, after an episode has ended."""
        self._is_start = transition.terminated or transition.truncated

    def _ask(self, line: bytes) -> str:
        source, answer = self._process.stdout, b""
        assert source is not None and self._process.stdin is not None
        try:
            self._process.stdin.write(line)
            while not answer.endswith(b"\n") and len(answer) <= LONGEST_LINE:
                if not select.select([source], [], [], ANSWER_SECONDS)[0]:
                    raise ContractError(self._name, f"it answers within {ANSWER_SECONDS:.0f} s", "nothing")
                piece = os.read(source.fileno(), LONGEST_LINE)
                if not piece:
                    raise BrokenPipeError
                answer += piece
        except BrokenPipeError:
            last = self._log.read_bytes()[-2000:].decode(errors="replace").strip().splitlines()[-1:]
            raise ContractError(self._name, "it answers until it is ended",
                                f"its end, and last {show_value(last[0] if last else 'no word')}") from None
        return answer.decode(errors="replace")
