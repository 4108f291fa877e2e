"""The table of positions over networks."""

from scripts.experiments.positions_over_networks import links, row


def summary(verdict, rms, largest, lag_ms):
    return {
        "verdict": verdict,
        "tip_error_mm": {"rms": rms, "largest": largest},
        "lag_ms": lag_ms,
    }


def test_a_row_has_the_worst_of_its_runs():
    """Also a joint that is ahead by more than others are behind; joints at rest have no lag."""
    runs = [summary("kept", 0.5, 3.0, [4.0, None]), summary("lost", 0.7, 2.0, [1.0, -6.26])]
    assert row("vpn", "auto", runs) == "| vpn | auto | 1 of 2 kept | 0.70 | 3.00 | -6.3 |"


def test_both_directions_follow_a_trace_from_each_start():
    found = links(["vpn"], ["0", "15"])
    assert list(found) == ["none", "40 ms", "vpn"]
    assert found["vpn"][1] == [
        "link.uplink.trace={file: vpn, start_s: 15}",
        "link.downlink.trace={file: vpn, start_s: 15}",
    ]
