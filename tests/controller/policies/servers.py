"""Policy servers for tests, in threads, which answer what a test wants.

`LeRobotLikeServer` has the methods of LeRobot's service (services.proto) and pickles as LeRobot's
server sends them; it is not LeRobot's. `OpenPiLikeServer` packs its messages with openpi-client's
own code where that is installed.
"""

from __future__ import annotations

import contextlib
import io
import pickle
import struct
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

SERVICE = "transport.AsyncInference"


class Named:
    """Reduces to a call of a name that is not importable here."""

    def __init__(self, module, name, arguments):
        self.module, self.name, self.arguments = module, name, arguments


def pickled(value):
    """Return opcodes for lists, numbers, tuples, bytes and `Named`, as protocol 4 has them."""
    if isinstance(value, Named):
        called = f"c{value.module}\n{value.name}\n".encode()
        return called + pickled(value.arguments) + pickle.REDUCE
    if isinstance(value, tuple):
        return pickle.MARK + b"".join(map(pickled, value)) + pickle.TUPLE
    if isinstance(value, list):
        return pickle.MARK + b"".join(map(pickled, value)) + pickle.LIST
    return pickle.dumps(value, 3)[2:-1]


def tensor(values):
    """A float32 tensor as PyTorch pickles it: a storage in the old format of torch.save."""
    values = np.asarray(values, np.float32)
    kind = b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpu"
    described = b"\x80\x02" + kind + pickle.dumps(values.size, 2)[2:-1] + b"NtQ."
    parts = [0x1950A86A20F9469CFC6C, 1001, {"protocol_version": 1001, "little_endian": True}]
    head = b"".join(pickle.dumps(each, 2) for each in parts) + described + pickle.dumps(["0"], 2)
    storage = Named(
        "torch.storage", "_load_from_bytes",
        (head + struct.pack("<q", values.size) + values.tobytes(),),
    )  # fmt: skip
    hooks = Named("collections", "OrderedDict", ())
    arguments = (storage, 0, values.shape, tuple(n // 4 for n in values.strides), False, hooks)
    return Named("torch._utils", "_rebuild_tensor_v2", arguments)


def action_pickle(number, actions):
    """Return the pickle of a list of LeRobot's TimedAction."""
    entries = b""
    for row, action in enumerate(actions):
        state = b"".join(
            pickled(name) + pickled(value)
            for name, value in {
                "timestamp": 1.0, "timestep": number + row, "action": tensor(action),
            }.items()
        )  # fmt: skip
        entries += b"clerobot.async_inference.helpers\nTimedAction\n)\x81}(" + state + b"ub"
    return b"\x80\x04](" + entries + b"e."


def field(data):
    size, head = len(data), b"\x0a"
    while size > 127:
        head += bytes([size & 127 | 128])
        size >>= 7
    return head + bytes([size]) + data


class Seen:
    """Stands for LeRobot's classes when a test reads what the client has sent."""


class ClassesOfTheServer(pickle.Unpickler):
    def find_class(self, module, name):
        if module == "lerobot.async_inference.helpers":
            return type(name, (Seen,), {})
        return super().find_class(module, name)


class LeRobotLikeServer:
    """Answers with ``answer(observation)``: actions, or the bytes of a message, or it raises."""

    def __init__(self, answer, port=0):
        import grpc

        self.answer, self.seen, self.setup, self.readies = answer, [], None, 0
        methods = {
            "Ready": grpc.unary_unary_rpc_method_handler(self._ready),
            "SendPolicyInstructions": grpc.unary_unary_rpc_method_handler(self._instructions),
            "SendObservations": grpc.stream_unary_rpc_method_handler(self._observations),
            "GetActions": grpc.unary_unary_rpc_method_handler(self._actions),
        }
        self._server = grpc.server(ThreadPoolExecutor(4))
        self._server.add_generic_rpc_handlers(
            [grpc.method_handlers_generic_handler(SERVICE, methods)]
        )
        self.port = self._server.add_insecure_port(f"127.0.0.1:{port}")
        self._server.start()

    @property
    def address(self):
        return f"lerobot://127.0.0.1:{self.port}"

    def stop(self):
        self._server.stop(0).wait()

    def _ready(self, _request, _context):
        self.readies += 1
        return b""

    def _instructions(self, request, _context):
        self.setup = read(data_of(request))
        return b""

    def _observations(self, requests, _context):
        parts = [(each[1], data_of(each[2:])) for each in requests]
        self.states = [state for state, _ in parts]
        self.seen.append(read(b"".join(data for _, data in parts)))
        return b""

    def _actions(self, _request, _context):
        observation = self.seen[-1]
        answer = self.answer(observation)
        if isinstance(answer, bytes):
            return answer
        return field(action_pickle(observation.timestep, answer))


def data_of(message):
    """The bytes after the key and the length of a field."""
    at = 1
    while message[at] & 128:
        at += 1
    return message[at + 1 :]


def read(data):
    return ClassesOfTheServer(io.BytesIO(data)).load()


class OpenPiLikeServer:
    """Answers with ``answer(observation)``: a mapping, raw bytes, or a text for an error."""

    def __init__(self, answer, pack, unpack, port=0):
        from websockets.sync.server import serve

        self.answer, self.seen, self.connections = answer, [], 0
        self._pack, self._unpack = pack, unpack
        self._server = serve(self._serve, "127.0.0.1", port, compression=None, max_size=None)
        self.port = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def address(self):
        return f"openpi://127.0.0.1:{self.port}"

    def stop(self):
        self._server.shutdown()

    def _serve(self, socket):
        from websockets.exceptions import ConnectionClosed

        self.connections += 1
        socket.send(self._pack({"name": "test"}))
        with contextlib.suppress(ConnectionClosed):
            while True:
                self.seen.append(self._unpack(socket.recv()))
                answer = self.answer(self.seen[-1])
                if answer is None:
                    socket.close()
                    return
                socket.send(answer if isinstance(answer, str | bytes) else self._pack(answer))
