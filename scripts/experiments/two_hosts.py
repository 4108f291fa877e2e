"""Two hosts on this machine: network namespaces that a virtual cable joins."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TextIO

_CLONE_NEWNET = 0x40000000  # <linux/sched.h>
ADDRESSES = ("192.0.2.10", "192.0.2.11")
_END_S = 20.0


class Host(NamedTuple):
    """A network namespace.

    Attributes:
        namespace: its name.
        address: its address on the cable.
    """

    namespace: str
    address: str

    @contextmanager
    def command(self, *words: object) -> Iterator[subprocess.Popen[str]]:
        """Run a `funnel-hil` command on this host; it is stopped at the end of the context."""
        program = ["ip", "netns", "exec", self.namespace, sys.executable, "-m", "deploy.cli"]
        with subprocess.Popen(
            [*program, *map(str, words)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        ) as process:  # fmt: skip
            try:
                yield process
            finally:
                process.terminate()
                try:
                    process.wait(_END_S)
                except subprocess.TimeoutExpired:
                    process.kill()

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Sockets that this thread opens in the context belong to this host."""
        with Path("/proc/thread-self/ns/net").open() as before:
            enter(self.namespace)
            try:
                yield
            finally:
                _enter(before)


def enter(namespace: str) -> None:
    """Move this thread to a network namespace.

    Raises:
        OSError: it does not exist, or root is needed.
    """
    with Path("/run/netns", namespace).open() as there:
        _enter(there)


def _enter(there: TextIO) -> None:
    if ctypes.CDLL(None, use_errno=True).setns(there.fileno(), _CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "cannot enter the network namespace")


@contextmanager
def two_hosts() -> Iterator[tuple[Host, Host]]:
    """Make two hosts, and remove them at the end.

    Raises:
        OSError: this machine or user cannot make network namespaces.
    """
    if shutil.which("ip") is None:
        raise FileNotFoundError("network namespaces need the program ip (iproute2)")
    first, second = hosts = tuple(
        Host(f"funnel-hil-{os.getpid()}-{number}", address)
        for number, address in enumerate(ADDRESSES)
    )
    with contextlib.ExitStack() as stack:
        for host in hosts:
            _ip("netns", "add", host.namespace)
            stack.callback(_ip, "netns", "delete", host.namespace)
        peer = ("peer", "name", "eth0", "netns", second.namespace)
        _ip("-n", first.namespace, "link", "add", "eth0", "type", "veth", *peer)
        for name, address in hosts:
            _ip("-n", name, "address", "add", f"{address}/24", "dev", "eth0")
            for device in ("eth0", "lo"):
                _ip("-n", name, "link", "set", device, "up")
        yield first, second


def _ip(*words: str) -> None:
    ended = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if ended.returncode:
        raise PermissionError(
            f"network namespaces cannot be made here, run as root: {ended.stderr.strip()}"
        )


def await_line(process: subprocess.Popen[str], words: str) -> str:
    """Return the next line of a process that contains these words.

    Raises:
        RuntimeError: it ends before.
    """
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if words in line:
            return line
    raise RuntimeError("".join(lines))
