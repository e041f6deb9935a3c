"""The agents to begin with: one answer to "which agent?", which the command line, the site and the README quote.

Each label trains under this name in every command and in Python. The numbers are from `docs/results`: *one room*
and the search baseline from `all-algorithms.md`, *unseen rooms* from the lines of `studies/across`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Recommendation:
    """An agent to begin with."""

    use: str  # what it is for
    label: str  # label, as every command takes it
    title: str  # display name
    reason: str  # what was measured, in Markdown-free sentences


RECOMMENDED = (
    Recommendation(
        "one room", "smdp-r-max", "R-MAX over options",
        "Efficiency 0.91 to 1.00 after 20,000 primitives in the room where it is tested, in seven kinds of rooms with "
        "two to ten buttons. The search baseline, which forgets earlier episodes, has 0.35 to 0.84. Four agents that "
        "learn structure show no significant difference. The best agent with a network is smdp-rainbow.",
    ),
    Recommendation(
        "unseen rooms", "smdp-press-model+objects", "press model over options",
        "Efficiency 0.74 to 0.99 in unseen rooms where cues reveal the order, after 64 training rooms and 9,600 "
        "primitives, over ten seasons. It supports buttons that stay on. For other puzzles take "
        "smdp-ppo+objects+memory.",
    ),
    Recommendation(
        "to compare with in one room", "search-memory", "search baseline with memory",
        "It remembers earlier episodes in the room, as learners do. With four to twenty buttons it escapes sooner "
        "than a learner of structure over planned options.",
    ),
    Recommendation(
        "to compare with in unseen rooms", "search-backtrack", "search baseline",
        "The most efficient of three search baselines, or level with it, in each of the seven kinds of rooms. It "
        "forgets earlier episodes.",
    ),
)
"""Agents for one room and for unseen rooms, and the search baselines to compare them with."""


def format_answer() -> str:
    """The answer as one line of Markdown, which the README and the pages on agents quote."""
    room, unseen, remembering, forgetting = (f"`{choice.label}`" for choice in RECOMMENDED)
    return (f"In one room start with {room}, and compare it with the search baseline {remembering}. For unseen rooms "
            f"start with {unseen}, and compare it with {forgetting}.")
