"""A local chat endpoint that answers well, badly, slowly and maliciously. Its model presses every option in turn."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

KEY = "sk-secret-0123456789"
SLOW = 6.0
"""Seconds that a slow answer takes."""


class FakeEndpoint:
    """State of a server.

    Attributes:
        url: address up to `/v1`.
        requests: bodies, in the order of arrival.
        keys: `Authorization` headers.
        answered: replies with status 200 whose usage counts.
        stolen: headers of requests that followed a redirect.
        usage: tokens that a good answer claims; by default 1,000 read and 10 written.
    """

    def __init__(self, faults: Callable[[int], str]) -> None:
        self.faults, self.url = faults, ""
        self.requests: list[Any] = []
        self.keys: list[str | None] = []
        self.stolen: list[str | None] = []
        self.answered = 0
        self.usage: dict[str, Any] = {"prompt_tokens": 1000, "completion_tokens": 10}
        self.lock = threading.Lock()


@contextmanager
def run_endpoint(faults: Callable[[int], str] | Sequence[str] = ()) -> Iterator[FakeEndpoint]:
    """Serve on a free port of 127.0.0.1.

    Args:
        faults: name of the fault of each request by its number, or names for the first requests; empty for none.
    """
    names = faults if callable(faults) else lambda number: faults[number] if number < len(faults) else ""
    endpoint = FakeEndpoint(names)

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *args: Any) -> None:
            pass

        def do_GET(self) -> None:
            endpoint.stolen.append(self.headers.get("Authorization"))
            self.send(200, b"{}")

        def do_POST(self) -> None:
            if self.path.endswith("/stolen"):
                endpoint.stolen.append(self.headers.get("Authorization"))
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            with endpoint.lock:
                number = len(endpoint.requests)
                endpoint.requests.append(body)
                endpoint.keys.append(self.headers.get("Authorization"))
            try:
                self.answer(body, endpoint.faults(number))
            except OSError:
                pass  # the client has gone

        def send(self, status: int, content: bytes, **headers: str) -> None:
            self.send_response(status)
            for name, value in {"Content-Length": str(len(content)), **headers}.items():
                self.send_header(name.replace("_", "-"), value)
            self.end_headers()
            self.wfile.write(content)

        def answer(self, body: Any, fault: str) -> None:
            if body.get("stream"):
                return self.send(200, make_stream(body), Content_Type="text/event-stream")
            good = make_answer(body, endpoint.usage)
            content = json.dumps(good).encode()
            if fault == "busy":
                self.send(429, b"slow down", Retry_After="0")
            elif fault == "broken":
                self.send(500, f"\x1b[31m{self.headers.get('Authorization')}".encode())
            elif fault == "refused":
                self.send(401, f"no such key: {self.headers.get('Authorization')}".encode())
            elif fault == "redirect":
                self.send(302, b"", Location=f"{endpoint.url}/stolen")
            elif fault == "silent":
                time.sleep(SLOW)
            elif fault in ("trickle", "trickling head"):
                self.wfile.write(b"HTTP/1.1 200 OK\r\n")
                if fault == "trickle":
                    self.wfile.write(b"Content-Length: 100000\r\n\r\n")
                for _ in range(int(SLOW / 0.1)):
                    self.wfile.write(b"X-A: b\r\n" if fault != "trickle" else b" ")
                    self.wfile.flush()
                    time.sleep(0.1)
            elif fault == "cut":
                self.send(200, content[:40], Content_Length=str(len(content)))
                self.close_connection = True
            elif fault == "garbage":
                self.send(200, b"<html>\xff")
            elif fault == "nested":
                self.send(200, b"[" * 100_000)
            elif fault == "endless":
                self.send_response(200)
                self.end_headers()
                for _ in range(200):
                    self.wfile.write(b" " * 65536)
            elif fault == "empty":
                self.send(200, b'{"choices": []}')
            else:
                message = good["choices"][0]["message"]
                if fault == "words":
                    message.update(tool_calls=[], content="I think.\x1b]0;hi\x07 \ud800")
                elif fault == "many":
                    message["tool_calls"] *= 500
                elif fault == "usage":
                    good["usage"] = {"prompt_tokens": -5, "completion_tokens": float("inf"), "x": 10**30}
                elif fault == "unknown":
                    message["tool_calls"][0]["function"] = {"name": "rm -rf /\x1b[2J", "arguments": {"a": ["b"] * 1000}}
                elif fault == "form":
                    function = message["tool_calls"][0]["function"]
                    function.update(name=f"mcp__rooms__{function['name']}", arguments=json.loads(function["arguments"]))
                else:
                    with endpoint.lock:
                        endpoint.answered += 1
                self.send(200, json.dumps(good).encode())

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads, server.block_on_close = True, False
    endpoint.url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield endpoint
    finally:
        server.shutdown()
        server.server_close()


def make_answer(body: Any, usage: dict[str, Any]) -> dict[str, Any]:
    """Completion of a model that takes the options in turn, and the tokens that it claims."""
    functions = {tool["function"]["name"]: tool["function"]["parameters"] for tool in body["tools"]}
    options = functions["run_option"]["properties"]["option"]["enum"]
    turns = sum(message["role"] == "tool" for message in body["messages"])
    call = {"id": "a", "type": "function", "function": {
        "name": "run_option", "arguments": json.dumps({"option": options[turns % len(options)]})}}
    return {"choices": [{"message": {"role": "assistant", "content": None, "tool_calls": [call]}}],
            "usage": usage}


def make_stream(body: Any) -> bytes:
    """Events of a model without tools that writes a call in each reply: the options of the first message in turn."""
    options = re.findall(r"Options: (.*)", body["messages"][0]["content"])[0].split(", ")
    turn = sum(message["role"] == "assistant" for message in body["messages"])
    call = json.dumps({"tool": "run_option", "arguments": {"option": options[turn % len(options)]}})
    parts = [{"index": 0, "delta": {"role": "assistant", "content": f"I call {call}"}, "finish_reason": None},
             {"index": 0, "delta": {}, "finish_reason": "stop"}]
    events = [{"id": "a", "object": "chat.completion.chunk", "created": 0, "model": body["model"], "choices": [part],
               "usage": {"prompt_tokens": 5, "completion_tokens": 5, "total_tokens": 10}} for part in parts]
    return "".join(f"data: {text}\n\n" for text in [*map(json.dumps, events), "[DONE]"]).encode()


FAULTS = ("busy", "broken", "silent", "trickle", "trickling head", "cut", "garbage", "nested", "endless", "empty",
          "words", "many", "usage", "unknown", "form")
"""Faults after which a game can go on."""
SLOW_FAULTS = ("silent", "trickle", "trickling head")
