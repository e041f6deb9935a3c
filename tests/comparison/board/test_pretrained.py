"""Pretrained agents: each plays its rooms again to the published results, from plain arrays of a few kB."""

from __future__ import annotations

from pathlib import Path

import pytest

from hrl_escape.comparison.board.board import read_records
from hrl_escape.comparison.board.pretrained import list_pretrained, load_pretrained
from hrl_escape.errors import UnknownNameError
from hrl_escape.ladder.benchmark import load_benchmark

BOARD = Path(__file__).parents[3] / "docs/board"
AGENTS = [(rung, agent) for rung, agents in list_pretrained().items() for agent in agents]


@pytest.mark.parametrize(("rung", "agent"), AGENTS)
def test_a_pretrained_agent_plays_its_rooms_to_the_published_results(rung, agent):
    found = load_pretrained(rung, agent)
    assert all(each.is_equal for each in found.verify(min(3, len(found.submission.cells)), seed=0))
    assert found.result.evaluations[-1].primitives == found.result.primitives == found.card.primitives
    assert found.score.low <= found.score.value <= found.score.high and agent in found.card.training
    env = found.make_env()
    observation, info = env.reset(seed=0)
    assert env.action_space.contains(found.agent.act_greedy(observation, info["action_mask"].astype(bool), None))
    env.close()


def test_there_are_pretrained_agents_they_are_small_and_stand_on_the_board():
    assert "ladder-1/chain-3" in list_pretrained()
    digests = {record.submission.agent_digest for record in read_records(BOARD)}
    sizes = 0
    for rung, agent in AGENTS:
        found = load_pretrained(rung, agent)
        sizes += found.path.stat().st_size
        benchmark, _, name = rung.partition("/")
        whole = load_benchmark(benchmark)[name].record.test.count == found.submission.entry.rooms
        assert (found.submission.agent_digest in digests) == whole
    assert sizes < 1.5e6
    with pytest.raises(UnknownNameError, match="ladder-1/chain-3"):
        load_pretrained("ladder-1/chain-2")
    with pytest.raises(UnknownNameError, match="smdp-q-learning"):
        load_pretrained("ladder-1/chain-3", "smdp-dqn")
