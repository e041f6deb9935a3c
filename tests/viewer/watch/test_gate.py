"""The gate: pause, single steps, stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch


@pytest.mark.nightly
def test_the_gate_lets_primitives_and_decisions_through_one_at_a_time(two_buttons):
    gate = Gate(None, paused=True)
    watch = Watch(open_driver("oracle", two_buttons), gate)
    at_gate: list[int] = []
    watch.on_wait = lambda: at_gate.append(watch.primitives)
    thread = threading.Thread(target=watch.run, args=(1,), daemon=True)
    thread.start()

    def settle(arrivals: int) -> int:
        """Primitives so far once the driver has come to the gate so often, and a moment has passed."""
        wait_until(lambda: len(at_gate) >= arrivals)
        time.sleep(0.1)
        assert at_gate[-1] == watch.primitives
        return watch.primitives

    assert settle(1) == 0, "paused, nothing runs"
    for count in (1, 2, 3):
        gate.step(primitives=1)
        assert settle(count + 1) == count
    for decisions in (1, 2):
        gate.step(decisions=1)
        wait_until(lambda decisions=decisions: len(watch.decisions) == decisions)
        passed = sum(each.transition.duration for each in watch.decisions)
        assert settle(passed + 1) == passed and len(watch.decisions) == decisions
    gate.pause(False)
    thread.join(600)
    assert not thread.is_alive() and watch.decisions[-1].name == "go-to-exit"


def test_a_running_driver_can_be_paused_and_goes_on(two_buttons):
    gate = Gate(None)
    watch = Watch(open_driver("random-options", two_buttons), gate)
    thread = threading.Thread(target=watch.run, daemon=True)
    thread.start()
    try:
        for _ in range(2):
            before = watch.primitives
            wait_until(lambda before=before: watch.primitives > before)
            gate.pause()
            stands = watch.primitives
            time.sleep(0.5)
            assert watch.primitives <= stands + 1 and gate.is_paused, "one that was let through before may still end"
            gate.pause(False)
    finally:
        gate.stop()
        thread.join(600)


def wait_until(condition: Callable[[], bool], seconds: float = 600.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.nightly
def test_stopping_frees_a_driver_that_waits(two_buttons):
    gate = Gate(None, paused=True)
    thread = threading.Thread(target=Watch(open_driver("smdp-dqn", two_buttons), gate).run, daemon=True)
    thread.start()
    time.sleep(0.2)
    gate.stop()
    thread.join(600)
    assert not thread.is_alive()
