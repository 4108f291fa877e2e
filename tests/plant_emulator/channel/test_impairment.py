"""What comes out of an impaired channel, and when."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import NEVER_NS, Channel
from plant_emulator.channel.impairment import ImpairedChannel
from plant_emulator.channel.opening import open_downlink, open_uplink

MS = 1_000_000
MESSAGES = 20_000


def uplink(seed=1, **channel):
    return open_uplink(LinkConfiguration(uplink=channel), seed)


def passed(channel, messages=MESSAGES, period_ns=MS, size_bytes=100):
    """Send numbers at a constant rate: (due, number) in the order of coming out."""
    for number in range(messages):
        channel.send(number, number * period_ns, size_bytes)
    return channel.take_due(NEVER_NS - 1)


def delays_ms(out, period_ns=MS):
    """Delays in ms by number of the message."""
    return {number: (due_ns - number * period_ns) / MS for due_ns, number in out}


def counts(channel):
    summary = channel.statistics().summary()
    return {name: summary[name] for name in ("sent", "delivered", "lost", "duplicated")}


def test_what_asks_for_nothing_is_the_plain_channel():
    assert type(uplink()) is Channel
    assert type(uplink(delay_ms=3, correlation=0.5, reorder=True, schedule=[])) is Channel
    assert type(uplink(jitter_ms=0.1)) is ImpairedChannel


@pytest.mark.parametrize(
    "nothing",
    [
        {"schedule": [{"kind": "step", "at_s": 3, "delay_ms": 8}]},
        {"burst_loss": {"p": 0, "r": 1}},
        {"burst_loss": {"p": 0.5, "r": 0.5, "loss_in_bad": 0}},
        {"rate_kbit_s": 1e12},
    ],
)
def test_impairments_of_no_effect_have_none(nothing):
    assert passed(uplink(delay_ms=8, **nothing), 5000) == passed(uplink(delay_ms=8), 5000)


def test_delays_are_never_negative():
    out = passed(uplink(delay_ms=1, jitter_ms=3, distribution="normal", reorder=True))
    delays = np.array(list(delays_ms(out).values()))
    assert delays.min() == 0
    share = 0.5 * math.erfc(1 / 3 / math.sqrt(2))  # P(1 + 3 z < 0)
    assert np.mean(delays == 0) == pytest.approx(
        share, abs=4 * math.sqrt(share * (1 - share) / MESSAGES)
    )


@pytest.mark.parametrize("distribution", ["uniform", "normal", "pareto"])
def test_order_is_kept_unless_reordering_is_allowed(distribution):
    jitter = {"delay_ms": 8, "jitter_ms": 3, "distribution": distribution}
    kept, free = uplink(**jitter), uplink(**jitter, reorder=True)
    in_order, out_of_order = passed(kept), passed(free)
    assert [number for _, number in in_order] == list(range(MESSAGES))
    assert [due_ns for due_ns, _ in in_order] == sorted(due_ns for due_ns, _ in in_order)
    assert kept.statistics().reordered == 0
    # Each waits for the latest of those before it, and for nothing else.
    by_number = [due_ns for due_ns, _ in sorted(out_of_order, key=lambda arrival: arrival[1])]
    assert [due_ns for due_ns, _ in in_order] == np.maximum.accumulate(by_number).tolist()
    newest, behind = -1, 0
    for _, number in out_of_order:
        behind += number < newest
        newest = max(newest, number)
    assert free.statistics().reordered == behind > MESSAGES / 10


def test_loss_leaves_the_delays_of_the_others_as_they_were():
    jitter = {"delay_ms": 8, "jitter_ms": 3, "distribution": "normal", "reorder": True}
    whole = delays_ms(passed(uplink(**jitter)))
    channel = uplink(**jitter, loss=0.2, burst_loss={"mean_loss": 0.1, "mean_burst": 3})
    lossy = delays_ms(passed(channel))
    assert lossy == {number: whole[number] for number in lossy}
    assert counts(channel)["lost"] == MESSAGES - len(lossy)
    share = 1 - 0.8 * 0.9
    assert 1 - len(lossy) / MESSAGES == pytest.approx(share, abs=0.03)


def test_duplicates_leave_the_first_of_each_as_it_was():
    jitter = {"delay_ms": 8, "jitter_ms": 0.4, "reorder": True}
    whole = dict(delays_ms(passed(uplink(**jitter))))
    channel = uplink(**jitter, duplicate=0.25)
    out = passed(channel)
    extra = len(out) - MESSAGES
    assert extra / MESSAGES == pytest.approx(0.25, abs=4 * math.sqrt(0.1875 / MESSAGES))
    assert counts(channel) == {
        "sent": MESSAGES, "delivered": MESSAGES + extra, "lost": 0, "duplicated": extra,
    }  # fmt: skip
    found = {(number, (due_ns - number * MS) / MS) for due_ns, number in out}
    assert set(whole.items()) <= found
    copies = np.array([delay_ms for _, delay_ms in found - set(whole.items())])
    error = 0.4 / math.sqrt(3) / math.sqrt(len(copies))
    assert copies.mean() == pytest.approx(8, abs=4 * error)


def test_directions_and_seeds_have_random_numbers_of_their_own():
    jitter = {"delay_ms": 8, "jitter_ms": 1, "reorder": True}
    link = LinkConfiguration(uplink=jitter, downlink=jitter)
    runs = [
        delays_ms(passed(opened(link, seed)))
        for opened, seed in [(open_uplink, 1), (open_downlink, 1), (open_uplink, 2)]
    ]
    assert delays_ms(passed(open_uplink(link, 1))) == runs[0]
    for one, other in [(0, 1), (0, 2), (1, 2)]:
        pairs = np.array([(runs[one][n], runs[other][n]) for n in range(MESSAGES)])
        assert abs(np.corrcoef(pairs.T)[0, 1]) < 4 / math.sqrt(MESSAGES)


def test_bandwidth_spaces_messages_exactly():
    # 100 bytes at 400 kbit/s take 2 ms, and one is sent every 1 ms: the k-th waits for k others.
    out = passed(uplink(delay_ms=5, rate_kbit_s=400), 50)
    assert out == [((k + 1) * 2 * MS + 5 * MS, k) for k in range(50)]
    # At 1600 kbit/s each has passed before the next one comes.
    out = passed(uplink(delay_ms=5, rate_kbit_s=1600), 50)
    assert out == [(k * MS + MS // 2 + 5 * MS, k) for k in range(50)]


def test_bandwidth_counts_the_size_of_each_message_and_of_copies_but_not_of_losses():
    channel = uplink(rate_kbit_s=8)  # a byte takes a millisecond
    for number, size_bytes in enumerate([1, 5, 2]):
        channel.send(number, 0, size_bytes)
    assert channel.take_due(NEVER_NS - 1) == [(1 * MS, 0), (6 * MS, 1), (8 * MS, 2)]
    twice = passed(uplink(rate_kbit_s=8, duplicate=1), 1, size_bytes=3)
    assert twice == [(3 * MS, 0), (6 * MS, 0)]
    schedule = [{"kind": "outage", "at_s": 0, "for_s": 0.001}]
    channel = uplink(rate_kbit_s=8, schedule=schedule)
    assert passed(channel, 2, size_bytes=3) == [(1 * MS + 3 * MS, 1)]


def test_step_ramp_and_outage_act_when_they_should():
    schedule = [
        {"kind": "step", "at_s": 0.1, "delay_ms": 4},
        {"kind": "ramp", "at_s": 0.2, "for_s": 0.1, "delay_ms": 14},
        {"kind": "outage", "at_s": 0.25, "for_s": 0.01},
        {"kind": "outage", "at_s": 0.4, "for_s": 0.1},
        {"kind": "step", "at_s": 0.5, "delay_ms": 20},
    ]
    channel = uplink(delay_ms=2, schedule=schedule)
    delays = delays_ms(passed(channel, 600))
    assert set(range(600)) - delays.keys() == {*range(250, 260), *range(400, 500)}
    assert {delays[k] for k in range(100)} == {2}
    assert {delays[k] for k in range(100, 200)} == {4}
    for k in {*range(200, 300)} & delays.keys():
        assert delays[k] == pytest.approx(4 + (k - 200) * 0.1, abs=1e-6)
    assert {delays[k] for k in range(300, 400)} == {14}
    assert {delays[k] for k in range(500, 600)} == {20}
    loss = channel.statistics().summary()["loss_burst"]
    assert loss == {"mean": 55, "longest": 100}  # two bursts, of 10 and of 100


@pytest.mark.parametrize(
    "changed",
    [{"jitter_ms": 1}, {"loss": 0.1}, {"duplicate": 0.1}, {"rate_kbit_s": 1000}],
    ids=lambda changed: next(iter(changed)),
)
def test_step_leads_to_what_would_have_been_without_it(changed):
    always = {"delay_ms": 8, "reorder": True}
    schedule = [{"kind": "step", "at_s": 1, **changed}]
    out = passed(uplink(**always, schedule=schedule), 2000)
    before = passed(uplink(**always), 2000)
    after = passed(uplink(**always, **changed), 2000)
    expected = [a for a in before if a[1] < 1000] + [a for a in after if a[1] >= 1000]
    assert sorted(out) == sorted(expected) != sorted(before)


def test_ramp_of_a_rate_is_linear_in_the_time_of_a_bit():
    schedule = [{"kind": "ramp", "at_s": 0, "for_s": 1, "rate_kbit_s": 800}]
    channel = uplink(rate_kbit_s=1600, schedule=schedule)  # 0.5 ms for 100 bytes, then 1 ms
    delays = delays_ms(passed(channel, 1001))
    assert (delays[0], delays[500], delays[1000]) == (0.5, 0.75, 1.0)


def test_first_delay_of_a_schedule_is_the_mean_at_the_start():
    schedule = [{"kind": "step", "at_s": 0, "delay_ms": 30}, {"kind": "step", "at_s": 1, "loss": 1}]
    assert uplink(delay_ms=2, schedule=schedule).mean_delay_ns == 30 * MS


def test_delays_of_a_file_are_added_to_the_constant_one(tmp_path):
    file = tmp_path / "delays.txt"
    file.write_text("0.5\n1.5\n4\n")
    channel = uplink(
        delay_ms=2, distribution="empirical", distribution_file=str(file), reorder=True
    )
    assert channel.mean_delay_ns == 4 * MS
    assert set(delays_ms(passed(channel, 500)).values()) == {2.5, 3.5, 6.0}


@given(
    gaps_ns=st.lists(st.integers(0, 5 * MS), max_size=60),
    loss=st.floats(0, 1), duplicate=st.floats(0, 1), reorder=st.booleans(),
    rate_kbit_s=st.none() | st.floats(1, 1e4), seed=st.integers(0, 2**32),
)  # fmt: skip
def test_every_message_is_accounted_for(gaps_ns, loss, duplicate, reorder, rate_kbit_s, seed):
    channel = uplink(
        seed, delay_ms=2, jitter_ms=3, distribution="pareto", loss=loss, duplicate=duplicate,
        reorder=reorder, rate_kbit_s=rate_kbit_s,
    )  # fmt: skip
    out, now_ns = [], 0
    for number, gap_ns in enumerate(gaps_ns):
        now_ns += gap_ns
        out += channel.take_due(now_ns - 1)
        channel.send((number, now_ns), now_ns, 100)
    out += channel.take_due(NEVER_NS - 1)
    assert channel.next_due_ns == NEVER_NS
    assert all(due_ns >= sent_ns for due_ns, (_, sent_ns) in out)
    assert [due_ns for due_ns, _ in out] == sorted(due_ns for due_ns, _ in out)
    text = counts(channel)
    assert text["sent"] == len(gaps_ns)
    assert text["delivered"] == len(out)
    assert text["duplicated"] == len(out) - len({number for _, (number, _) in out})
    assert text["sent"] + text["duplicated"] == text["delivered"] + text["lost"]


def test_statistics_are_those_of_the_delays():
    channel = uplink(delay_ms=8, jitter_ms=3, distribution="normal", loss=0.1, reorder=True)
    delays = np.array(list(delays_ms(passed(channel)).values()))
    text = channel.statistics().summary()["delay_ms"]
    assert text["mean"] == pytest.approx(delays.mean(), abs=1e-3)
    for name, q in [("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999), ("max", 1.0)]:
        exact = np.quantile(delays, q, method="inverted_cdf")
        assert text[name] == pytest.approx(exact, abs=0.6e-3)  # rounded to whole microseconds
