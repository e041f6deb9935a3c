"""Offline agents with tables against values computed exactly, on random SMDPs and in rooms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import csgraph_from_dense, dijkstra

from hrl_escape.agents.algorithms.offline.behaviour_cloning import BehaviourCloning
from hrl_escape.agents.algorithms.offline.cql import CQL
from hrl_escape.agents.algorithms.offline.fitted_q import FittedQ
from hrl_escape.agents.algorithms.offline.iql import IQL, compute_expectile
from hrl_escape.agents.algorithms.offline.sharsa import Sharsa
from hrl_escape.agents.components.offline import list_best
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.best_with_options import find_best_with_options
from hrl_escape.planning.best_known import compute_escape_return, list_start_states
from hrl_escape.sets.benchmark import load_benchmark
from tests.agents.algorithms.offline.coverage import cover_room, make_decisions
from tests.agents.small_envs import make_random_smdp, solve

GAMMA = 0.9
TRAPS, TRAP_GAMMA = (14, 33), 0.6
"""Instance seeds of `make_trap`'s rooms in which the order of presses matters so, and the discount."""


def draw_rows(smdp, count, seed, splits=()):
    """Decisions at random states; those of `splits` are cut into one primitive and the rest, by a state of its own."""
    rng = np.random.default_rng(seed)
    rows, between = [], {}
    for _ in range(count):
        state = int(rng.integers(len(smdp)))
        action = int(rng.choice([a for a, outcomes in enumerate(smdp[state]) if outcomes]))
        outcomes = smdp[state][action]
        chosen = outcomes[rng.choice(len(outcomes), p=[each.probability for each in outcomes])]
        whole = {"state": state, "action": action, "rewards": chosen.rewards, "next": chosen.next_state,
                 "over": chosen.terminated}
        if (state, action) in splits and len(chosen.rewards) > 1:
            middle = between.setdefault((state, action, chosen), len(smdp) + len(between))
            rows.append({**whole, "rewards": chosen.rewards[:1], "next": middle, "over": False})
            rows.append({**whole, "state": middle, "rewards": chosen.rewards[1:]})
        else:
            rows.append(whole)
    return rows


def fit(kind, rows, smdp, sweeps=3_000, **settings):
    states = 1 + max(max(row["state"], row["next"]) for row in rows)
    agent = kind(spaces.Discrete(states), spaces.Discrete(len(smdp[0])), 0,
                 kind.Settings(values="table", gamma=GAMMA, **settings))
    agent.begin(make_decisions(rows, GAMMA, len(smdp[0])))
    for _ in range(sweeps):
        agent.update()
        if agent.is_fitted:
            break
    return agent


def build_model(rows, states, actions):
    """Counts, mean rewards and discounted transitions of the rows, by plain loops."""
    counts, reward = np.zeros((states, actions)), np.zeros((states, actions))
    follow = np.zeros((states, actions, states))
    for row in rows:
        place = row["state"], row["action"]
        counts[place] += 1
        reward[place] += sum(GAMMA**i * r for i, r in enumerate(row["rewards"]))
        if not row["over"]:
            follow[(*place, row["next"])] += GAMMA ** len(row["rewards"])
    share = np.maximum(counts, 1)
    return counts, reward / share, follow / share[..., None]


@pytest.mark.parametrize("seed", range(4))
def test_q_iteration_on_all_outcomes_of_a_deterministic_smdp_is_optimal(seed):
    smdp = make_random_smdp(seed, states=5, branches=1)
    rows = [{"state": s, "action": a, "rewards": each.rewards, "next": each.next_state, "over": each.terminated}
            for s, row in enumerate(smdp) for a, outcomes in enumerate(row) for each in outcomes]
    agent, exact = fit(FittedQ, rows, smdp), solve(smdp, GAMMA)
    for state in range(len(smdp)):
        legal = np.isfinite(exact[state])
        np.testing.assert_allclose(agent.compute_values(state)[legal], exact[state][legal], atol=1e-9)


@pytest.mark.nightly_for("2", "0")
@pytest.mark.parametrize("seed", range(3))
def test_iql_is_sarsa_at_one_half_and_the_best_of_the_data_towards_one(seed):
    smdp = make_random_smdp(seed, states=5)
    rows = draw_rows(smdp, 400, seed)
    counts, reward, follow = build_model(rows, len(smdp), len(smdp[0]))
    behaviour = counts / counts.sum(axis=1, keepdims=True)
    values = np.linalg.solve(np.eye(len(smdp)) - np.einsum("sa,sat->st", behaviour, follow),
                             (behaviour * reward).sum(axis=1))
    sarsa = reward + follow @ values
    best = np.zeros(len(smdp))
    for _ in range(2_000):
        best = np.where(counts > 0, reward + follow @ best, -np.inf).max(axis=1)
    shown = counts > 0
    at_half = fit(IQL, rows, smdp, expectile=0.5)
    np.testing.assert_allclose(at_half.q[shown], sarsa[shown], atol=1e-8)
    near_one = fit(IQL, rows, smdp, expectile=1 - 1e-9)
    np.testing.assert_allclose(near_one.q[shown], (reward + follow @ best)[shown], atol=1e-4)
    between = fit(IQL, rows, smdp, expectile=0.8)
    assert (at_half.q[shown] <= between.q[shown] + 1e-9).all() and (between.q[shown] <= near_one.q[shown] + 1e-9).all()
    sharsa = fit(Sharsa, rows, smdp)
    np.testing.assert_allclose(sharsa.q[shown], sarsa[shown], atol=1e-8)
    np.testing.assert_allclose(fit(FittedQ, rows, smdp).q[shown], (reward + follow @ best)[shown], atol=1e-8)


@pytest.mark.nightly_for("0", "1")
@pytest.mark.parametrize("seed", range(3))
def test_cql_is_the_fixed_point_of_its_equation_and_lies_below_the_best_of_the_data(seed):
    smdp = make_random_smdp(seed, states=5)
    rows = draw_rows(smdp, 400, seed)
    counts, reward, follow = build_model(rows, len(smdp), len(smdp[0]))
    shown = counts > 0
    agent, best = fit(CQL, rows, smdp, alpha=0.5), fit(FittedQ, rows, smdp)
    q = np.where(shown, agent.q, -np.inf)
    policy = np.exp(q - q.max(axis=1, keepdims=True))
    policy /= policy.sum(axis=1, keepdims=True)
    penalty = 0.5 * (policy / np.where(shown, counts / counts.sum(axis=1, keepdims=True), 1.0) - 1.0)
    np.testing.assert_allclose(agent.q[shown], (reward + follow @ q.max(axis=1) - penalty)[shown], atol=1e-7)
    q_best = np.where(shown, best.q, -np.inf).max(axis=1)
    several = shown.sum(axis=1) > 1
    assert (q.max(axis=1)[several] < q_best[several]).all()
    np.testing.assert_allclose(fit(CQL, rows, smdp, alpha=0.0).q[shown], best.q[shown], atol=1e-8)


def test_a_clone_counts_and_sharsa_proposes_as_often_as_the_data_chose():
    smdp = make_random_smdp(1, states=4)
    rows = draw_rows(smdp, 300, 0)
    clone = fit(BehaviourCloning, rows, smdp)
    counts, *_ = build_model(rows, len(smdp), len(smdp[0]))
    for state in range(len(smdp)):
        assert clone.compute_preferences(state).tolist() == counts[state].tolist()
        legal = counts[state] > 0
        assert clone.act_greedy(state, legal, np.random.default_rng(0)) == counts[state].argmax()
    one = fit(Sharsa, rows, smdp, proposals=1)
    rng = np.random.default_rng(0)
    drawn = np.bincount([one.act_greedy(0, counts[0] > 0, rng) for _ in range(4_000)], minlength=len(smdp[0]))
    np.testing.assert_allclose(drawn / 4_000, counts[0] / counts[0].sum(), atol=0.03)


@pytest.mark.nightly_for("IQL-settings1")
@pytest.mark.parametrize(("kind", "settings"), [
    (FittedQ, {}), (IQL, {"expectile": 0.9}), (IQL, {"expectile": 0.5}), (CQL, {"alpha": 0.0})])
def test_the_same_data_cut_at_other_boundaries_gives_the_same_values(kind, settings):
    smdp = make_random_smdp(2, states=5)
    splits = {(s, a) for s in range(5) for a in range(4) if (s + a) % 2}
    whole, cut = draw_rows(smdp, 300, 0), draw_rows(smdp, 300, 0, splits)
    assert len(cut) > len(whole) + 50
    one, other = fit(kind, whole, smdp, **settings), fit(kind, cut, smdp, **settings)
    counts, *_ = build_model(whole, 5, 4)
    for state in range(5):
        shown = counts[state] > 0
        np.testing.assert_allclose(one.compute_values(state)[shown], other.compute_values(state)[shown], atol=1e-7)


@given(st.lists(st.tuples(st.floats(-50, 50), st.integers(0, 5)), min_size=1, max_size=7), st.floats(0.05, 0.95))
def test_expectiles_balance_what_is_above_and_below(pairs, tau):
    values, weights = (np.array([column], float) for column in zip(*pairs, strict=True))
    found = compute_expectile(values, weights, tau)[0]
    if weights.any():
        above, below = (weights * np.maximum(values - found, 0)).sum(), (weights * np.maximum(found - values, 0)).sum()
        assert tau * above == pytest.approx((1 - tau) * below, abs=1e-6)


def test_the_best_share_is_taken_among_trajectories_that_ended():
    rows = [{"state": 0, "action": 0, "rewards": (reward,), "next": 0, "over": over}
            for reward, over in ((5.0, False), (1.0, True), (3.0, True), (2.0, True))]
    data = make_decisions(rows, 1.0, 1)
    assert list_best(data, 0.25).tolist() == [False, False, True, False]
    assert list_best(data, 0.5).tolist() == [False, False, True, True]
    assert list_best(data, 0.75).tolist() == [False, True, True, True], "three of four, not of the three that ended"
    assert list_best(data, 1.0).all()


# --- rooms -----------------------------------------------------------------------------------


def fit_room(covered, **settings):
    agent = FittedQ(spaces.Discrete(covered.states), spaces.Discrete(covered.actions), 0,
                    FittedQ.Settings(values="table", **settings))
    agent.begin(covered.decisions)
    while not agent.is_fitted:
        agent.update()
    return agent


def count_fewest(covered, start):
    """Primitives of the shortest way from a state to the exit over all recorded decisions, by Dijkstra."""
    data, end = covered.decisions, covered.states
    costs = np.full((end + 1, end + 1), np.inf)
    np.minimum.at(costs, (data.observation, np.where(data.terminated, end, data.next_observation)), data.duration)
    return int(dijkstra(csgraph_from_dense(costs, null_value=np.inf), indices=start)[end])


@pytest.mark.nightly_for("chain-3-rooms1")
@pytest.mark.parametrize(("rung", "rooms"), [
    ("pair", slice(2)), ("chain-3", slice(1)), pytest.param("pair", slice(300), marks=pytest.mark.slow),
    pytest.param("chain-3", slice(60), marks=pytest.mark.slow)])
def test_q_iteration_from_full_coverage_is_the_best_of_all_sequences_of_options(rung, rooms):
    """Options that change nothing but the robot's place are among them, which may save a few primitives."""
    saved = []
    for room in load_benchmark("ladder-1")[rung].train[rooms]:
        covered = cover_room(room, 1.0, depth=4 if rung == "pair" else 5)
        agent = fit_room(covered, gamma=1.0)
        for start in range(covered.starts):
            best = compute_escape_return(room, count_fewest(covered, start))
            assert agent.compute_values(start).max() == pytest.approx(best)
            saved.append(best - find_best_with_options(room, list_start_states(room)[start], "press").value)
    assert min(saved) >= 0 and np.mean(saved) < 1, saved


def count_primitives(covered, agent):
    """Primitives of the greedy policy from the first state to the exit."""
    data, state, total = covered.decisions, 0, 0
    rng = np.random.default_rng(0)
    for _ in range(50):
        here = np.flatnonzero(data.observation == state)
        row = here[data.action[here] == agent.act_greedy(state, data.mask[here[0]], rng)][0]
        total, state = total + int(data.duration[row]), int(data.next_observation[row])
        if data.terminated[row]:
            return total
    raise AssertionError("the policy does not escape")


def make_trap(seed):
    """Two buttons in any order, of which the nearer makes the rest longer."""
    config = load_benchmark("ladder-1")["chain-3"].config
    graph = dataclasses.replace(config.puzzle.graph, kind="edges", edges=(), relabel=False)
    puzzle = dataclasses.replace(config.puzzle, count=2, graph=graph)
    return generate(dataclasses.replace(config, puzzle=puzzle), seed)


@pytest.mark.parametrize("seed", TRAPS)
def test_one_gamma_a_decision_takes_the_longer_way_where_the_nearer_button_makes_the_rest_longer(seed):
    covered, whole = (cover_room(make_trap(seed), gamma, depth=4) for gamma in (TRAP_GAMMA, 1.0))
    right, trapped = (fit_room(covered, gamma=TRAP_GAMMA, discounting=kind) for kind in ("primitive", "decision"))
    whole = fit_room(whole, gamma=1.0)
    assert count_primitives(covered, right) == count_primitives(covered, whole) < count_primitives(covered, trapped)
