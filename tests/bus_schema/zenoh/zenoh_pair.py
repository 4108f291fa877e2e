"""Both sides of a Zenoh link on this machine, and others beside them, for tests."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import zenoh

from bus_schema.link.configuration import LinkConfiguration
from bus_schema.messages.record import Record
from bus_schema.messages.topics import JOINT_STATES, PLANT_STATUS, layout
from bus_schema.runtime.clock import MonotonicClock
from bus_schema.zenoh.link import ZenohControllerLink, ZenohPlantLink
from tests.waiting import free_endpoint

HANG_S = 60.0
JOINTS = ("base_yaw", "shoulder", "elbow")


@contextmanager
def plant_on(link: LinkConfiguration, *, lockstep: bool = True) -> Iterator[ZenohPlantLink]:
    plant = ZenohPlantLink(link, MonotonicClock(), lockstep=lockstep)
    try:
        yield plant
    finally:
        plant.close()


@contextmanager
def controller_on(link: LinkConfiguration) -> Iterator[ZenohControllerLink]:
    controller = ZenohControllerLink(link, lossless=True)
    try:
        yield controller
    finally:
        controller.close()


@contextmanager
def commanded_pair(*, lockstep=True):
    """Both sides of a link, the controller in command."""
    link = fresh_link()
    with plant_on(link, lockstep=lockstep) as plant, controller_on(link) as controller:
        controller.activate()
        plant.await_controller(HANG_S)
        yield plant, controller


@contextmanager
def spinning(controller: ZenohControllerLink) -> Iterator[None]:
    """Have a thread answer states."""
    over = threading.Event()
    thread = threading.Thread(target=controller.spin, args=[over.is_set])
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(HANG_S)
        assert not thread.is_alive()


def fresh_link() -> LinkConfiguration:
    return LinkConfiguration(
        plant_endpoint=free_endpoint(),
        controller_endpoint=free_endpoint(),
        connect_timeout_s=HANG_S,
    )


def state(stamp_ns: int, **values: tuple[float, ...]) -> bytes:
    record = Record(layout(JOINT_STATES, JOINTS))
    record.stamp_ns = stamp_ns
    for name, value in values.items():
        record.fields[name][:] = value
    return record.payload()


def status() -> bytes:
    return layout(PLANT_STATUS, JOINTS).template


def foreign_session(settings: Mapping[str, Any]) -> zenoh.Session:
    """A foreign session with the default settings of Zenoh and these."""
    configuration = zenoh.Config()
    for path, value in settings.items():
        configuration.insert_json5(path, json.dumps(value))
    return zenoh.open(configuration)
