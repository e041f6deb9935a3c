"""Replies of a chat endpoint as they are read."""

from __future__ import annotations

import pytest

from hrl_escape.text.chat import ChatClient
from tests.text.fake_endpoint import run_endpoint

pytest.importorskip("httpx2", exc_type=ImportError)
TOOL = {"type": "function", "function": {
    "name": "run_option", "parameters": {"properties": {"option": {"enum": ["go-to-exit"]}}}}}


@pytest.mark.parametrize("claimed, counted", [(10**9 - 1, 10**9 - 1), (10**9, 0), (-1, 0), (True, 0), (2.0, 0)])
def test_numbers_of_tokens_that_cannot_be_count_as_none(claimed: object, counted: int):
    with run_endpoint() as endpoint:
        endpoint.usage = {"prompt_tokens": claimed, "completion_tokens": 3}
        reply = ChatClient("fake", endpoint.url).complete([{"role": "user", "content": "Go."}], [TOOL])
    assert (reply.usage.prompt_tokens, reply.usage.completion_tokens) == (counted, 3)
