"""The live view's page: for who has its token, read-only, and hard to upset."""

import json
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from watched import Events, get, place, playback, short_run, snapshots

from bus_schema.messages import topics
from controller.manipulator_model import ManipulatorModel
from deploy.reports.live.figures import live_figures
from deploy.reports.live.frames import RunState
from deploy.reports.live.viewer import Viewer
from tests.waiting import HANG_S


@pytest.fixture
def viewer():
    made = Viewer(short_run().setup, "a test", foxglove_port=0)
    yield made
    made.close()


@pytest.fixture
def url(viewer):
    return viewer.places().split()[2]


def test_page_requires_its_token(url):
    status, headers, body = get(url)
    assert status == 200
    assert b"Error inside its funnel" in body
    assert "script-src 'self'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Access-Control-Allow-Origin"] is None
    for path in ("", "view.js", "plotly.js", "figures.json", "run.json", "events"):
        other = place(url, path) if path else url
        assert get(other + "x")[0] == 403
        assert get(other.partition("?")[0])[0] == 403
        assert get(other.partition("?")[0] + "?token=%ff%00é".replace("é", "%C3%A9"))[0] == 403


@pytest.mark.parametrize("path", ["view.js", "view.css", "plotly.js"])
def test_what_the_page_needs_is_there(url, path):
    status, headers, body = get(place(url, path))
    assert (status, headers["X-Content-Type-Options"]) == (200, "nosniff")
    assert len(body) > 100


def test_other_host_names_are_refused(url):
    for host in ("evil.example", "evil.example:80", "", "127.0.0.1", "localhost:1"):
        assert get(url, Host=host)[0] == 421
    port = urlsplit(url).port
    assert get(url, Host=f"localhost:{port}")[0] == 200
    asked, hosts = url.partition(str(port))[2], f"Host: 127.0.0.1:{port}\r\nHost: evil"
    twice = f"GET {asked} HTTP/1.1\r\n{hosts}\r\n\r\n"
    assert b" 421 " in printed_for(port, twice.encode())


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"])
def test_viewers_can_only_read(url, method):
    assert get(url, method)[0] == 405


def test_it_listens_on_this_machine_alone(viewer):
    assert viewer.page.server_address[0] == "127.0.0.1"


def printed_for(port, request):
    """What the server answers to raw bytes."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as client:
        client.sendall(request)
        client.shutdown(socket.SHUT_WR)
        answer = b""
        while chunk := client.recv(65536):
            answer += chunk
        return answer


@pytest.mark.parametrize("garbage", [
    b"", b"\0" * 5000, b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"\x16\x03\x01" + bytes(500),
    b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n", b"GET //[ HTTP/1.1\r\nHost: a\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 500 + b"\r\n", b"BREW / HTTP/1.1\r\n\r\n",
])  # fmt: skip
def test_garbage_gets_an_error_and_does_nothing(url, garbage):
    answer = printed_for(urlsplit(url).port, garbage)
    assert b" 200 " not in answer[:20]
    assert get(url)[0] == 200


def test_flood_of_connections_does_not_block_open_viewers(viewer, url):
    events = Events(url)
    idle = [socket.create_connection(("127.0.0.1", urlsplit(url).port)) for _ in range(100)]
    viewer.frames.add({"time_s": 1.0})
    assert next(events.frames()) == {"time_s": 1.0}
    for client in idle:
        client.close()
    events.close()


def test_a_page_that_is_frozen_holds_up_neither_the_viewer_nor_another_page(viewer, url):
    frozen, other = Events(url), Events(url)  # of which one is never read from
    large = "x" * 100_000
    for number in range(1, 201):  # far more than its socket takes; who waits for it hangs here
        viewer.frames.add({"time_s": float(number), "large": large})
    viewer.frames.end()
    *_, last = other.frames()
    assert last["time_s"] == 200.0
    viewer.close()  # without waiting
    frozen.close()
    other.close()


def test_frames_say_what_the_judge_says(viewer, url):
    run = short_run()
    data = run.data()
    events, source = Events(url), playback(run)
    server = threading.Thread(target=viewer.run, args=(source, lambda: source.is_over))
    server.start()
    frames = list(events.frames())
    server.join()
    assert len(frames) > 1
    assert frames[-1]["ticks"] == data.setup.ticks
    times_s = data.times_s(topics.PLANT_TRUTH)
    for frame in frames:
        tick = int(np.argmin(np.abs(times_s - frame["time_s"])))
        upper, lower = data.setup.funnel.bounds(times_s[tick : tick + 1])
        assert frame["error"] == pytest.approx(1e3 * data.true_errors_rad[tick])
        assert frame["upper"] == pytest.approx(1e3 * upper[0])
        assert frame["lower"] == pytest.approx(1e3 * lower[0])
        assert (frame["ticks"], frame["missed"]) == (tick, 0)
        assert (frame["mode"], frame["age_ms"]) == ("tracking", pytest.approx(1.0)) or tick < 2


class Burst:
    """All of a run at once, as after a stall, and nothing more."""

    def __init__(self, run):
        self._snapshots = list(snapshots(run))
        self.ticks = self._snapshots[-1].ticks

    @property
    def is_over(self):
        return not self._snapshots

    def receive(self, timeout_s):
        if self._snapshots:
            return self._snapshots.pop(0)
        time.sleep(0.01)
        return None

    def close(self):
        """Nothing is open."""


def shown(viewer):
    """Ticks of the newest frame."""
    _, frames = viewer.frames.after(0, 0.0)
    return frames[-1]["ticks"] if frames else 0


def test_what_came_too_soon_after_a_frame_is_shown_when_the_next_one_is_due(viewer):
    source, give_up_s = Burst(short_run()), time.monotonic() + HANG_S
    seen = []

    def is_over():
        seen.append(shown(viewer))  # while the run is under way
        return seen[-1] == source.ticks or time.monotonic() > give_up_s

    viewer.run(source, is_over)
    assert seen[-1] == source.ticks


def test_the_last_of_a_run_is_shown_at_its_end(viewer, monkeypatch):
    monkeypatch.setattr(
        "deploy.reports.live.viewer._FRAME_S", 1e6
    )  # none but the first would be due
    source = Burst(short_run())
    viewer.run(source, lambda: source.is_over)
    assert shown(viewer) == source.ticks


def test_run_that_is_over_is_shown_to_late_viewers(viewer, url):
    viewer.frames.add({"time_s": 1.0})
    viewer.frames.end()
    events = Events(url)
    assert list(events.frames()) == [{"time_s": 1.0}]
    events.close()


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_the_arm_ends_where_its_tip_is(name):
    run = short_run(scenario=name)
    model, state = ManipulatorModel(run.setup.robot), RunState(run.setup)
    truth, ends = run.data().tables["plant_truth"], 0
    for snapshot in snapshots(run):
        state.take(snapshot)
        frame = state.frame()
        if frame is not None:
            position = truth["position"][snapshot.ticks]
            tip = [frame["arm"][axis][-1] for axis in "xyz"]
            assert tip == pytest.approx(model.tip_position(position), abs=2e-5)
            ends += 1
    assert ends > 1


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_the_space_of_the_arm_is_a_cube_that_holds_what_it_is_to_do(name):
    run = short_run(scenario=name)
    scene = live_figures(run.setup)["arm"]["layout"]["scene"]
    assert scene["aspectmode"] == "manual"
    ends = np.array([scene[f"{axis}axis"]["range"] for axis in "xyz"])
    assert np.ptp(ends, axis=1) == pytest.approx(np.ptp(ends[0]))
    assert list(scene["aspectratio"].values()) == pytest.approx([1.0, 1.0, 1.0])
    state = RunState(run.setup)
    for snapshot in snapshots(run):
        state.take(snapshot)
        points = np.array([state.frame()["reference_arm"][axis] for axis in "xyz"], dtype=float)
        assert (np.nanmin(points, axis=1) > ends[:, 0]).all()
        assert (np.nanmax(points, axis=1) < ends[:, 1]).all()


def test_garbage_on_the_bus_is_not_shown():
    run = short_run()
    state, seen = RunState(run.setup), None
    for snapshot in snapshots(run):
        spoiled = [m._replace(payload=m.payload[:-9]) for m in snapshot.messages]
        state.take(snapshot._replace(messages=tuple(spoiled)))
        assert state.frame() is None
        seen = snapshot
    state.take(seen)
    frame = state.frame()
    assert json.dumps(frame, allow_nan=False)
