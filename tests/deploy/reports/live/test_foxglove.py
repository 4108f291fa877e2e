"""Foxglove's server, as a client that speaks its protocol meets it."""

import asyncio
import json
import struct
import threading
from contextlib import contextmanager

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tornado.websocket import websocket_connect
from watched import payloads, playback, short_run

from bus_schema.messages import topics
from deploy.reports.live.foxglove_layout import foxglove_layout
from deploy.reports.live.viewer import Viewer
from deploy.scenario.scenario import load_setup

foxglove_server = pytest.importorskip(
    "deploy.reports.live.foxglove_server", reason="needs the extra live (foxglove-sdk)"
)
HANG_S = 120
SUBPROTOCOL, MESSAGE, ASSET_FOUND = "foxglove.sdk.v1", 1, 4


class Client:
    """One of Foxglove's clients: it hears what is advertised, and subscribes to all of it."""

    def __init__(self, connection):
        self.connection = connection
        self.channels = {}
        self.before_channels = 0

    async def read(self):
        return await asyncio.wait_for(self.connection.read_message(), HANG_S)

    async def send(self, **values):
        await self.connection.write_message(json.dumps(values))

    async def hear_channels(self, count):
        while len(self.channels) < count:
            message = await self.read()
            if isinstance(message, bytes):
                self.before_channels += 1
                continue
            values = json.loads(message)
            if values["op"] == "serverInfo":
                self.info = values
            if values["op"] == "advertise":
                self.channels |= {each["id"]: each for each in values["channels"]}

    async def subscribe(self):
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        await self.send(op="subscribe", subscriptions=wanted)

    async def messages(self):
        """Topic, log time and bytes of each message."""
        while True:
            message = await self.read()
            if message is None:
                return
            if isinstance(message, bytes) and message[0] == MESSAGE:
                number, stamp_ns = struct.unpack_from("<IQ", message, 1)
                yield self.channels[number]["topic"], stamp_ns, message[13:]


async def connected(url):
    return Client(await websocket_connect(url, subprotocols=[SUBPROTOCOL]))


@contextmanager
def played():
    """The address of a viewer that plays a run from a start signal on."""
    run, begin, over = short_run(), threading.Event(), threading.Event()
    viewer = Viewer(run.setup, "a test", foxglove_port=0)
    source = playback(run, 1.0, begin.is_set)
    server = threading.Thread(target=viewer.run, args=(source, over.is_set))
    server.start()
    try:
        yield viewer.places().split()[-1], begin
    finally:
        over.set()
        server.join()
        viewer.close()


@pytest.fixture
def served():
    with played() as (url, begin):
        yield url, begin


def channels():
    return len(topics.TOPICS) + len(topics.VIEW_TOPICS) + 1


def test_all_is_advertised_with_its_schema_before_the_first_message(served):
    url, begin = served

    async def meet():
        client = await connected(url)
        await client.hear_channels(channels())
        assert client.before_channels == 0
        assert not {"clientPublish", "parameters", "services"} & set(client.info["capabilities"])
        by_topic = {each["topic"]: each for each in client.channels.values()}
        store = get_typestore(Stores.EMPTY)  # knows nothing but what is advertised
        for each in by_topic.values():
            if each["encoding"] == "cdr":
                assert each["schemaEncoding"] == "ros2msg"
                types = get_types_from_msg(each["schema"], each["schemaName"])
                store.register({k: v for k, v in types.items() if k not in store.fielddefs})
        await client.subscribe()
        seen = {}
        async for topic, stamp_ns, payload in client.messages():
            seen.setdefault(topic, []).append((stamp_ns, payload))
            if {"/robot_description", "/tf_static"} <= seen.keys():
                begin.set()  # those are sent to who has subscribed
            if stamp_ns >= 0.25e9:
                break
        return by_topic, store, seen

    by_topic, store, seen = asyncio.run(meet())
    sent = payloads(short_run())
    for name in ("joint_states", "joint_commands", "plant_truth", "control_status", "plant_status"):
        each = by_topic[f"/{name}"]
        assert all(payload in sent[name] for _, payload in seen[f"/{name}"])  # the same bytes
        message = store.deserialize_cdr(seen[f"/{name}"][-1][1], each["schemaName"])
        assert message.header.stamp.nanosec == seen[f"/{name}"][-1][0]
        assert len(seen[f"/{name}"]) <= 0.3 * 60 + 1  # of 300 that were sent
    urdf = store.deserialize_cdr(seen["/robot_description"][0][1], "std_msgs/msg/String").data
    assert "base_yaw" in urdf
    tf = store.deserialize_cdr(seen["/tf"][-1][1], by_topic["/tf"]["schemaName"])
    assert len(tf.transforms) == 3
    assert seen["/tf_static"]
    counts = json.loads(seen["/deadlines"][-1][1])
    assert counts["missed"] == 0
    assert counts["ticks"] > 100


def test_the_arm_is_an_asset_too(served):
    url, _ = served

    async def ask():
        client = await connected(url)
        uri = foxglove_server.URDF_ASSET
        await client.send(op="fetchAsset", uri=uri, requestId=1)
        while True:
            message = await client.read()
            if isinstance(message, bytes) and message[0] == ASSET_FOUND:
                return message

    assert b"<robot" in asyncio.run(ask())


def test_garbage_and_a_client_that_reads_nothing_do_not_disturb_another(served):
    url, begin = served

    async def meet():
        rude, still = await connected(url), await connected(url)
        await still.hear_channels(channels())
        await still.subscribe()  # and reads nothing from here on
        for garbage in ("", "{", '{"op": 1}', '{"op": "subscribe", "subscriptions": 3}'):
            await rude.connection.write_message(garbage)
        await rude.connection.write_message(bytes(range(256)), binary=True)
        client = await connected(url)
        await client.hear_channels(channels())
        await client.subscribe()
        async for topic, _, _ in client.messages():
            if topic == "/tf":
                break
            begin.set()

    asyncio.run(meet())


def test_the_layout_names_what_is_there():
    for name in ("paper_arm", "iiwa"):
        setup = load_setup(name)
        layout = foxglove_layout(setup)
        json.dumps(layout)
        placed = panels_in(layout["layout"])
        assert sorted(placed) == sorted(layout["configById"])
        paths = [
            line["value"] for panel in layout["configById"].values()
            for line in panel.get("paths", ())
        ]  # fmt: skip
        assert len(paths) == 4 * setup.robot.joints + 2
        for path in paths:
            topic, _, field = path.removeprefix("/").partition(".")
            if topic != "deadlines":
                by_name = {each.name: each for each in topics.TOPICS}
                fields = topics.layout(by_name[topic], setup.robot.joint_names).dtype.fields
                assert field.partition("[")[0] in fields


def panels_in(node):
    return [node] if isinstance(node, str) else panels_in(node["first"]) + panels_in(node["second"])
