"""Bugs of options and of the environment that runs them."""

from tests.mutations.mutation import Mutation

ENV = "options/options_env.py"
TESTS = "options/test_options_env.py"

MUTATIONS = [
    Mutation(
        "a batch follows a plan on after a slip",
        "options/batched/env.py",
        "kept = 1 if self._room.layout.is_random else PLAN_LENGTH",
        "kept = PLAN_LENGTH",
        "options/batched/test_batched_env.py::test_a_plan_is_not_followed_on_after_a_slip",
    ),
    Mutation(
        "an option counts as consistent where it cannot start",
        ENV,
        "if option.is_markov and option.initiation(step.state) and self._agrees(option, step):",
        "if option.is_markov and self._agrees(option, step):",
        "options/test_options_env.py::test_trap_15_an_option_is_consistent_only_where_it_may_start",
    ),
    Mutation(
        "a consistent option's termination is asked at the state left",
        ENV,
        "found.append((index, option.termination(step.next_state)))",
        "found.append((index, option.termination(step.state)))",
        TESTS,
    ),
    Mutation(
        "an option runs one primitive past its longest duration",
        ENV,
        "len(run.rewards) >= self.max_duration",
        "len(run.rewards) > self.max_duration",
        TESTS,
    ),
    Mutation(
        "an interrupted option begins anew",
        ENV,
        'ended, self._run = "interrupted", run',
        'ended = "interrupted"',
        TESTS,
    ),
    Mutation(
        "another option goes on with the one that was interrupted",
        ENV,
        "run = self._run if self._run is not None and self._run.index == index else None",
        "run = self._run",
        TESTS,
    ),
    Mutation(
        "a running option can be masked",
        ENV,
        "if index != running and not option.initiation(state):",
        "if not option.initiation(state):",
        "options/test_options_env.py::test_an_option_that_runs_may_go_on_where_it_could_not_start",
    ),
    Mutation(
        "an option's own target is told as pressed on the way",
        "options/domain.py",
        "for i in pressed if i not in own)",
        "for i in pressed)",
        "options/test_options_env.py::test_info_tells_what_ran_and_how_it_ended",
    ),
    Mutation(
        "options stay those of the first room",
        ENV,
        "self._subject, self.options = subject, made",
        "self._subject = subject",
        "options/test_options_env.py::test_numbers_and_names_stay_when_rooms_are_resampled",
    ),
    Mutation(
        "planning of a nested option that has ended is lost",
        "options/execution.py",
        "self._finished.add(self._stack[-1].option.report)\n            self._close(state, \"reached\")",
        "self._close(state, \"reached\")",
        "options/test_options_env.py::test_planning_of_a_nested_option_is_told_by_the_option_that_called_it",
    ),
    Mutation(
        "a nested option's end ends its caller",
        "options/execution.py",
        "if len(self._stack) == 1:",
        "if len(self._stack) >= 1:",
        "options/test_options_env.py::test_nested_options_run_to_their_end_before_the_outer_policy_is_asked_again",
    ),
    Mutation(
        "an early stop is drawn once an episode",
        "options/degraded.py",
        "if self._draw(STOP, state) <",
        "if self.degradation.draw(self.name, STOP, state.noise_key, 0) <",
        "options/test_degraded.py",
    ),
    Mutation(
        "a detour does not come back",
        "options/degraded.py",
        "return to if self._wasted % 2 else fro",
        "return to",
        "options/test_degraded.py",
    ),
    Mutation(
        "latency is not counted as planning",
        "options/degraded.py",
        "self.report.planner_seconds += self.degradation.latency",
        "pass",
        "options/test_degraded.py",
    ),
    Mutation(
        "the cache's hit rate is that of the last decision",
        "options/options_env.py",
        "self._hits += decision.report.cache_hits",
        "self._hits = decision.report.cache_hits",
        "options/test_options_env.py::test_the_caches_hit_rate_is_over_all_calls_of_the_environment",
    ),
    Mutation(
        "planning of a nested option that still runs is not told",
        "options/execution.py",
        "for frame in self._stack:",
        "for frame in self._stack[:1]:",
        "options/test_options_env.py::test_planning_of_a_nested_option_is_told_while_it_still_runs",
    ),
    Mutation(
        "an end that the caller adds takes the place of the policy's own",
        "options/learned.py",
        "1.0 - (1.0 - own) * (1.0 - float(self._until(state)))",
        "float(self._until(state))",
        "options/test_from_agents.py::test_until_adds_to_an_end_of_ones_own",
    ),
    Mutation(
        "a call below ends at every primitive where the task runs as an option",
        "agents/hierarchy/runner.py",
        'if runner.settings.polled == "never" and len(before) > 2:',
        "if False:",
        "options/test_from_agents.py::test_a_call_inside_an_option_runs_to_its_own_end",
    ),
    Mutation(
        "turns into the goal of a press by hand are not backed up",
        "options/batched/value_iteration.py",
        "best[n] = _GOAL if old[n] == _GOAL else best[n]",
        "best[n] = best[n]",
        "options/batched/test_hand_presses.py::"
        "test_fields_of_postures_are_zero_in_touch_and_else_one_more_than_the_best_that_a_primitive_leads_to",
    ),
    Mutation(
        "fields of presses by hand take the hand to be on the other side",
        "options/batched/field_grid.py",
        "cos * hand[0] - sin * hand[1]",
        "cos * hand[0] + sin * hand[1]",
        "options/batched/test_hand_presses.py::"
        "test_fields_of_postures_are_zero_in_touch_and_else_one_more_than_the_best_that_a_primitive_leads_to",
    ),
    Mutation(
        "a target out of the hand's reach is a long way off",
        "options/batched/postures.py",
        "FAR = 20_000",
        "FAR = 1_000",
        "options/batched/test_hand_presses.py::test_a_target_that_no_hand_reaches_costs_one_primitive",
    ),
    Mutation(
        "a hand that holds its target down presses it again by other postures",
        "options/batched/hand_policy.py",
        "torch.where(is_held, UNREACHABLE, least)",
        "least",
        "options/batched/test_hand_presses.py::test_a_press_that_is_held_is_let_go_and_made_again",
    ),
    Mutation(
        "joints step away from the posture that presses",
        "options/batched/hand_policy.py",
        "[wanted > 0, wanted < 0]",
        "[wanted < 0, wanted > 0]",
        "options/batched/test_hand_presses.py::test_rooms_pressed_by_hand_go_on_without_the_planner",
    ),
    Mutation(
        "places that a room lacks have no options to grip there",
        "options/meta_actions.py",
        "return goals + [dataclasses.replace(grip, target=i) for i in range(own, every) for grip in grips.values()]",
        "return goals",
        "ladder/test_instance_set.py",
    ),
]
