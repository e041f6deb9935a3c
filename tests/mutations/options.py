"""Bugs of options and of the environments that run them."""

from tests.mutations.mutation import Mutation

MUTATIONS = [
    Mutation("a reward wrapper above options changes what primitives are worth, and not options",
             "step_info.py::read_payment",
             "if not any(is_same(", "if False and not any(is_same(",
             "options/test_reward_wrappers.py"),
    Mutation("an option holds the state of its run", "options/option.py::Option.make_run",
             "run = copy.copy(self)", "run = self",
             "options/test_shared_options.py::test_an_option_runs_in_each_environment_as_if_it_were_alone"),
    Mutation("summed reward with gamma^k", "step_info.py::Payment.compute_discounted",
             "total = reward + gamma * total", "total = reward + total",
             "agents/algorithms/test_tabular.py::"
             "test_trap_1_an_option_learned_from_its_primitive_rewards_is_worth_their_discounted_sum"),
    Mutation("the wrapper sums without discount", "options/options_env.py::OptionsEnv._inform",
             "discounted = reward + self.gamma * discounted", "discounted = reward + discounted",
             "options/test_options_env.py::test_trap_1_a_k_step_option_is_worth_the_discounted_sum_of_its_rewards"),
    Mutation("the wrapper's discount is that of one primitive", "options/options_env.py::OptionsEnv._inform",
             '"discount": np.float64(self.gamma ** len(decision.rewards))', '"discount": np.float64(self.gamma)',
             "options/test_options_env.py::test_trap_2_cutting_an_option_into_halves_does_not_change_the_value"),
    Mutation("the cap inside an option is taken for an end", "options/options_env.py::OptionsEnv._decide",
             "reward, decision.terminated, decision.truncated, info", "reward, decision.is_over, False, info",
             "options/test_options_env.py::"
             "test_trap_3_the_cap_inside_an_option_truncates_and_the_state_reached_is_returned"),
    Mutation("an option runs on after the exit", "options/options_env.py::OptionsEnv._run_option",
             "elif decision.is_over:", "elif decision.truncated:",
             "options/test_options_env.py::test_trap_4_an_exit_inside_an_option_keeps_the_bonus_and_ends_it"),
    Mutation("nothing is legal", "options/options_env.py::OptionsEnv._compute_mask",
             "return mask if mask.any() else np.ones_like(mask)", "return mask",
             "options/test_options_env.py::test_trap_10_there_is_always_a_legal_action"),
    Mutation("termination is asked at the state left", "options/options_env.py::OptionsEnv._run_option",
             "                run.rewards += decision.do(run.choose(decision.state, self._domain))\n"
             "                if run.ends_at(decision.state",
             "                left = decision.state\n"
             "                run.rewards += decision.do(run.choose(left, self._domain))\n"
             "                if run.ends_at(left",
             "options/test_options_env.py::test_trap_12_termination_is_asked_at_the_state_reached"),
    Mutation("the new episode stands where the state reached belongs", "options/options_env.py::OptionsEnv._decide",
             "mask = self._compute_mask(decision.state, self._lower_mask)\n"
             "        info",
             "mask = self._compute_mask(decision.state, self._lower_mask)\n"
             "        if decision.is_over:\n"
             "            decision.observation = self.env.reset()[0]\n"
             "        info",
             "options/test_options_env.py::test_trap_13_autoreset_does_not_replace_the_state_reached"),
    Mutation("a failed plan is free", "options/options_env.py::OptionsEnv._run_option",
             "            if not decision.rewards:\n"
             "                run.rewards",
             "            if False:\n"
             "                run.rewards",
             "options/test_options_env.py::test_trap_14_a_failed_plan_costs_one_primitive"),
    Mutation("any option counts as consistent", "options/options_env.py::OptionsEnv._find_consistent",
             "if option.is_markov and option.initiation(step.state)", "if option.initiation(step.state)",
             "options/test_options_env.py::"
             "test_trap_15_only_options_whose_policy_is_a_function_of_the_state_are_consistent"),
    Mutation("a decision of a level below counts as one primitive", "options/execution.py::read_rewards",
             "return paid.rewards", "return (float(reward),)",
             "options/test_levels.py::test_durations_discounts_and_rewards_count_the_primitives_of_the_lowest_level"),
    Mutation("what the environment itself masks is legal over options",
             "options/options_env.py::OptionsEnv._compute_mask",
             "mask[: self.primitive_count] = lower[: self.primitive_count]", "pass",
             "options/test_plain_envs.py::test_a_masked_option_costs_the_first_legal_primitive"),
    Mutation("a room's memory outlives its episode in a batch", "options/memory.py::_Memories.begin",
             "        self._used = where(which, 0, self._used)\n", "",
             "options/test_vector_decision_memory.py::test_every_room_remembers_its_own_decisions"),
    Mutation("a batch takes a grip that slipped for one that was done", "options/batched/stepping.py::step_decisions",
             "(primitive == act) & has_acted(layout, fields.aims, goal, state, after)", "primitive == act",
             "options/batched/test_grips.py::test_a_slip_while_gripping_is_gripped_again"),
    Mutation("a batch follows a plan on after a slip", "options/batched/env.py::HostPlanner.plan",
             "kept = 1 if self._room.layout.dynamics.is_random else PLAN_LENGTH", "kept = PLAN_LENGTH",
             "options/batched/test_batched_env.py::test_a_plan_is_not_followed_on_after_a_slip"),
    Mutation("an option runs one primitive past its longest duration", "options/options_env.py::OptionsEnv._run_option",
             "len(run.rewards) >= self.max_duration", "len(run.rewards) > self.max_duration",
             "options/test_options_env.py"),
    Mutation("an interrupted option begins anew", "options/options_env.py::OptionsEnv._run_option",
             'ended, self._run = "interrupted", run', 'ended = "interrupted"',
             "options/test_options_env.py"),
    Mutation("options stay those of the first room", "options/options_env.py::OptionsEnv._enter",
             "self._subject, self.options = subject, made", "self._subject = subject",
             "options/test_options_env.py::test_numbers_and_names_stay_when_rooms_are_resampled"),
    Mutation("a nested option's end ends its caller", "options/execution.py::OptionExecution.ends_at",
             "if len(self._stack) == 1:", "if len(self._stack) >= 1:",
             "options/test_options_env.py::"
             "test_nested_options_run_to_their_end_before_the_outer_policy_is_asked_again"),
    Mutation("fields of presses by hand take the hand to be on the other side",
             "options/batched/cost_to_go.py::FieldGrid._find_touching",
             "cos * hand[0] - sin * hand[1]", "cos * hand[0] + sin * hand[1]",
             "options/batched/test_hand_presses.py::"
             "test_fields_of_postures_are_zero_in_touch_and_else_one_more_than_the_best_that_a_primitive_leads_to"),
    Mutation("a limit of decisions leaves an episode running", "options/batched/vector_env.py::OptionsVectorEnv._cut",
             "cut = (self._decisions >= self._most_steps) & ~idle",
             "cut = (self._decisions > self._most_steps) & ~idle",
             "env/test_gymnasium_manners.py::test_a_limit_of_steps_means_the_same_for_many_rooms_as_for_one"),
]
