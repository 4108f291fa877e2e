"""A direction over TCP: delays of losses by the rules of RFC 6298 and 6675, in virtual time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schema.link.configuration import LinkConfiguration
from deploy.run.execute import InProcesses, execute, lockstep_setup
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.channel import NEVER_NS
from plant_emulator.channel.opening import DOWNLINK, UPLINK, answer_ns, open_channel

MS = 1_000_000
ONE_WAY_MS = 2.0
PERIOD_MS = 10.0


def direction(transport="tcp", back_ms=ONE_WAY_MS, seed=3, **way):
    way = {"delay_ms": ONE_WAY_MS, **way}
    values = {"uplink": way, "downlink": {"delay_ms": back_ms}, "transport": transport}
    link = LinkConfiguration(**values)
    return open_channel(link.uplink, seed, UPLINK, (), answer_ns(link, UPLINK))


def outage(at_ms, for_ms):
    return {"schedule": [{"kind": "outage", "at_s": 1e-3 * at_ms, "for_s": 1e-3 * for_ms}]}


def delays_ms(channel, times_ms):
    """Delays of messages sent at these times, by number; none if it does not arrive."""
    found, numbers = {}, []
    for number, at_ms in enumerate(times_ms):
        for due_ns, earlier in channel.take_due(round(at_ms * MS)):
            found[earlier] = due_ns / MS - times_ms[earlier]
            numbers.append(earlier)
        channel.send(number, round(at_ms * MS), 100)
    for due_ns, earlier in channel.take_due(NEVER_NS // 2):
        found[earlier] = due_ns / MS - times_ms[earlier]
        numbers.append(earlier)
    assert numbers == sorted(found)  # in order, each once
    return [found.get(number) for number in range(len(times_ms))]


def test_three_later_messages_show_a_loss_and_all_wait_for_its_repetition():
    """The third acknowledgement is back after 3 T + 2 d; the repetition takes d."""
    times_ms = PERIOD_MS * np.arange(12.0)
    found = delays_ms(direction(**outage(29.0, 2.0)), times_ms)  # of number 3
    repaired_ms = 3.0 * PERIOD_MS + 3.0 * ONE_WAY_MS
    expected = 12 * [ONE_WAY_MS]
    expected[3:7] = [repaired_ms - PERIOD_MS * k for k in range(4)]
    assert found == pytest.approx(expected)


def test_a_burst_of_losses_is_repaired_as_acknowledgements_arrive():
    """Numbers 3 and 4: the third acknowledgement after number 4 is enough for both."""
    found = delays_ms(direction(**outage(29.0, 12.0)), PERIOD_MS * np.arange(12.0))
    repaired_ms = 4.0 * PERIOD_MS + 3.0 * ONE_WAY_MS
    assert found[3:5] == pytest.approx([repaired_ms, repaired_ms - PERIOD_MS])


def test_a_message_that_nothing_follows_waits_for_the_timer_which_doubles():
    """Linux: the usual round trip and 200 ms, then twice that, and then four times."""
    once_ms = 2.0 * ONE_WAY_MS + 200.0
    for outage_ms, waits in ((2.0, 1), (once_ms + 2.0, 3), (3.0 * once_ms + 2.0, 7)):
        [found] = delays_ms(direction(**outage(0.0, outage_ms)), [1.0])
        assert found == pytest.approx(waits * once_ms + ONE_WAY_MS)


def test_what_is_written_while_the_timer_repeats_waits_for_the_first_acknowledgement():
    """An outage of 300 ms in a stream: the second repetition ends it, and one round trip later all.

    Number 2 is acknowledged at 20 + 2 d, so that number 3 starts the timer.
    """
    times_ms = PERIOD_MS * np.arange(100.0)
    found = delays_ms(direction(**outage(29.0, 300.0)), times_ms)
    once_ms = 2.0 * ONE_WAY_MS + 200.0
    first_ms = times_ms[3] + 3.0 * once_ms + ONE_WAY_MS
    assert times_ms[3] + found[3] == pytest.approx(first_ms)
    assert times_ms[4] + found[4] == pytest.approx(first_ms + 2.0 * ONE_WAY_MS)
    assert found[-1] == ONE_WAY_MS


def test_without_losses_messages_take_what_they_take_over_udp():
    times_ms = np.arange(500.0)
    jitter = {"jitter_ms": 3.0, "distribution": "pareto", "rate_kbit_s": 2000.0}
    assert delays_ms(direction(**jitter), times_ms) == delays_ms(
        direction("udp", **jitter), times_ms
    )


@settings(max_examples=30, deadline=None)
@given(
    loss=st.floats(0.0, 0.6), seed=st.integers(0, 1000), period=st.floats(0.2, 50.0),
    back_ms=st.floats(0.0, 100.0), jitter_ms=st.floats(0.0, 20.0), reorder=st.booleans(),
)  # fmt: skip
def test_all_arrive_once_and_in_order(loss, seed, period, back_ms, jitter_ms, reorder):
    channel = direction(
        seed=seed, loss=loss, back_ms=back_ms, jitter_ms=jitter_ms, reorder=reorder
    )  # fmt: skip
    found = delays_ms(channel, period * np.arange(200.0))
    assert None not in found
    assert channel.next_due_ns == NEVER_NS
    statistics = channel.statistics()
    assert (statistics.sent, statistics.delivered, statistics.lost) == (200, 200, 0)


def test_one_percent_of_loss_costs_a_request_the_timer_and_a_stream_three_periods():
    """At 100 Hz: two ways of 1 % put the timer into the 99th percentile; a stream has 3 T + 3 d."""
    way = {"delay_ms": 1.25, "loss": 0.01}
    link = LinkConfiguration(uplink=way, downlink=way, transport="tcp")
    there, back = (
        open_channel(each, 5, stream, (), answer_ns(link, stream))
        for each, stream in ((link.downlink, DOWNLINK), (link.uplink, UPLINK))
    )
    trips_ms, now_ns = [], 0
    for _ in range(5000):
        there.send(0, now_ns, 100)
        [(due_ns, _)] = there.take_due(now_ns + 10**12)
        back.send(0, due_ns, 100)
        [(back_ns, _)] = back.take_due(due_ns + 10**12)
        trips_ms.append((back_ns - now_ns) / MS)
        now_ns = max(now_ns + 10 * MS, back_ns) + 10**13
    assert np.percentile(trips_ms, 99) == pytest.approx(205.0)
    stream = direction(delay_ms=1 / 3, back_ms=1 / 3, loss=0.01)
    found = delays_ms(stream, 10.0 * np.arange(20_000.0))
    assert np.percentile(found, 99) == pytest.approx(31.0, abs=0.01)


def test_simulation_and_lockstep_over_tcp_have_equal_digests():
    words = [
        "duration_s=0.4", "link.transport=tcp", "controller.law=streaming",
        "link.uplink.delay_ms=2", "plant.interface.kind=servoj",
        "link.downlink={delay_ms: 2, jitter_ms: 1, loss: 0.02}",
    ]  # fmt: skip
    setup = load_setup("paper_arm", words)
    data = simulate(setup).data()
    summary = execute(lockstep_setup(setup), InProcesses()).summary
    assert summary["digest"] == data.digest
    downlink = summary["transport"]["downlink"]
    assert downlink["lost"] == 0
    assert downlink["resent"] > 0


SCHEDULE = "link.downlink.schedule=[{{at_s: 1, duplicate: 0.1, kind: {}}}]"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["link.transport=tcp", "link.uplink.duplicate=0.1"], "TCP delivers nothing twice"),
        (
            ["link.transport=tcp", SCHEDULE.format("step")],
            "TCP delivers nothing twice",
        ),
        (
            ["link.transport=tcp", SCHEDULE.format("ramp, for_s: 1")],
            "TCP delivers nothing twice",
        ),
        (
            ["link.transport=tcp", "faults=[{kind: link_duplicated, at_s: 1, direction: uplink}]"],
            "faults.0.kind = 'link_duplicated': must be left out with link.transport: tcp",
        ),
        (["link.transport=tcp", "link.kind=can"], "a bus has no streams"),
        (["link.transport=quic"], "'udp' or 'tcp'"),
    ],
)
def test_what_tcp_cannot_do_is_refused(words, reason):
    with pytest.raises(ScenarioError, match=r"link\.transport") as refused:
        load_setup("paper_arm", words)
    assert reason in str(refused.value)
