"""Real time and silence, on a clock that the tests turn themselves."""

import pytest

from sim_bridge.pacing import Pacer, Watchdog

STEP = 1 / 240


def test_ticks_keep_up_with_the_clock():
    pacer = Pacer(STEP)
    total = sum(pacer.due(i * 0.004) for i in range(1001))
    assert total == pytest.approx(4.0 / STEP, abs=1)
    assert pacer.factor() == pytest.approx(1.0, abs=0.02)


def test_a_short_stall_is_caught_up_a_few_ticks_at_a_time():
    pacer = Pacer(STEP, max_ticks=12)
    pacer.due(0.0)
    due = [pacer.due(0.2 + i * 0.004) for i in range(20)]
    assert max(due) == 12
    assert sum(due) == pytest.approx((0.2 + 19 * 0.004) / STEP, abs=1)


def test_a_long_stall_is_given_up_and_shows_in_the_factor():
    pacer = Pacer(STEP, max_ticks=12, max_debt=0.1)
    pacer.due(0.0)
    due = [pacer.due(1.0 + i * 0.004) for i in range(40)]
    assert sum(due) == pytest.approx((0.1 + 39 * 0.004) / STEP, abs=2)
    assert pacer.factor() < 0.5


def test_skipped_time_is_not_caught_up():
    pacer = Pacer(STEP)
    pacer.due(0.0)
    pacer.skip(5.0)
    assert pacer.due(5.0) == 0
    assert pacer.due(5.0 + 3.5 * STEP) == 3


def listen(watchdog, start, end, period=0.004):
    """Ask at every period; returns the first time at which it is silent."""
    now = start
    while now < end:
        if watchdog.silent(now):
            return now
        now += period
    return None


def test_never_heard_is_not_silent():
    assert listen(Watchdog(0.1), 0.0, 2.0) is None


def test_silence_is_noticed_after_the_timeout():
    watchdog = Watchdog(0.1)
    watchdog.heard(1.0)
    assert listen(watchdog, 1.0, 3.0) == pytest.approx(1.1, abs=0.01)


def test_beats_keep_it_awake_and_wake_it_again():
    watchdog = Watchdog(0.1)
    for i in range(10):
        watchdog.heard(i * 0.05)
        assert listen(watchdog, i * 0.05, (i + 1) * 0.05) is None
    assert listen(watchdog, 0.5, 2.0) is not None
    watchdog.heard(2.0)
    assert not watchdog.silent(2.01)


def test_its_own_stall_is_not_taken_for_silence():
    """Incident to prevent: loading a large object took 0.6 s, and the arm was held for it."""
    watchdog = Watchdog(0.1)
    watchdog.heard(1.0)
    assert not watchdog.silent(1.01)
    assert not watchdog.silent(1.6)
    assert listen(watchdog, 1.604, 3.0) == pytest.approx(1.7, abs=0.08)
