"""`check_hierarchy` passes the hierarchies there are, and finds each promise that can be broken."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.algorithms.task_hierarchies.deep_abstract_q import DeepAbstractQ
from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import FeudalRl, Quadtree
from hrl_escape.agents.algorithms.task_hierarchies.h_dqn import HDqn
from hrl_escape.agents.algorithms.task_hierarchies.hac_finite import HacFinite
from hrl_escape.agents.algorithms.task_hierarchies.hiro_finite import HiroFinite
from hrl_escape.agents.algorithms.task_hierarchies.hrac_finite import HracFinite
from hrl_escape.agents.algorithms.task_hierarchies.macro_q import MacroQ
from hrl_escape.agents.algorithms.task_hierarchies.option_keyboard import OptionKeyboard
from hrl_escape.agents.algorithms.task_hierarchies.sol import Sol
from hrl_escape.agents.hierarchy.runner import CallRunner, StackAgent, make_task_transition
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Hierarchy
from hrl_escape.agents.hierarchy.task_graph import GraphTask, flat, maxq
from hrl_escape.agents.registry import get_agent_class, list_hierarchy_agents
from hrl_escape.checks import check_hierarchy
from hrl_escape.errors import ContractError
from tests.agents.algorithms.task_hierarchies.test_feudal_rl import find_place
from tests.agents.algorithms.task_hierarchies.test_h_uct import TwoDoors, make_chain_tasks, make_door_tasks
from tests.agents.hierarchy.four_rooms_tasks import HOME, make_walks
from tests.agents.hierarchy.taxi_tasks import GRAPH, SEE, UNTIL, make_taxi_tasks
from tests.agents.hierarchy.wall_macros import make_wall_macros
from tests.agents.small_envs import ButtonGrid
from tests.classic.barrier_maze import BarrierMaze
from tests.classic.chain import Chain
from tests.classic.empty_room import EDGE, EmptyRoom
from tests.classic.four_rooms import FourRooms
from tests.classic.taxi import Taxi, decode

PSEUDO = {"get": lambda seen: 3.0, "navigate 0": lambda seen: 1.0}


@pytest.mark.nightly_for("always", "never")
@pytest.mark.parametrize("polled", ["never", "always"])
def test_a_graph_with_pseudo_rewards_keeps_every_promise(polled):
    class Polled(StackAgent):
        def __init__(self, hierarchy, space, seed, settings):
            super().__init__(hierarchy, space, seed, type(settings)(gamma=settings.gamma, polled=polled))

    check_hierarchy(make_taxi_tasks(pseudo=PSEUDO), Taxi(), agent_class=Polled)


def _run(agent_class, env, *given, **settings):
    """The hierarchy that an agent makes of what it is given."""
    agent = agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**settings), *given)
    return agent.hierarchy, env


GRAPHS = {
    "taxi": lambda: (make_taxi_tasks(), Taxi(noisy=True, fickle=True)),
    "taxi, no abstraction": lambda: (make_taxi_tasks(abstract=False, pseudo=PSEUDO), Taxi()),
    "four rooms": lambda: (make_walks(), FourRooms(HOME)),
    "the chain of h-uct": lambda: (make_chain_tasks(), Chain()),
    "the doors of h-uct": lambda: (make_door_tasks(lambda seen: 10.0 * (seen.observation == 2)), TwoDoors()),
    "options as primitives": lambda: (flat(7), ButtonGrid()),
}
"""For `maxq-q`, `r-maxq` and `h-uct`, which run any graph. Those made of rooms are in tests/hierarchies."""

OWN = {
    "macro-q": lambda: _run(MacroQ, EmptyRoom(EDGE), make_wall_macros()),
    "h-dqn": lambda: _run(HDqn, FourRooms(None), values="table", patience=5),
    "hac-finite": lambda: _run(HacFinite, FourRooms(None)),
    "deep-abstract-q": lambda: _run(DeepAbstractQ, FourRooms(None), worker="table"),
    "option-keyboard": lambda: _run(OptionKeyboard, EmptyRoom(EDGE), patience=5),
    "sol": lambda: _run(Sol, FourRooms(None), hidden=(8,), longest=4),
    "hiro-finite": lambda: _run(HiroFinite, FourRooms(None), window=5),
    "hrac-finite": lambda: _run(HracFinite, FourRooms(None), window=5),
    "feudal-rl": lambda: _run(FeudalRl, BarrierMaze(), Quadtree(2, find_place), patience=3),
}
"""Agents that make their hierarchy themselves."""


@pytest.mark.nightly_for(
    "h-dqn", "hac-finite", "option-keyboard", "sol", "taxi", "feudal-rl", "hrac-finite", "macro-q",
    "taxi, no abstraction")
@pytest.mark.parametrize("name", [*GRAPHS, *OWN])
def test_every_hierarchy_keeps_every_promise(name):
    check_hierarchy(*(GRAPHS | OWN)[name](), primitives=150)


def test_no_agent_that_runs_calls_is_left_out():
    runners = {name for name in list_hierarchy_agents() if issubclass(get_agent_class(name), CallRunner)}
    assert runners == {"maxq-q", "r-maxq", "h-uct", *OWN}


class Told(StackAgent):
    """Tells its learners something else than what happened."""

    def twist(self, transition, returned):
        return transition

    def learn(self, step, returns):
        for returned in returns:
            if (learner := self.learners.get(returned.frame.task.name)) is not None:
                learner.observe(self.twist(make_task_transition(returned), returned))
        return {}


class LastsLonger(Told):
    def twist(self, transition, returned):
        return transition._replace(duration=transition.duration + 1)


class DiscountsOncePerDecision(Told):
    def twist(self, transition, returned):
        return transition._replace(discount=self.gamma)


class PaysFinalToTheCut(Told):
    def twist(self, transition, returned):
        if returned.is_over and not returned.ended:
            final = returned.frame.task.final(returned.frame, returned.seen)
            return transition._replace(reward=transition.reward + transition.discount * final)
        return transition


class LeaksFinalToTheCaller(Told):
    def twist(self, transition, returned):
        self.leak, leaked = (1.0 if returned.ended else 0.0), getattr(self, "leak", 0.0)
        return transition._replace(reward=transition.reward + leaked)


class TakesCutsForEnds(Told):
    def twist(self, transition, returned):
        over = transition.truncated
        return transition._replace(terminated=transition.terminated or over, truncated=False)


class SaysNothingOfCuts(Told):
    def twist(self, transition, returned):
        return transition._replace(truncated=False)


class GoesOnAfterTheEnd(Told):
    def twist(self, transition, returned):
        return transition._replace(terminated=returned.ended)


class UnwindsFromOutside(StackAgent):
    def learn(self, step, returns):
        return super().learn(step, returns[::-1])


class LearnsWhileEvaluated(StackAgent):
    def act_greedy(self, observation, action_mask, rng):
        self._rng.random()
        return super().act_greedy(observation, action_mask, rng)


class EvaluatesInItsOwnCalls(StackAgent):
    def act_greedy(self, observation, action_mask, rng):
        action = super().act_greedy(observation, action_mask, rng)
        self._stack = self._evaluation[1]
        return action


class HearsOfTheIllegal(Told):
    def twist(self, transition, returned):
        return transition._replace(action_mask=np.zeros_like(transition.action_mask))


class GoesByNumber(StackAgent):
    def choose(self, stack, view, legal, seen):
        super().choose(stack, view, legal, seen)
        return int(legal.argmax())


class GoesByDepth(StackAgent):
    def choose(self, stack, view, legal, seen):
        if len(stack) == 3:
            self.learners[stack[-1].task.name]._rng.random()
        return super().choose(stack, view, legal, seen)


@pytest.mark.nightly_for(
    "LastsLonger-lasts as long as its primitives", r"DiscountsOncePerDecision-gamma\\^k",
    "PaysFinalToTheCut-`final` is asked only|`final` where it ended",
    "LeaksFinalToTheCaller-discounted sum of its task's pay", "TakesCutsForEnds-does not receive termination",
    "SaysNothingOfCuts-receives truncation", "UnwindsFromOutside-innermost",
    "HearsOfTheIllegal-legal choices only", "GoesByNumber-renumbering", "GoesByDepth-chain")
@pytest.mark.parametrize(
    ("agent_class", "claim"),
    [
        (LastsLonger, "lasts as long as its primitives"),
        (DiscountsOncePerDecision, "gamma\\^k"),
        (PaysFinalToTheCut, "`final` is asked only|`final` where it ended"),
        (LeaksFinalToTheCaller, "discounted sum of its task's pay"),
        (TakesCutsForEnds, "does not receive termination"),
        (SaysNothingOfCuts, "receives truncation"),
        (UnwindsFromOutside, "innermost"),
        (LearnsWhileEvaluated, "evaluation changes nothing"),
        (EvaluatesInItsOwnCalls, "evaluation changes nothing"),
        (HearsOfTheIllegal, "legal choices only"),
        (GoesByNumber, "renumbering"),
        (GoesByDepth, "chain"),
    ],
)
def test_an_agent_that_breaks_a_promise_is_found(agent_class, claim):
    with pytest.raises(ContractError, match=claim):
        check_hierarchy(make_taxi_tasks(pseudo=PSEUDO), Taxi(), agent_class=agent_class)


@pytest.mark.nightly
def test_an_agent_that_goes_on_after_the_end_is_found():
    with pytest.raises(ContractError, match="terminates every call"):
        check_hierarchy(flat(2), Chain(), agent_class=GoesOnAfterTheEnd)


class CallsWhatIsOver(GraphTask):
    def legal(self, seen, context):
        return np.ones(len(self.children), np.bool_)


class PaidByItself(GraphTask):
    def pay(self, step, frame):
        return 0.0


@pytest.mark.nightly_for("PaidByItself-the root's return is the environment's")
@pytest.mark.parametrize(
    ("task_class", "claim"), [(CallsWhatIsOver, "over"), (PaidByItself, "the root's return is the environment's")]
)
def test_a_task_that_breaks_a_promise_is_found(task_class, claim):
    hierarchy = make_taxi_tasks()
    hierarchy.root.__class__ = task_class
    with pytest.raises(ContractError, match=claim):
        check_hierarchy(hierarchy, Taxi())


class Nested(BaseTask):
    """Calls the task below, with a command."""

    def __init__(self, below):
        super().__init__("outer", 2)
        self.below = below

    def legal(self, seen, context):
        return np.ones(2, np.bool_)

    def decode(self, choice, seen, context):
        return Call(self.below, choice)


class Commanded(BaseTask):
    """Ends with a probability that its command says."""

    def ends(self, frame, seen):
        return (0.1, 0.5)[frame.context] if frame.primitives else 0.0


@pytest.mark.nightly
def test_calls_with_contexts_that_end_by_chance_keep_every_promise():
    below = Commanded("inner", 6)
    check_hierarchy(Hierarchy(Nested(below), (below,)), Taxi())


def test_a_task_that_calls_itself_for_ever_is_refused():
    below = Nested(None)
    below.below = below
    with pytest.raises(ContractError, match="calls for ever"):
        check_hierarchy(Hierarchy(below), Taxi())


@pytest.mark.nightly
def test_a_chain_of_one_child_tasks_is_the_flat_agent_to_the_bit():
    from tests.agents.running import interact

    learner = partial(QLearning, settings=QLearning.Settings(gamma=0.95))
    env = Taxi(horizon=60)
    chain = maxq({"a": ["b"], "b": ["c"], "c": range(6)}, {"b": _never, "c": _never}, learners={"c": learner})
    agent = StackAgent(chain, env.observation_space, 0, StackAgent.Settings(gamma=0.95))
    seed = int(np.random.SeedSequence([0, *b"c"]).generate_state(1)[0])
    flat_agent = QLearning(env.observation_space, env.action_space, seed, QLearning.Settings(gamma=0.95))
    ours = [each.action for each in interact(agent, Taxi(horizon=60), 3_000)]
    assert ours == [each.action for each in interact(flat_agent, env, 3_000)]
    ours, theirs = agent.learners["c"].table.state_dict(), flat_agent.table.state_dict()
    assert all((ours[name] == theirs[name]).all() for name in ours)


def _never(seen):
    return False


def test_tasks_and_children_must_have_names_that_exist():
    from hrl_escape.errors import AgentSettingsError, UnknownNameError

    with pytest.raises(UnknownNameError, match="did you mean 'put'"):
        maxq({**GRAPH, "root": ["get", "putt"]}, UNTIL, SEE)
    with pytest.raises(AgentSettingsError, match="a graph without cycles"):
        maxq({"a": ["b"], "b": ["a", 0]}, {"b": _never})
    with pytest.raises(AgentSettingsError, match="every task below the root"):
        maxq({"a": ["b"], "b": [0]}, {})
    assert make_taxi_tasks().privileges == ("task graph", "state")
    assert decode(0).row == 0
