"""The Model Context Protocol on two streams, one JSON-RPC message a line: the tools of a `GameSeries`.

The protocol is implemented here because the package `mcp` takes a second to import, and rejects arguments that
`hrl_escape.text.coercion` reads.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO

from hrl_escape.errors import ClosedError, EscapeError, FileReadError
from hrl_escape.files import parse_json
from hrl_escape.text.series import GameSeries
from hrl_escape.version import __version__

VERSIONS = ("2024-11-05", "2025-03-26", "2025-06-18", "2025-11-25")
"""Versions of the protocol; a client that names none of them is offered the last one."""
PERIOD, MOST_BYTES = 1.0, 4_000_000
"""Seconds between two progress notifications; longest message, bytes."""
NOT_JSON, NO_REQUEST, NO_METHOD, WRONG_PARAMETERS, FAILED = -32700, -32600, -32601, -32602, -32603
"""Error codes of JSON-RPC."""


class RequestError(Exception):
    """A request has no result.

    Attributes:
        code: error code of JSON-RPC.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class McpServer:
    """Serves games to one client.

    The planners load while the client reads its tools. A client that asked for progress receives the primitives of the
    game once a second during a call.

    Args:
        series: the games. The first text of the first game is the instructions of the server.
        reading: stream of the client's messages.
        writing: stream of the answers.
    """

    def __init__(self, series: GameSeries, reading: BinaryIO, writing: BinaryIO) -> None:
        self._series, self._reading, self._writing = series, reading, writing
        self._write_lock = threading.Lock()
        self._preparation = threading.Thread(target=series.prepare)

    def serve(self) -> None:
        """Answer messages until the client disconnects."""
        while line := self._reading.readline(MOST_BYTES):
            if line.strip():
                self._hear(line)

    def _hear(self, line: bytes) -> None:
        number = None
        try:
            try:
                message = parse_json(line, "standard input", "message")
            except FileReadError as error:
                raise RequestError(NOT_JSON, str(error)) from error
            if not isinstance(message, dict) or not isinstance(message.get("method"), str):
                raise RequestError(NO_REQUEST, "a message is a JSON object with a method")
            if "id" not in message:
                if message["method"] == "notifications/initialized" and self._preparation.ident is None:
                    self._preparation.start()
                return
            if type(message["id"]) not in (int, str):
                raise RequestError(NO_REQUEST, "an id is a whole number or a text")
            number, parameters = message["id"], message.get("params")
            result = self._answer(message["method"], parameters if isinstance(parameters, dict) else {})
        except RequestError as error:
            self._write({"id": number, "error": {"code": error.code, "message": str(error)}})
        else:
            self._write({"id": number, "result": result})

    def _answer(self, method: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
        if method == "initialize":
            asked = parameters.get("protocolVersion")
            return {"protocolVersion": asked if asked in VERSIONS else VERSIONS[-1],
                    "capabilities": {"tools": {"listChanged": True}},
                    "serverInfo": {"name": "hrl-escape", "version": __version__},
                    "instructions": self._series.introduction}
        if method == "ping":
            return {}
        if method == "tools/list":
            return {"tools": self._series.tools()}
        if method == "tools/call":
            return self._call(parameters)
        raise RequestError(NO_METHOD, f"this server has no method {method[:200]!r}")

    def _call(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        name, meta = parameters.get("name"), parameters.get("_meta")
        if not isinstance(name, str):
            raise RequestError(WRONG_PARAMETERS, "tools/call needs the name of a tool")
        token = meta.get("progressToken") if isinstance(meta, dict) else None
        before = self._series.number
        with self._reporting(token if type(token) in (int, str) else None):
            if self._preparation.is_alive():
                self._preparation.join()
            try:
                result = self._series.call(name, parameters.get("arguments"))
            except EscapeError as error:  # the recording cannot be written
                raise RequestError(FAILED, str(error)) from error
        if self._series.number != before:  # the next room has other options
            self._write({"method": "notifications/tools/list_changed"})
        return {"content": [{"type": "text", "text": result.text}], "isError": result.is_error}

    @contextmanager
    def _reporting(self, token: int | str | None) -> Iterator[None]:
        """Report the primitives of the game at once, and then every `PERIOD`."""
        if token is None:
            yield
            return
        is_done = threading.Event()

        def report() -> None:
            while True:
                env = self._series.session.env
                with suppress(ClosedError):  # the call has just left this game
                    self._write({"method": "notifications/progress", "params": {
                        "progressToken": token, "progress": env.state.primitives, "total": env.instance.horizon,
                        "message": "primitives of this game"}})
                if is_done.wait(PERIOD):
                    return

        reporter = threading.Thread(target=report)
        reporter.start()
        try:
            yield
        finally:
            is_done.set()
            reporter.join()

    def _write(self, message: Mapping[str, Any]) -> None:
        with self._write_lock:
            self._writing.write(json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n")
            self._writing.flush()
