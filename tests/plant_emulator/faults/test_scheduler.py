from plant_emulator.faults.fault import FaultScheduler, ScheduledAction


def noting(done, name):
    return lambda now_ns: done.append((name, now_ns))


def test_actions_are_done_once_in_the_order_of_their_instants():
    done = []
    schedule = FaultScheduler(
        ScheduledAction(at_ns, name, noting(done, name))
        for name, at_ns in (("late", 30), ("first", 10), ("second", 10))
    )
    for now_ns in (0, 9, 12, 12, 40, 50):
        schedule.run_due(now_ns)
    assert done == [("first", 12), ("second", 12), ("late", 40)]


def test_action_is_reported_before_it_is_done():
    reported = []
    schedule = FaultScheduler([ScheduledAction(5, "begins", lambda _: reported.append("done"))])
    schedule.run_due(5, reported.append)
    assert reported == ["begins", "done"]


def test_what_is_to_come_can_be_postponed_and_added_to():
    done = []
    schedule = FaultScheduler([ScheduledAction(10, "a", noting(done, "a"))])
    schedule.postpone(100)
    schedule.add(ScheduledAction(105, "b", noting(done, "b")))
    for now_ns in (10, 105, 110):
        schedule.run_due(now_ns)
    assert done == [("b", 105), ("a", 110)]
