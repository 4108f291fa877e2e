"""What a law is shown, and that warming it up leaves no trace."""

import numpy as np
import pytest
from loop_bench import MS, OFFSET, Bench, KeepsItsDiagnostics, Spectator, predicting

from bus_schema.messages import topics


def test_diagnostics_are_published_whether_a_law_writes_into_them_or_assigns_them():
    bench = Bench(own_law=KeepsItsDiagnostics())
    bench.loop.warm_up()
    bench.send(5 * MS)
    status = bench.last(topics.CONTROL_STATUS)
    assert status.fields["transformed_error"].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(status.fields["sliding_variable"], 2.0 * OFFSET, rtol=1e-12)
    assert np.isnan(status.fields["network_output"]).all()
    assert status.scalars.network_norm == 7.0


@pytest.mark.parametrize("is_compensated", [False, True])
def test_warming_up_shows_a_law_the_very_situation_it_will_be_shown(is_compensated):
    """A law binds its kernels to it: another one would be bound while time counts."""
    compensation = predicting() if is_compensated else None
    bench = Bench(own_law=Spectator(), compensation=compensation)
    bench.loop.warm_up()
    bench.send(0)
    bench.send(MS)
    shown = compensation.predicted if is_compensated else bench.loop.tracking
    assert [each is shown for each in bench.law.shown] == [True] * 3


@pytest.mark.parametrize("is_compensated", [False, True])
@pytest.mark.parametrize("law", ["pid", "fixed_time_neural", "ftsmc"])
def test_warming_up_leaves_no_trace(law, is_compensated):
    warm, cold = (
        Bench(
            law,
            rate_limit=1000.0,
            compensation=predicting() if is_compensated else None,
            sends_targets=is_compensated,
        )
        for _ in range(2)
    )
    warm.loop.warm_up()
    assert warm.received == []
    for tick in range(5):
        assert warm.send(tick * MS, 0.1 * OFFSET) == cold.send(tick * MS, 0.1 * OFFSET)
        np.testing.assert_array_equal(warm.targets, cold.targets)


def test_a_compensated_law_sees_the_time_at_which_its_torque_is_expected_to_act():
    bench = Bench(own_law=Spectator(), compensation=predicting(20 * MS))
    for tick in range(31):
        bench.send(tick * MS)
    # Nothing acts, as the plant says: after 20 ms, as long as was waited.
    assert bench.law.times_s[0] == pytest.approx(0.020)
    assert bench.law.times_s[20] == pytest.approx(0.040)
    assert bench.law.times_s[30] == pytest.approx(0.060)
