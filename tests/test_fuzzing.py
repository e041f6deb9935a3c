"""Whatever the public API of planning, options and states is called with, it answers or refuses by a clear error."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, given, settings

from tests.fuzzing import make_calls, run_call


@settings(max_examples=25, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate],
          suppress_health_check=list(HealthCheck))
@given(call=make_calls())
def test_no_call_ends_in_an_error_that_is_not_ours(call):
    run_call(call)
