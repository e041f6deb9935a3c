"""Language models behind an OpenAI-compatible chat endpoint, as callers of a room's tools.

`ChatClient` sends one request and returns the model's reply. `ChatModel` is a caller like those of
`hrl_escape.text.managers`: it turns a transcript into messages and a reply into a call. Requires the extra `llm`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import random
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hrl_escape.errors import ConfigError, EndpointError, EscapeError, MissingExtraError
from hrl_escape.files import parse_json
from hrl_escape.settings import ExactCount
from hrl_escape.text.text_env import ToolCall, Turn

MOST_BYTES, MOST_SAID, LONGEST_WAIT = 4_000_000, 20_000, 60.0
"""Largest body of an answer, bytes; most characters of a reply that are sent back; longest pause before a retry, s."""

INSTRUCTIONS = ("You play a game by calling tools. Every reply must call one tool. Find out what the options do, open "
                "the exit and leave in as few primitives as you can.")
REMINDER = "Call one of the tools."


@dataclasses.dataclass(frozen=True)
class Usage:
    """Tokens and requests.

    Attributes:
        prompt_tokens: tokens that the endpoint counted as read.
        completion_tokens: tokens that it counted as written.
        requests: requests that were answered.
        retries: requests that failed and were sent again.
    """

    prompt_tokens: ExactCount = 0
    completion_tokens: ExactCount = 0
    requests: ExactCount = 0
    retries: ExactCount = 0

    def add(self, other: Usage) -> Usage:
        """Return the sum."""
        return Usage(*map(sum, zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)))

    def compute_cost(self, prices: tuple[float, float]) -> float:
        """Return the cost in dollars at prices per million tokens, read and written."""
        return (self.prompt_tokens * prices[0] + self.completion_tokens * prices[1]) / 1e6


class Reply(NamedTuple):
    """Reply of a model.

    Attributes:
        text: what it said.
        call: its first tool call, with the arguments as sent, or None.
        usage: tokens of this request.
    """

    text: str
    call: ToolCall | None
    usage: Usage


class Budget:
    """Limits of tokens, dollars and seconds for all games together; several threads can use it.

    Args:
        tokens: most tokens, read and written.
        dollars: most dollars, at `prices`.
        seconds: most seconds from now.
        prices: dollars per million tokens, read and written.
        spent: usage of earlier games that counts.

    Raises:
        ConfigError: a limit or price is negative or not finite, or there is a limit of dollars without prices.
    """

    def __init__(self, tokens: int | None = None, dollars: float | None = None, seconds: float | None = None,
                 prices: tuple[float, float] = (0.0, 0.0), spent: Usage = Usage()) -> None:  # noqa: B008  # immutable
        for name, value in (("tokens", tokens), ("dollars", dollars), ("seconds", seconds), ("price", prices[0]),
                            ("price", prices[1])):
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ConfigError(name, value, "a finite number of at least 0")
        if dollars is not None and not any(prices):
            raise ConfigError("dollars", dollars, "left out without prices, because the cost of tokens is unknown")
        self.prices, self.spent, self._lock = prices, spent, threading.Lock()
        self._tokens, self._dollars, self._stopped = tokens, dollars, ""
        self._end = None if seconds is None else time.monotonic() + seconds

    def charge(self, usage: Usage) -> None:
        """Count a request."""
        with self._lock:
            self.spent = self.spent.add(usage)

    def stop(self, reason: str) -> None:
        """Let no further request be sent."""
        self._stopped = reason

    def find_reason(self) -> str:
        """Return the limit that has been reached, or empty text."""
        if self._stopped:
            return self._stopped
        if self._tokens is not None and self.spent.prompt_tokens + self.spent.completion_tokens >= self._tokens:
            return f"the budget of {self._tokens:,} tokens is spent"
        if self._dollars is not None and self.spent.compute_cost(self.prices) >= self._dollars:
            return f"the budget of {self._dollars:g} dollars is spent"
        return "the time limit is reached" if self.seconds_left <= 0 else ""

    @property
    def seconds_left(self) -> float:
        """Seconds until the time limit; infinite without one."""
        return math.inf if self._end is None else self._end - time.monotonic()


class GameStopped(Exception):  # noqa: N818  # an outcome, not a defect
    """A game cannot continue.

    Attributes:
        counts: whether the game counts as it is. A game that a budget stops is played again.
    """

    def __init__(self, reason: str, counts: bool) -> None:
        super().__init__(reason)
        self.counts = counts


class ChatClient:
    """An OpenAI-compatible chat endpoint with tools.

        client = ChatClient("my-model", "http://localhost:8000/v1", key=os.environ.get("OPENAI_API_KEY"))

    Failed requests are sent again, with pauses that double, or as long as `Retry-After` says. Redirects are not
    followed, so the key reaches no other host. The key is in no message, recording or file.

    Args:
        name: name of the model.
        endpoint: address up to `/v1`.
        key: sent as a bearer token, or None.
        request_seconds: longest request, from the first byte sent to the last one read.
        retries: most retries of a request.
        backoff: first pause, s.
        options: further fields of a request, such as `temperature`; kept as an attribute.

    Raises:
        ConfigError: the endpoint is not an HTTP address, or a limit is negative.
        MissingExtraError: the extra `llm` is not installed.
    """

    def __init__(self, name: str, endpoint: str, key: str | None = None, request_seconds: float = 120.0,
                 retries: int = 5, backoff: float = 1.0, options: Mapping[str, Any] | None = None) -> None:
        try:
            import httpx2  # loaded here: commands without a model do not need it
        except ImportError as missing:
            raise MissingExtraError("httpx2", "llm", "A language model behind an endpoint") from missing
        if not endpoint.startswith(("http://", "https://")) or any(letter.isspace() for letter in endpoint):
            raise ConfigError("endpoint", endpoint, "an address such as http://localhost:8000/v1")
        if "@" in endpoint:
            raise ConfigError("endpoint", "with a name or password", "an address without them: use the key")
        for what, value in (("request_seconds", request_seconds), ("retries", retries), ("backoff", backoff)):
            if not (math.isfinite(value) and value >= 0):
                raise ConfigError(what, value, "a finite number of at least 0")
        if key is not None and not (key.isascii() and key.isprintable() and key.strip()):
            raise ConfigError("key", "of the endpoint", "printable ASCII characters without line breaks")
        self.name, self.endpoint, self._key = name, endpoint.rstrip("/"), key
        self._seconds, self._retries, self._backoff = request_seconds, retries, backoff
        self.options, self._rng, self._http = dict(options or {}), random.Random(0), httpx2
        headers = {"Accept-Encoding": "identity", "Content-Type": "application/json",
                   **({"Authorization": f"Bearer {key}"} if key else {})}
        self._client = httpx2.Client(headers=headers, follow_redirects=False,
                                     limits=httpx2.Limits(max_keepalive_connections=0))

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def complete(self, messages: Sequence[Mapping[str, Any]], tools: Sequence[Mapping[str, Any]],
                 seconds: float = math.inf) -> Reply:
        """Send a conversation and return the reply.

        Args:
            messages: conversation in the form of chat completions.
            tools: tools in that form.
            seconds: time limit with all retries.

        Raises:
            EndpointError: the endpoint refuses the request, or no retry succeeded.
        """
        body = json.dumps({"model": self.name, "messages": messages, "tools": tools, "tool_choice": "auto",
                           **self.options}).encode()
        end, problem = time.monotonic() + seconds, ""
        for tries in range(self._retries + 1):
            limit = min(self._seconds, end - time.monotonic())
            if limit <= 0:
                break
            try:
                status, wait, answer = self._send(body, limit)
            except self._http.HTTPError as error:
                status, wait, answer, problem = 0, None, b"", f"{type(error).__name__}: {error}"
            except TimeoutError as error:
                status, wait, answer, problem = 0, None, b"", str(error)
            if status == 200:
                try:
                    return _parse_reply(answer, tries)
                except (EscapeError, KeyError, TypeError, IndexError, ValueError, RecursionError) as error:
                    problem = f"the answer is no chat completion ({type(error).__name__})"
            elif status:
                problem = f"status {status}: {answer[:300].decode('utf-8', 'replace')}"
                if status not in (408, 409, 425, 429) and status < 500:
                    break
            if tries < self._retries:
                pause = self._backoff * 2**tries * (0.5 + self._rng.random()) if wait is None else wait
                time.sleep(max(0.0, min(pause, LONGEST_WAIT, end - time.monotonic())))
        raise EndpointError(self._show(problem or "the time limit is reached"))

    def _send(self, body: bytes, limit: float) -> tuple[int, float | None, bytes]:
        """Return status, pause of `Retry-After` and body of an answer that arrives whole within the limit.

        The client's timeouts apply to one read, which a server that trickles never exceeds. A timer shuts the socket
        down instead.
        """
        sockets, parts, size, is_late = [], list[bytes](), 0, threading.Event()

        def watch(event: str, info: Mapping[str, Any]) -> None:
            if event in ("connection.connect_tcp.complete", "connection.start_tls.complete"):
                sockets.append(info["return_value"].get_extra_info("socket"))

        def shut() -> None:
            is_late.set()
            for each in sockets:
                with contextlib.suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(limit, shut)
        timer.daemon = True
        timer.start()
        try:
            with self._client.stream("POST", f"{self.endpoint}/chat/completions", content=body, timeout=limit,
                                     extensions={"trace": watch}) as answer:
                for part in answer.iter_raw():
                    size += len(part)
                    parts.append(part)
                    if size > MOST_BYTES:
                        raise TimeoutError(f"the answer is longer than {MOST_BYTES:,} bytes")
                return answer.status_code, _read_seconds(answer.headers.get("retry-after")), b"".join(parts)
        except self._http.HTTPError as error:
            if is_late.is_set():
                raise TimeoutError(f"no whole answer within {limit:.1f} s") from error
            raise
        finally:
            timer.cancel()

    def _show(self, problem: str) -> str:
        said = f"{self.endpoint} gave no reply: {problem}"
        text = "".join(letter if letter.isprintable() else " " for letter in said)
        return text.replace(self._key, "(key)") if self._key else text


def _read_seconds(value: str | None) -> float | None:
    try:
        seconds = float(value or "")
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and seconds >= 0 else None


def _parse_reply(body: bytes, retries: int) -> Reply:
    content = parse_json(body, "the endpoint", "chat completion")
    message, said = content["choices"][0]["message"], content.get("usage")
    calls, text = message.get("tool_calls") or [], message.get("content")
    call = None
    if calls:
        function = calls[0]["function"]
        call = ToolCall(function["name"], function.get("arguments"))
    usage = said if isinstance(said, dict) else {}
    return Reply(text[:MOST_SAID] if isinstance(text, str) else "", call, Usage(
        _read_count(usage.get("prompt_tokens")), _read_count(usage.get("completion_tokens")), 1, retries))


def _read_count(value: Any) -> int:
    return value if type(value) is int and 0 <= value < 10**9 else 0


class ChatModel:
    """A language model as the caller of one game's tools.

    Args:
        client: `ChatClient`, or another object with its `complete`.
        budget: limits of all games together.
        most_silent: replies in a row without a call that end the game.

    Attributes:
        usage: tokens and requests of the game.
    """

    def __init__(self, client: Any, budget: Budget | None = None, most_silent: int = 3) -> None:
        self._client, self._budget, self._most_silent = client, budget or Budget(), most_silent
        self._said: dict[int, str] = {}
        self.usage = Usage()

    def __call__(self, transcript: Sequence[Turn], tools: Sequence[Mapping[str, Any]]) -> ToolCall:
        """Return the model's next call.

        Raises:
            GameStopped: the budget is spent, or the model calls no tool.
            EndpointError: the endpoint gives no reply.
        """
        messages = make_messages(transcript, self._said)
        for _ in range(self._most_silent):
            if reason := self._budget.find_reason():
                raise GameStopped(reason, counts=False)
            try:
                reply = self._client.complete(messages, make_functions(tools), self._budget.seconds_left)
            except EndpointError:
                if reason := self._budget.find_reason():
                    raise GameStopped(reason, counts=False) from None
                raise
            self._budget.charge(reply.usage)
            self.usage = self.usage.add(reply.usage)
            if reply.call is not None:
                self._said[len(transcript)] = reply.text
                return reply.call
            messages += [{"role": "assistant", "content": reply.text or "..."}, {"role": "user", "content": REMINDER}]
        raise GameStopped(f"{self._most_silent} replies without a call", counts=True)


def make_messages(transcript: Sequence[Turn], said: Mapping[int, str]) -> list[dict[str, Any]]:
    """Return a transcript as messages of a chat; `said` holds the texts that came with calls, by their turn."""
    messages: list[dict[str, Any]] = [{"role": "system", "content": INSTRUCTIONS}]
    for number, turn in enumerate(transcript):
        if turn.call is None:
            messages.append({"role": "user", "content": turn.text})
            continue
        arguments = turn.call.arguments if isinstance(turn.call.arguments, str) else json.dumps(turn.call.arguments)
        call = {"id": f"call_{number}", "type": "function",
                "function": {"name": turn.call.name, "arguments": arguments}}
        messages += [{"role": "assistant", "content": said.get(number) or None, "tool_calls": [call]},
                     {"role": "tool", "tool_call_id": f"call_{number}", "content": turn.text}]
    return messages


def make_functions(tools: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the tools of a game in the form of chat completions."""
    return [{"type": "function", "function": {"name": tool["name"], "description": tool["description"],
                                              "parameters": tool["inputSchema"]}} for tool in tools]
