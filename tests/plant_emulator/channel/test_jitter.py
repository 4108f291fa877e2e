"""Each distribution meets its definition, within four standard errors at a fixed seed."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from bus_schema.link.channel_configuration import ChannelConfiguration
from plant_emulator.channel.jitter import Jitter, copula_correlations, read_delays_ms

DRAWS = 40_000
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
MEASURED_MS = [0.2, 0.3, 0.3, 0.4, 1.1, 7.5]


def pareto_quantile(u):
    """Shape 3 has mean 3/2 and variance 3/4."""
    return ((1 - u) ** (-1 / 3) - 1.5) / math.sqrt(0.75)


def step_quantile(u):
    return sorted(MEASURED_MS)[min(int(u * len(MEASURED_MS)), len(MEASURED_MS) - 1)]


KNOWN = {
    "uniform": lambda u: 2 * u - 1,
    "normal": NormalDist().inv_cdf,
    "pareto": pareto_quantile,
    "empirical": step_quantile,
}


@pytest.fixture
def draws(tmp_path):
    """Makes draws of a distribution, shape (count,)."""
    file = tmp_path / "delays.txt"
    file.write_text("\n".join(map(str, MEASURED_MS)))

    def make(name, correlation=0.0, seed=1, count=DRAWS):
        settings = {"distribution": name}
        if name == "empirical":
            settings["distribution_file"] = str(file)
        jitter = Jitter(ChannelConfiguration(**settings), np.random.default_rng(seed))
        return np.array([jitter.draw(correlation) for _ in range(count)])

    return make


@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("name", ["uniform", "normal", "pareto"])
def test_quantiles_are_those_of_the_distribution(draws, name, correlation):
    values = draws(name, correlation)
    # Of correlated draws fewer count: for an indicator of correlation ρ at lag 1, and at most ρ^k
    # at lag k, the variance of a mean grows by up to (1 + ρ) / (1 − ρ).
    counting = DRAWS * (1 - correlation) / (1 + correlation)
    for u in QUANTILES:
        below = np.mean(values <= KNOWN[name](u))
        assert below == pytest.approx(u, abs=4 * math.sqrt(u * (1 - u) / counting)), u


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_empirical_draws_are_the_file_s_delays_each_as_often(draws, correlation):
    values = draws("empirical", correlation)
    counting = DRAWS * (1 - correlation) / (1 + correlation)
    for delay_ms in set(MEASURED_MS):
        share = MEASURED_MS.count(delay_ms) / len(MEASURED_MS)
        error = math.sqrt(share * (1 - share) / counting)
        assert np.mean(values == delay_ms) == pytest.approx(share, abs=4 * error)
    assert set(values) == set(MEASURED_MS)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("name", ["uniform", "normal", "empirical"])
def test_lag_one_correlation_is_the_one_asked_for(draws, name, correlation):
    values = draws(name, correlation)
    found = np.corrcoef(values[:-1], values[1:])[0, 1]
    # 1/√n is the standard error without correlation, √(1 − ρ²)/√n for an autoregressive sequence;
    # a heavy upper end (the file's 7.5 ms) makes it larger: by the kurtosis, at most.
    kurtosis = np.mean((values - values.mean()) ** 4) / values.var() ** 2
    error = math.sqrt(max(kurtosis / 3, 1.0) / DRAWS)
    assert found == pytest.approx(correlation, abs=4 * error)


def test_uniform_copula_has_its_known_correlation():
    levels, normal = copula_correlations(lambda z: 2 * NormalDist().cdf(z) - 1)
    np.testing.assert_allclose(levels, 6 / math.pi * np.arcsin(normal / 2), atol=1e-5)


def test_file_of_one_delay_is_a_constant(tmp_path):
    file = tmp_path / "delays.txt"
    file.write_text("3.5\n")
    configuration = ChannelConfiguration(distribution="empirical", distribution_file=str(file))
    jitter = Jitter(configuration, np.random.default_rng(1))
    assert {jitter.draw(0.5) for _ in range(20)} == {3.5}


@pytest.mark.parametrize(
    "text",
    [
        "0.5\n2\n1e0\n",
        "delay_ms\n2\n0.5\n1\n",
        "2,x\n0.5,y\n1,z\n",
        "# ping\n\n1 a\n2 b\n0.5\n",
        "time_s,delay_ms\n0.000,2\n0.001,0.5\n0.002,1\n",
        "# of a network\ndelay_ms; time_s\n2; 0\n1; 0.1\n0.5; 0.2\n",
    ],
    ids=["lines", "title", "columns", "comments", "named", "semicolons"],
)
def test_files_of_delays_are_read(tmp_path, text):
    file = tmp_path / "delays.txt"
    file.write_text(text)
    assert read_delays_ms(file).tolist() == [0.5, 1.0, 2.0]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "holds no delay"),
        (b"delay_ms\n", "holds no delay"),
        (b"1\ntwo\n", "line 2: 'two' is not a number"),
        (b"1\n-2\n", "line 2: a delay is at least 0"),
        (b"nan\n", "line 1: a delay is at least 0"),
        (b"\xff\xfe", "cannot be read"),
        (b"0.1,2\n0.2,3\n", "line 1, column 2 = 2: a second number"),
        (b"1\n1,5\n", "line 2, column 2 = 5: a second number"),
        (
            b"time_s,delay_us\n0,2000\n",
            "line 1: 'time_s' is not a number; a file with column names",
        ),
        (b"delay_ms,rtt_ms\n1,2\n", "line 1, column 2 'rtt_ms' is unknown"),
        (b"delay_ms,delay_ms\n1,2\n", "line 1, column 1 'delay_ms' occurs twice"),
        (b"time_s,delay_ms\n0,2\n\n1,\n", "line 4, column delay_ms = empty: a delay is at least 0"),
        (b"time_s,delay_ms\n0,2\n1,two\n", "line 3, column delay_ms = 'two': is not a number"),
        (b"time_s,delay_ms\n0,2\n1,2,5\n", "line 3 has 3 cells, the first line names 2 columns"),
    ],
    ids=[
        "empty",
        "title",
        "word",
        "negative",
        "nan",
        "binary",
        "no names",
        "decimal comma",
        "other unit",
        "unknown column",
        "column twice",
        "lost message",
        "named word",
        "ragged",
    ],
)
def test_file_of_something_else_is_refused(tmp_path, content, complaint):
    file = tmp_path / "delays.txt"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=complaint):
        read_delays_ms(file)
