import itertools

import pytest

from bus_schema.runtime.modes import (
    TRANSITIONS,
    IllegalTransitionError,
    Mode,
    Trigger,
    follow,
    mode_event,
    mode_in,
)


def test_every_pair_is_in_the_table_or_refused():
    for mode, trigger in itertools.product(Mode, Trigger):
        if (mode, trigger) in TRANSITIONS:
            assert follow(mode, trigger) is TRANSITIONS[mode, trigger]
        else:
            with pytest.raises(
                IllegalTransitionError, match=f"{mode.name}.*{trigger.name}"
            ) as refused:
                follow(mode, trigger)
            assert (refused.value.mode, refused.value.trigger) == (mode, trigger)


def test_fault_is_reached_through_stopping_alone_and_never_left():
    assert {before for (before, _), after in TRANSITIONS.items() if after is Mode.FAULT} == {
        Mode.STOPPING
    }
    assert not [mode for mode, _ in TRANSITIONS if mode is Mode.FAULT]


def test_both_sides_can_stop():
    for mode in (Mode.READY, Mode.TRACKING):
        assert follow(mode, Trigger.FAIL) is Mode.STOPPING


@pytest.mark.parametrize("mode", Mode)
def test_event_of_a_mode_can_be_read_back(mode):
    assert mode_in(mode_event(mode, "why: for a reason")) is mode


def test_event_without_a_mode_is_distinguished():
    assert mode_in("sleeping: at night") is None
