import contextlib
import itertools
import json
import logging
import math
import re
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from lidarnaut.envs.simulation import Twist

pytest.importorskip("websockets")

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from lidarnaut.driver import serve, server
from lidarnaut.driver.server import RosbridgeServer

BOOL, SCAN = "std_msgs/msg/Bool", "sensor_msgs/msg/LaserScan"


class Peer:
    """Client that sends and receives JSON."""

    def __init__(self, socket):
        self.socket = socket

    def send(self, op, **fields):
        self.socket.send(json.dumps({"op": op} | fields))

    def receive(self):
        return json.loads(self.socket.recv(timeout=10.0))

    def call(self, service, **args):
        self.send("call_service", service=service, args=args, id=7)
        answer = self.receive()
        assert (answer.pop("op"), answer.pop("id"), answer.pop("service")) == ("service_response", 7, service)
        return answer

    def wait(self):
        """Return after the server has taken all that was sent; nothing else may have come."""
        self.call("/rosapi/topics")


@pytest.fixture
def peers():
    with contextlib.ExitStack() as held:
        bridge = held.enter_context(contextlib.closing(RosbridgeServer()))

        def join(**how):
            return Peer(held.enter_context(connect(bridge.url, compression=None, max_size=None, **how)))

        yield join


def test_messages_reach_subscribers_under_their_names_with_null_for_what_is_not_finite(peers):
    one, other = peers(), peers()
    other.send("subscribe", topic="scan", type=SCAN, id="mine", compression="png", queue_length=1)
    other.send("subscribe", topic="/scan", type="sensor_msgs/LaserScan")
    other.wait()
    one.send("advertise", topic="/scan", type="sensor_msgs/LaserScan")
    message = {"stamp": {"secs": 5, "nsecs": 2}, "text": '"secs":', "ranges": [1.5, math.inf, -math.inf, math.nan, 2]}
    one.send("publish", topic="/scan", msg=message)
    passed = {"stamp": {"sec": 5, "nanosec": 2}, "text": '"secs":', "ranges": [1.5, None, None, None, 2]}
    received = [other.receive() for _ in range(2)]
    assert received == [{"op": "publish", "topic": topic, "msg": passed} for topic in ("scan", "/scan")]
    one.wait()


def test_latched_messages_of_each_publisher_reach_later_subscribers(peers):
    one, two, late = peers(), peers(), peers()
    for peer, how in ((one, {"latch": True}), (two, {})):
        peer.send("advertise", topic="/tf_static", type=BOOL, **how)
    late.send("subscribe", topic="/tf_static", type=BOOL)
    late.wait()
    for data in (1, 2):
        one.send("publish", topic="/tf_static", msg={"data": data})
        assert late.receive()["msg"] == {"data": data}
    two.send("publish", topic="/tf_static", msg={"data": 3}, latch=True)
    assert late.receive()["msg"] == {"data": 3}
    for left in ([2, 3], [2]):
        late.send("unsubscribe", topic="/tf_static")
        late.send("subscribe", topic="/tf_static", type=BOOL, queue_length=1)
        assert [late.receive()["msg"]["data"] for _ in left] == left
        late.wait()
        two.send("unadvertise", topic="/tf_static")
        two.wait()
    late.send("unsubscribe", topic="/tf_static")
    one.socket.close()
    end = time.monotonic() + 10.0
    while late.call("/rosapi/topics")["values"]["topics"]:
        assert time.monotonic() < end
    late.send("subscribe", topic="/tf_static", type=BOOL)
    late.wait()


def test_a_topic_has_one_type_and_both_versions_of_ros_name_it(peers, caplog):
    one, other = peers(), peers()
    one.send("subscribe", topic="/cmd_vel", type="geometry_msgs/TwistStamped")
    one.wait()
    caplog.set_level(logging.INFO)
    told = (
        "Tried to register topic /cmd_vel with type geometry_msgs/msg/Twist but it is already established with type "
        "geometry_msgs/msg/TwistStamped"
    )
    for op in ("advertise", "subscribe"):
        other.send(op, topic="/cmd_vel", type="geometry_msgs/Twist", id=f"{op}:1")
        assert other.receive() == {"op": "status", "level": "error", "msg": f"{op}: {told}", "id": f"{op}:1"}
    assert told in caplog.text
    other.send("set_level", level="none")
    other.send("advertise", topic="/cmd_vel", type="geometry_msgs/Twist")
    other.send("advertise", topic="/cmd_vel", type="geometry_msgs/msg/TwistStamped")
    other.send("publish", topic="/cmd_vel", msg={"a": 1})
    assert one.receive()["msg"] == {"a": 1}
    other.wait()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "message: Expecting"),
        ("[]", "message: expected an object with an op of advertise, "),
        (b"\xff\x00", "message: "),
        ("[" * 100_000, "message: "),
        ('{"op": ["a"]}', "expected an object with an op"),
        ('{"op": "fly\\u001b[2J"}', r"fly\\x1b\[2J: expected an object with an op"),
        ('{"op": "advertise", "type": "std_msgs/Bool"}', "advertise: expected a field topic of type str, got None"),
        ('{"op": "advertise", "topic": "/a", "type": "Bool"}', "advertise: Bool is not a valid type string"),
        ('{"op": "subscribe", "topic": "/a"}', "subscribe: Cannot infer topic type for topic /a as it is not yet"),
        ('{"op": "subscribe", "topic": "/a", "type": "a/B", "throttle_rate": []}', "subscribe: "),
        ('{"op": "publish", "topic": "/a", "msg": {}}', "publish: Cannot infer topic type for topic /a"),
        ('{"op": "publish", "topic": "/b", "msg": 5}', "publish: expected a field msg of type dict, got 5"),
        ('{"op": "publish", "topic": "/b", "msg": {"a": 1e999}}', "publish: Out of range float"),
        ('{"op": "call_service", "service": "/rosapi/topic_type", "args": 5}', "call_service: "),
        ('{"op": "unsubscribe", "topic": null}', "unsubscribe: expected a field topic"),
        (json.dumps({"op": "advertise", "topic": "/a", "type": "x" * 10_000}), "advertise: x{489}$"),
    ],
)
def test_wrong_messages_are_answered_and_the_connection_stays(peers, text, told):
    peer = peers()
    peer.send("subscribe", topic="/b", type=BOOL)
    peer.socket.send(text)
    answer = peer.receive()
    assert (answer["op"], answer["level"]) == ("status", "error")
    assert re.match(f".*{told}", answer["msg"]), answer
    assert peer.call("/rosapi/topics")["values"] == {"topics": ["/b"], "types": [BOOL]}


def test_services_tell_topics_and_types(peers):
    peer = peers()
    peer.send("advertise", topic="odom", type="nav_msgs/Odometry")
    peer.send("subscribe", topic="/enable", type=BOOL)
    topics = {"topics": ["/odom", "/enable"], "types": ["nav_msgs/msg/Odometry", BOOL]}
    assert peer.call("rosapi/topics") == {"values": topics, "result": True}
    for topic, kind in (("/odom", "nav_msgs/msg/Odometry"), ("enable", BOOL), ("/nothing", "")):
        assert peer.call("/rosapi/topic_type", topic=topic)["values"] == {"type": kind}
    for kind in ("nav_msgs/Odometry", "nav_msgs/msg/Odometry"):
        assert peer.call("/rosapi/topics_for_type", type=kind)["values"] == {"topics": ["/odom"]}
    assert peer.call("/rosapi/nodes") == {"values": "Service /rosapi/nodes does not exist", "result": False}
    peer.send("unadvertise", topic="odom")
    assert peer.call("/rosapi/topics")["values"]["topics"] == ["/enable"]


def test_subscriptions_end_by_their_ids_and_keep_their_rates(peers):
    peer = peers()
    for each in ("a", "b"):
        peer.send("subscribe", topic="/enable", type=BOOL, id=each)
    peer.send("subscribe", topic="enable", type=BOOL, throttle_rate=100_000)
    for ended in ("a", "b"):
        peer.send("publish", topic="/enable", msg={"ended": ended})
        assert peer.receive() == {"op": "publish", "topic": "/enable", "msg": {"ended": ended}}
        if ended == "a":
            assert peer.receive()["topic"] == "enable"
        peer.send("unsubscribe", topic="/enable", id=ended)
    peer.send("publish", topic="/enable", msg={})
    peer.wait()


def test_a_client_that_takes_nothing_holds_up_no_other_and_is_disconnected(peers, monkeypatch, caplog):
    monkeypatch.setattr(server, "MAX_STALL", 0.5)
    frozen, other = peers(max_queue=1), peers()
    for peer in (frozen, other):
        peer.send("subscribe", topic="/map", type=BOOL)
    frozen.wait()
    end = time.monotonic() + 30.0
    for k in itertools.count():
        other.send("publish", topic="/map", msg={"k": k, "data": "x" * 200_000})
        assert other.receive()["msg"]["k"] == k
        if "takes no messages: disconnected" in caplog.text or time.monotonic() > end:
            break
    with contextlib.suppress(ConnectionClosed):
        while True:
            frozen.receive()
    assert time.monotonic() < end


@pytest.mark.parametrize("limits", [{"QUEUE": 5}, {"MAX_BYTES": 1_100_000}])
def test_the_newest_messages_wait_for_a_slow_client(peers, monkeypatch, limits):
    for name, value in limits.items():
        monkeypatch.setattr(server, name, value)
    slow, other = peers(max_queue=1), peers()
    slow.send("subscribe", topic="/map", type=BOOL)
    slow.wait()
    for k in range(150):
        other.send("publish", topic="/map", msg={"k": k, "data": "x" * 200_000})
        other.wait()
    received = [slow.receive()["msg"]["k"]]
    while received[-1] < 149:
        received.append(slow.receive()["msg"]["k"])
    assert received[-5:] == [145, 146, 147, 148, 149]
    assert received[-6] < 140


def test_messages_that_are_too_large_end_the_connection_of_their_sender_alone(peers, monkeypatch):
    monkeypatch.setattr(server, "MAX_BYTES", 1000)
    with contextlib.closing(RosbridgeServer()) as bridge, connect(bridge.url) as first, connect(bridge.url) as second:
        one, other = Peer(first), Peer(second)
        one.send("publish", topic="/a", msg={"data": "x" * 1000})
        with pytest.raises(ConnectionClosed, match="1009"):
            one.receive()
        other.wait()
        with pytest.raises(OSError, match=f"port {bridge.port} of 127.0.0.1 cannot be opened: .*in use"):
            RosbridgeServer(bridge.port)
    for port, address, told in ((70_000, "127.0.0.1", "0-65535"), (0, "nobody.invalid", "")):
        with pytest.raises(OSError, match=f"port {port} of {address} cannot be opened: .*{told}"):
            RosbridgeServer(port, address)


def twist(v, w):
    return SimpleNamespace(linear=SimpleNamespace(x=v), angular=SimpleNamespace(z=w))


@pytest.mark.parametrize("stamped", [False, True])
def test_wrong_commands_are_dropped_with_one_warning(stamped, caplog):
    bridge = SimpleNamespace(advertise=lambda *_, **__: None, subscribe=lambda *_: None, publish=lambda *_: None)
    served = serve.Server(serve.Options(world="turtlebot3_world", stamped=stamped), bridge)
    wrap = (lambda message: SimpleNamespace(twist=message)) if stamped else (lambda message: message)
    served._receive(wrap(twist(0.125, -1)))
    for wrong in (math.nan, math.inf, None, "1", [1.0], 10**400, 1e300):
        served._receive(wrap(twist(wrong, 0.0)))
        served._receive(wrap(twist(0.0, wrong)))
    for message in (wrap(SimpleNamespace()), wrap(None), None, 5, [], *([twist(0.0, 0.0)] if stamped else [])):
        served._receive(message)
    assert served._command == Twist(0.125, -1.0)
    assert len(caplog.records) == 1
    assert "/cmd_vel: wrong commands are dropped: " in caplog.text
    served.step()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"port": 9090, "url": "ws://localhost:9090"}, "url is of another server, port of one that is opened"),
        ({"bind": "0.0.0.0"}, "bind needs a port"),
        ({"rate": 0.0}, "rate must be positive"),
    ],
)
def test_wrong_options_of_the_simulated_robot_are_refused(options, told):
    with pytest.raises(ValueError, match=told):
        serve.main(serve.Options(**options))


def test_ctrl_c_ends_the_simulated_robot_and_closes_its_port(monkeypatch):
    urls = []

    def run(self, _):
        urls.append(self._bridge.url)
        raise KeyboardInterrupt

    monkeypatch.setattr(serve.Server, "run", run)
    serve.main(serve.Options(world="turtlebot3_world", port=0))
    with pytest.raises(ConnectionRefusedError), connect(urls[0]):
        pass


def test_a_robot_at_a_port_drives_until_the_terminal_is_closed():
    command = [sys.executable, "-m", "lidarnaut.driver.serve", "--port", "0", "--world", "turtlebot3_world"]
    how = {"stderr": subprocess.PIPE, "text": True, "preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL)}
    with subprocess.Popen(command, **how) as program:  # also if the tests are run by `nohup`
        watch = threading.Timer(120.0, program.kill)
        watch.start()
        url = next(line.split()[-1] for line in program.stderr if "start Pose" in line)
        with connect(url, compression=None) as socket:
            peer, x = Peer(socket), 0.0
            peer.send("subscribe", topic="/odom", type="nav_msgs/Odometry")
            peer.send("advertise", topic="/cmd_vel", type="geometry_msgs/Twist")
            while x < 0.05:
                x = peer.receive()["msg"]["pose"]["pose"]["position"]["x"]
                for speed in (math.nan, 0.2):
                    peer.send("publish", topic="/cmd_vel", msg={"linear": {"x": speed}, "angular": {"z": 0.0}})
        program.send_signal(signal.SIGHUP)
        assert program.wait() == 0
        assert "Traceback" not in program.stderr.read()
        watch.cancel()
