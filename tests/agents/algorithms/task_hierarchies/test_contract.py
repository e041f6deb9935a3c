"""Every algorithm on a task hierarchy keeps the contract of agents, and has a page; without a hierarchy it is flat."""

import re
from pathlib import Path

import gymnasium
import pytest

from hrl_escape.agents.algorithms import task_hierarchies
from hrl_escape.agents.registry import get_agent_class, list_agents
from hrl_escape.checks import check_agent
from hrl_escape.commands.list import _describe_hierarchical
from tests.covering import thin

NAMES = sorted(
    path.stem.replace("_", "-") for path in Path(task_hierarchies.__path__[0]).glob("*.py") if path.stem != "__init__"
)
SMALL = {"h-dqn": {"hidden": (8,), "batch_size": 8, "worker_warmup": 20}, "h-uct": {"simulations": 5, "depth": 10},
         "sol": {"hidden": (8,), "rollout": 30, "longest": 4}}


@pytest.mark.nightly_for("h-uct", "h-dqn", "hiro-finite", "deep-abstract-q", "hrac-finite", "option-keyboard")
@pytest.mark.parametrize("name", thin(NAMES, 3))
def test_it_keeps_the_contract_of_agents(name):
    agent_class = get_agent_class(name)
    check_agent(agent_class, agent_class.Settings(**SMALL.get(name, {})), decisions=100)


def read_page(name: str) -> str:
    return (Path(__file__).parents[4] / "docs" / "agents" / f"{name}.md").read_text()


@pytest.mark.parametrize("name", NAMES)
def test_it_has_a_page_with_its_equation_and_settings(name):
    page = read_page(name)
    assert "$$" in page and f"{{settings}} {name}" in page


@pytest.mark.parametrize("name", NAMES)
def test_it_is_listed_with_the_privileges_that_its_page_names(name):
    line = _describe_hierarchical(name)
    (row,) = re.findall(r"\| privileged information \|\n\|[-|]+\n\|.*\|(.*)\|", read_page(name))
    for privilege in line.partition("privileged: ")[2].split(", "):
        assert privilege.removesuffix("-actions") in row, (line, row)
    agent_class = get_agent_class(name)
    flat = agent_class(gymnasium.spaces.Discrete(4), gymnasium.spaces.Discrete(2), 0, agent_class.Settings())
    assert flat.privileges == (), "without a hierarchy it is told nothing"


def test_comparisons_by_name_leave_them_out():
    assert not set(NAMES) & set(list_agents())
