"""A Dask scheduler that asks who is there, and one that does not."""

from __future__ import annotations

import dask
import pytest
import typer
import yaml
from distributed import LocalCluster
from distributed.security import Security

from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.sweep.command import sweep
from deploy.study.execution.dask_workers import DaskWorkers


@pytest.fixture(scope="module")
def credentials(tmp_path_factory):
    """Configuration of Dask with a certificate that is its own authority."""
    folder, made = tmp_path_factory.mktemp("tls"), Security.temporary()
    (folder / "ca.pem").write_text(made.tls_ca_file)
    (folder / "all.pem").write_text(made.tls_client_key + made.tls_client_cert)
    roles = {
        f"distributed.comm.tls.{role}.cert": str(folder / "all.pem")
        for role in ("client", "scheduler", "worker")
    }
    return {"distributed.comm.tls.ca-file": str(folder / "ca.pem"), **roles}


@pytest.fixture(scope="module")
def tls_scheduler(credentials):
    """The address of a scheduler under TLS with one worker."""
    with dask.config.set(credentials):
        security = Security()
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tls://", security=security,
        dashboard_address=None, host="127.0.0.1",
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


def test_a_scheduler_under_tls_is_used_with_the_certificates_of_dasks_configuration(
    credentials, tls_scheduler
):
    assert tls_scheduler.startswith("tls://")
    with dask.config.set(credentials), DaskWorkers(scheduler=tls_scheduler) as team:
        assert team.count == 1


def test_client_without_certificate_is_refused_with_a_message(tls_scheduler):
    with pytest.raises(ScenarioError, match="--scheduler tls://"):
        DaskWorkers(scheduler=tls_scheduler)


def warning_of(address, folder, capsys):
    """What a sweep of one short run on a scheduler says on stderr."""
    file = folder / "one.yaml"
    wanted = {
        "name": "one", "scenario": "paper_arm", "set": {"duration_s": 0.02},
        "grid": {"plant.payload_kg": [0.0]},
    }  # fmt: skip
    file.write_text(yaml.safe_dump(wanted))
    with pytest.raises(typer.Exit) as left:
        sweep(sweep=str(file), scheduler=address, out=folder / "out")
    assert left.value.exit_code == 0
    return capsys.readouterr().err


def test_an_open_scheduler_is_warned_of(tmp_path, capsys):
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:  # fmt: skip
        text = warning_of(cluster.scheduler_address, tmp_path, capsys)
    assert "can run code" in text
    assert "TLS" in text


def test_one_under_tls_is_not_warned_of(credentials, tls_scheduler, tmp_path, capsys):
    with dask.config.set(credentials):
        assert "can run code" not in warning_of(tls_scheduler, tmp_path, capsys)
