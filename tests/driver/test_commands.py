"""Commands hold their deadline whatever the driver, the server or the disk do."""

import contextlib
import gc
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from lidarnaut.driver.driver import Driver
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.logs import messages
from lidarnaut.envs.tasks.goals import known_map

pytest.importorskip("websockets")

from websockets.sync.server import serve

from lidarnaut.driver import drive, program, progress, rosbridge, viewer
from lidarnaut.driver.commands import ENDED, BridgeCommands, CommandProcess, CommandTopic, _Sender, local_time
from lidarnaut.driver.program import time_limited
from lidarnaut.driver.rosbridge import Rosbridge

from .recorder import Recorder
from .sessions import Drive, Topics
from .test_rosbridge import wait_for

STOP = (0.0, 0.0)


@pytest.fixture
def server():
    with contextlib.closing(Recorder()) as server:
        yield server


def answering(values):
    """Return a function that answers each call of a service."""

    def answer(data):
        fields = {"op": "service_response", "service": data.get("service"), "values": values, "result": True}
        return fields if data["op"] == "call_service" else None

    return answer


@contextlib.contextmanager
def connected(answer=lambda data: None, *, max_size=2**26, **how):
    with (
        contextlib.closing(Recorder(answer, max_size)) as server,
        contextlib.closing(Rosbridge(server.url, **how)) as bridge,
    ):
        yield server, bridge


@contextlib.contextmanager
def commanding(server, **how):
    with contextlib.closing(CommandProcess(CommandTopic(url=server.url, period=0.02, **how))) as commands:
        wait_for(lambda: not commands.error, 30.0)
        yield commands


def test_a_decision_is_repeated_until_it_is_too_old_and_then_the_robot_is_stopped(server):
    with commanding(server, timeout=1.0) as commands:
        time.sleep(0.1)
        assert not server.commands  # a robot that others drive is left alone until the first decision
        commands.send((0.1, 0.2), 7.0, local_time())
        wait_for(lambda: STOP in server.commands)
        first = server.commands.index(STOP)
        assert server.commands[:first] == [(0.1, 0.2)] * first
        assert 1 <= first <= 60
        commands.send((0.3, 0.0), 9.0, local_time() - 1.1)  # computed for too long
        wait_for(lambda: commands.send((0.2, 0.0), 9.0, local_time()) or (0.2, 0.0) in server.commands)
        assert (0.3, 0.0) not in server.commands
    assert server.commands[-3:] == [STOP] * 3
    assert server.advertised("/cmd_vel") == ["geometry_msgs/Twist"]
    assert {each["topic"] for each in server.data if "topic" in each} == {"/cmd_vel"}


def test_after_the_processes_have_stood_still_the_first_command_is_a_stop(server):
    with commanding(server, timeout=0.4) as commands:
        wait_for(lambda: commands.send((0.1, 0.2), 7.0, local_time()) or server.commands)
        os.kill(commands._process.pid, signal.SIGSTOP)
        commands.send((0.3, 0.3), 7.1, local_time())  # waits in the pipe
        time.sleep(0.6)
        count = len(server.commands)
        os.kill(commands._process.pid, signal.SIGCONT)
        wait_for(lambda: len(server.commands) > count + 5)
        assert set(server.commands[count:]) == {STOP}


def test_a_command_that_waits_to_be_sent_becomes_a_stop_when_its_time_is_over(server):
    sender = _Sender(CommandTopic(url=server.url, timeout=1.0))
    sender._newest = 0.1, 0.2, 7.0, local_time()
    with contextlib.closing(sender._bridge) as bridge:
        wait_for(lambda: server.advertised("/cmd_vel"))
        bridge._loop.call_soon_threadsafe(time.sleep, 1.2)  # the thread that sends stands still
        bridge.publish("/cmd_vel", sender._current)
        wait_for(lambda: server.commands)
    assert server.commands == [STOP]


def test_a_driver_that_is_killed_leaves_a_robot_that_stands(server):
    code = (
        "import os, signal, sys, time\n"
        "from lidarnaut.driver.commands import CommandProcess, CommandTopic, local_time\n"
        "commands = CommandProcess(CommandTopic(url=sys.argv[1], timeout=60.0))\n"
        "while commands.error: time.sleep(0.01)\n"
        "commands.send((0.5, 0.0), 1.0, local_time())\n"
        "time.sleep(0.3)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code, server.url], timeout=60.0, check=False)
    wait_for(lambda: server.commands[-3:] == [STOP] * 3)
    assert (0.5, 0.0) in server.commands


def test_the_process_that_sends_ignores_signals_of_the_group_and_its_end_is_noticed(server):
    with commanding(server) as commands:
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            commands._process.send_signal(each)
        wait_for(lambda: commands.send((0.1, 0.2), 7.0, local_time()) or server.commands)
        commands._process.kill()
        wait_for(lambda: commands.error == ENDED)
        with pytest.raises(RuntimeError, match=ENDED):
            commands.send((0.1, 0.2), 7.0, local_time())


CLASH = "Tried to register topic /cmd_vel with type {} but it is already established with type {}"


@pytest.mark.parametrize("stamped", [False, True])
@pytest.mark.parametrize("way", ["status", "service"])
def test_the_type_of_commands_follows_the_robot(way, stamped):
    kinds = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"]
    own, robots = kinds if not stamped else kinds[::-1]

    def answer(data):
        if way == "status" and data["op"] == "advertise" and data["type"] == own.replace("/msg", ""):
            return {"op": "status", "level": "error", "msg": CLASH.format(own, robots)}
        about = data.get("service"), data.get("args")
        is_asked = way == "service" and about == ("/rosapi/topic_type", {"topic": "/cmd_vel"})
        return answering({"type": robots})(data) if is_asked else None

    with contextlib.closing(Recorder(answer)) as server, commanding(server, stamped=stamped) as commands:
        wait_for(lambda: len(server.advertised("/cmd_vel")) == 2)
        wait_for(lambda: commands.send((0.1, 0.2), 7.25, local_time()) or (0.1, 0.2) in server.commands)
        last = next(each["msg"] for each in reversed(server.data) if each["op"] == "publish")
        assert ("twist" in last) != stamped
        if not stamped:
            assert last["header"]["frame_id"] == "base_footprint"
            assert last["header"]["stamp"]["secs"] == 7


def test_other_texts_do_not_change_the_type():
    commands = BridgeCommands(Topics(), CommandTopic())
    for text in ("", "geometry_msgs/msg/Pose", "type None", "geometry_msgs/msg/Twist", "geometry_msgs/TwistWithHeader"):
        assert not commands.use_type(text)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"topics": ["/lidar/scan", "/back\x1b[2J"]}, "/lidar/scan, /back\\x1b[2J"),
        ("Service /rosapi/topics_for_type does not exist", "Service /rosapi/topics_for_type does not exist"),
    ],
)
def test_topics_that_are_missing_since_their_subscription_are_named_with_those_of_the_same_type(
    values, said, caplog, monkeypatch
):
    monkeypatch.setattr(rosbridge, "PATIENCE", 1.0)
    with connected(answering(values), expected=["/scan"]) as (server, bridge):
        wait_for(lambda: not bridge.error)
        time.sleep(1.1)  # a policy that loads slowly subscribes late
        bridge.spin()
        bridge.subscribe("/scan", "sensor_msgs/msg/LaserScan", lambda message: None)
        wait_for(lambda: server._subscribers)
        bridge.spin()
        assert "no message" not in caplog.text
        wait_for(lambda: bridge.spin() or f"topics of type sensor_msgs/LaserScan: {said}" in caplog.text)
    assert "no message on /scan (sensor_msgs/LaserScan) for 1 s" in caplog.text


def test_a_warning_is_given_again_after_a_pause(monkeypatch):
    now, said = [100.0], []
    monkeypatch.setattr(rosbridge.time, "monotonic", lambda: now[0])
    say = rosbridge.said_once(said.append)
    for time_of_text in (0.0, 4.0, 8.0, 14.0, 15.0):
        now[0] = 100.0 + time_of_text
        say(f"goal {time_of_text} is far")
    assert said == ["goal 0.0 is far", "goal 14.0 is far"]
    for k in range(300):
        say("x" * k)
    assert len(said) == 101


def test_wrong_messages_are_said_once_whatever_their_numbers(caplog):
    def receive(message):
        raise ValueError(f"x is {message.x}")

    with contextlib.closing(Rosbridge("ws://127.0.0.1:9", is_ready=lambda: False)) as bridge:
        bridge.subscribe("/odom", "nav_msgs/msg/Odometry", receive)
        for k in range(100):
            wrong = {"op": "publish", "topic": "/odom", "msg": {"x": -1.5 * k}}
            told = {"op": "status", "level": "warning", "id": k}
            answer = {"op": "service_response", "service": "/rosapi/topic_type", "values": None, "result": False}
            info = {"op": "status", "level": "info", "msg": "hello"}
            for data in (wrong, told, told | {"msg": f"{k} \x1b[2J\n" + 10**5 * "x"}, answer, info, [k], k):
                bridge._receive(json.dumps(data))
            bridge._receive(b"\xff\xfe%d" % k)
    assert len(caplog.messages) <= 8
    assert max(map(len, caplog.messages)) < 400
    assert "hello" not in caplog.text
    assert not any("\x1b" in text or "\n" in text for text in caplog.messages)
    for expected in (
        "/odom: messages are dropped: ValueError: x is",
        "server says: None",
        r"server says: 0 \x1b[2J xx",
    ):
        assert caplog.text.count(expected) == 1


def test_long_and_many_texts_do_not_keep_the_state_of_the_connection_from_the_driver():
    def answer(data):
        if data["op"] == "publish":
            return {"op": "status", "level": "error", "msg": "\U0001f600" * 10**5 + str(len(server.data))}
        return None

    with contextlib.closing(Recorder(answer)) as server, commanding(server) as commands:
        commands.send((0.1, 0.0), 7.0, local_time())
        wait_for(lambda: len(server.commands) > 20)
        assert not commands.error
        server.sockets[0].close(4999, "")
        wait_for(lambda: commands.error)
        assert commands._thread.is_alive()
        wait_for(lambda: not commands.error)


def test_the_size_of_messages_that_wait_is_limited(monkeypatch):
    monkeypatch.setattr(rosbridge, "MAX_SIZE", 10**6)
    received = []
    with connected() as (server, bridge):
        bridge.subscribe("/scan", "x/msg/Y", lambda message: received.append(message.data[0]))
        wait_for(lambda: server._subscribers)
        for k in range(50):
            server.publish("/scan", {"data": [k, 10**5 * "x"]})
        wait_for(lambda: bridge._inbox and json.loads(bridge._inbox[-1])["msg"]["data"][0] == 49)
        assert bridge._inbox_size == sum(map(len, bridge._inbox)) <= 10**6
        bridge.spin()
        assert received == list(range(50 - len(received), 50))
        assert len(received) == 9
        assert bridge._inbox_size == 0


def test_a_server_that_closes_at_once_is_named_once(caplog, monkeypatch):
    caplog.set_level("INFO")
    monkeypatch.setattr(rosbridge, "RETRY_PERIOD", 0.01)
    connections = []

    def close(socket):
        connections.append(socket)
        socket.close(4999, f"bye\n\x1b[31m{time.monotonic()}")

    server = serve(close, "127.0.0.1", 0, compression=None)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with contextlib.closing(Rosbridge(f"ws://127.0.0.1:{server.socket.getsockname()[1]}")) as bridge:
        bridge.subscribe("/scan", "sensor_msgs/msg/LaserScan", lambda message: None)
        wait_for(lambda: len(connections) > 20)
    server.shutdown()
    gc.collect()
    said = [record.getMessage() for record in caplog.records if not record.name.startswith("websockets")]
    assert 1 <= len(said) <= 6, said
    assert "\x1b" not in "".join(said) + bridge.error
    assert "never retrieved" not in caplog.text


def test_publishing_never_waits_for_a_server_and_closing_ends_in_time():
    big = np.zeros(3_000_000, dtype=np.int8)
    with connected() as (server, bridge):
        bridge.advertise("/map", "nav_msgs/msg/OccupancyGrid", latch=True)
        wait_for(lambda: not bridge.error)
        begun = time.process_time()
        for _ in range(200):
            bridge.publish("/map", {"data": big})
        bridge.advertise("/other", "std_msgs/msg/Bool")
        for data in (object(), True):  # the first one is dropped
            bridge.publish("/other", {"data": data})
        assert sum(map(len, bridge._outgoing.values())) <= 5  # of 204
        assert time.process_time() - begun < 20.0  # of the newest ones alone
        wait_for(lambda: {each["topic"] for each in server.data if each["op"] == "publish"} == {"/map", "/other"}, 30.0)
        assert not bridge.error
    assert not bridge._thread.is_alive()
    sent = {each["topic"]: each["latch"] for each in server.data if each["op"] == "publish"}
    assert sent == {"/map": True, "/other": False}


@pytest.mark.parametrize("size", [10_000, 5_000_000])
def test_a_topic_that_is_too_large_for_the_server_is_left_out(size, caplog):
    with connected(max_size=10_000) as (server, bridge):
        bridge.advertise("/map", "nav_msgs/msg/OccupancyGrid", latch=True)
        bridge.advertise("/plan", "nav_msgs/msg/Path")
        wait_for(lambda: not bridge.error)
        bridge.publish("/map", {"data": np.zeros(size, dtype=np.int8)})
        wait_for(lambda: bridge.error)
        wait_for(lambda: not bridge.error)
        bridge.publish("/map", {"data": np.zeros(size, dtype=np.int8)})
        bridge.publish("/plan", {"poses": []})
        wait_for(lambda: any(each["op"] == "publish" and each["topic"] == "/plan" for each in list(server.data)))
        assert len(server.sockets) == 2
    assert "bytes are too large for the server" in caplog.text


def test_large_maps_are_shown_at_a_lower_resolution():
    data = np.full((2001, 3000), -1, dtype=np.int8)
    data[:1000, :1000], data[500, 700], data[2000, 2999] = 0, 100, 100
    shown = viewer.limited(OccupancyGrid(data, 0.05, (-7.0, 3.0)))
    assert shown.data.size <= viewer.MAX_CELLS
    assert shown.origin == (-7.0, 3.0)
    assert shown.resolution == pytest.approx(0.2)
    assert shown.data[500 // 4, 700 // 4] == shown.data[2000 // 4, 2999 // 4] == 100
    assert shown.data[10, 10] == 0
    assert shown.data[-1, 10] == -1
    small = OccupancyGrid(data[:10, :10], 0.05, (0.0, 0.0))
    copied = viewer.limited(small)
    assert not np.shares_memory(copied.data, small.data)
    np.testing.assert_array_equal(copied.data, small.data)


@pytest.mark.parametrize("wrong", ["false", 0.0, [False], None, 1])
def test_only_true_of_the_dead_mans_topic_permits_driving(wrong, monkeypatch):
    run = Drive(dead_man="/enable")
    run.step(3)
    assert run.session.reason == "/enable is not true"
    for data in (True, wrong):
        for _ in range(3):  # the first decision compiles
            run.topics.publish("/enable", SimpleNamespace(data=data))
            run.step()
        assert run.session.reason == ("" if data is True else "/enable is not true")
    run.topics.publish("/enable", SimpleNamespace(data=True))
    monkeypatch.setattr(drive, "DEAD_MAN_TIME", 0.0)
    run.step()
    assert run.session.reason == "/enable is not true"


def test_the_robot_stops_while_the_simulated_clock_stands_still():
    run = Drive(timeout=0.2)
    run.step(5)
    assert run.session.reason == ""
    time.sleep(0.25)
    assert run.session.step() == drive.STOP
    assert run.session.reason == "/clock stands still"
    run.topics.publish("/clock", messages.clock(run.session.time))
    assert run.session.step() == drive.STOP
    run.step(3)
    assert run.session.reason == ""


def test_failures_of_map_and_recording_are_said_once_and_end_neither_drive_nor_close(tmp_path, caplog, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(drive, "SAVE_PERIOD", 0.0)
    run, path = Drive(record=tmp_path / "drive.mcap", save_map=tmp_path / "map.yaml"), tmp_path / "map.yaml"
    run.step(5)
    assert path.exists()
    path.unlink()
    with monkeypatch.context() as patched:
        patched.setattr(drive, "save_map", fail)
        patched.setattr(run.session._recorder._writer, "write", fail)
        run.step(10)
    assert run.session.reason == ""
    assert [caplog.text.count(f"{name}: OSError: disk full") for name in ("recording", "map")] == [1, 1]
    with pytest.raises(RuntimeError, match=r"^recording: OSError: disk full$"):  # there is space for the map again
        run.session.close()
    assert path.exists()


@pytest.mark.parametrize("lidar_from_messages", [False, True])
def test_a_recording_is_not_replaced(tmp_path, lidar_from_messages):
    path = tmp_path / "drive.mcap"
    path.write_bytes(b"an hour of driving")
    with pytest.raises(ValueError, match=r"^record: .*drive.mcap exists; give another name or remove it$"):
        Drive(record=path, lidar_from_messages=lidar_from_messages)
    assert path.read_bytes() == b"an hour of driving"


def test_a_policy_that_fails_ends_the_drive_with_a_stop_and_what_can_be_written(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError("no space")

    run = Drive(record=tmp_path / "drive.mcap", save_map=tmp_path / "map.yaml")
    run.step(5)
    monkeypatch.setattr(run.session.driver, "_decide", lambda _: 1 / 0)
    monkeypatch.setattr(drive, "save_map", fail)
    with pytest.raises(ZeroDivisionError):
        run.run(5.0)
    with pytest.raises(RuntimeError, match="map: OSError: no space"):
        run.session.close()
    assert (tmp_path / "drive.mcap").exists()
    assert run.topics.last["/cmd_vel"]["linear"]["x"] == run.topics.last["/cmd_vel"]["angular"]["z"] == 0.0


def test_a_policy_that_hangs_is_interrupted(monkeypatch):
    run = Drive()
    run.step(5)
    monkeypatch.setattr(run.session.driver, "_decide", lambda _: time.sleep(60.0))
    with pytest.raises(TimeoutError, match=r"a decision takes over 0\.3 s"):
        run.run(60.0, watch=lambda: time_limited(0.3))
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_compiled_code_that_never_returns_ends_the_process():
    code = (
        "import numba\n"
        "from lidarnaut.driver.program import time_limited\n"
        "@numba.njit\n"
        "def spin(x):\n"
        "    while x > 0:\n"
        "        x += 1\n"
        "        if x > 100: x = 1\n"
        "    return x\n"
        "spin(0)\n"
        "with time_limited(0.5):\n"
        "    spin(1)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], timeout=60.0, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "Timeout" in run.stderr


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        (lambda self: sys.exit(0), "the policy fails: SystemExit: 0"),
        (lambda self: {}["a"], "the policy fails: KeyError: 'a'"),
        (lambda self: (_ for _ in ()).throw(OSError("no file")), "no file"),
    ],
)
def test_a_policy_that_exits_or_fails_is_named_and_is_not_done(failure, reason, server, monkeypatch):
    monkeypatch.setattr(drive.Session, "step", failure)
    with pytest.raises((RuntimeError, OSError), match=reason):
        drive.main(drive.Options(url=server.url, policy="pursuit", dry_run=True))


THREAD = """
import sys, threading, time
from lidarnaut.driver import drive, program
def main(options):
    threading.Thread(target=time.sleep, args=(60.0,)).start()
    sys.exit(3)
program.run_program(main, drive.Options)
"""


def test_a_thread_of_a_policy_does_not_keep_the_program():
    ended = subprocess.run([sys.executable, "-c", THREAD], capture_output=True, timeout=30.0)
    assert ended.returncode == 3, ended.stderr


@pytest.mark.parametrize("jump", [-50.0, 0.0, 50.0])
def test_decisions_keep_their_rate_after_the_clock_has_stood_still_or_jumped(jump, monkeypatch):
    run, is_over, local, steps = Drive(control_hz=10.0), threading.Event(), [100.0], [0, 0, 0]

    def clock(local):  # stands still from 110 to 130 s
        return local if local < 110.0 else 110.0 if local < 130.0 else local + jump

    def sleep(seconds):
        local[0] += seconds
        run.session._sim_time = clock(local[0])
        if local[0] > 140.0:
            is_over.set()

    def step():
        steps[(local[0] >= 110.0) + (local[0] >= 130.0)] += 1

    run.session._sim_time = clock(local[0])
    monkeypatch.setattr(drive.time, "monotonic", lambda: local[0])
    monkeypatch.setattr(drive.time, "sleep", sleep)
    monkeypatch.setattr(run.session, "step", step)
    run.session.run(is_over)
    assert steps == pytest.approx([100, 40, 100], abs=3)


def test_messages_that_waited_while_the_program_stood_still_are_old(monkeypatch):
    clock, now = program.Clock(), [50.0]
    monkeypatch.setattr(program.time, "monotonic", lambda: now[0])
    assert math.isnan(clock.time)
    for _ in range(100):
        now[0] += 0.1
        clock.note(now[0] + 1000.0 - 0.02)
    now[0] += 30.0
    for k in range(290):  # those of the pause, at once
        clock.note(now[0] + 970.0 + 0.1 * k)
    assert clock.time == pytest.approx(now[0] + 999.98)
    for _ in range(120):  # the network has become slower
        now[0] += 0.1
        clock.note(now[0] + 1000.0 - 0.3)
    assert clock.time == pytest.approx(now[0] + 999.7)


def test_a_drive_ends_by_itself(caplog):
    caplog.set_level("INFO")
    run = Drive(policy="mppi", goal=(0.0, 0.0))
    assert run.run(30.0)
    assert "done: reached" in caplog.text
    run = Drive(time_limit=1.0)
    assert run.run(30.0) is False
    assert "not done within 1 s" in caplog.text
    assert 1.0 < run.session._progress.elapsed < 12.0  # the clock may step by ten seconds
    run = Drive()
    run.step(5)
    run.session.driver._policy.end_reason = "nothing_left"
    assert run.run(60.0)
    assert "done: nothing_left" in caplog.text
    assert run.robot.time < 40.0


def test_jumps_of_the_clock_do_not_count_for_the_time_limit_and_a_stop_whose_numbers_change_is_said_once(caplog):
    caplog.set_level("INFO")
    run = Drive()
    run.step(6)
    progress, now = run.session._progress, run.session.time
    before = progress.elapsed
    assert before == pytest.approx(0.5)
    for step in (0.1, 1000.0, -500.0, 0.1):
        now += step
        progress.note(run.session.driver, now)
    assert progress.elapsed == pytest.approx(before + 0.2)
    run.topics.receivers.pop("/clock")
    run.step(30)
    assert caplog.text.count("stopped: the clock of the messages is 1.") == 1


def test_the_state_is_said_every_ten_seconds(caplog):
    caplog.set_level("INFO")
    run = Drive(policy="mppi", goal=(2.0, 0.5))
    run.session.driver.imu(np.nan, 1.0)
    run.step(150)
    lines = [record.getMessage() for record in caplog.records if "m2" in record.getMessage()]
    assert len(lines) == 2
    assert "m to the goal 2 0.5" in lines[1]
    assert "1 dropped: imu that is not finite" in lines[1]


def test_a_pose_that_is_not_confirmed_is_not_said(caplog, monkeypatch):
    caplog.set_level("INFO")
    monkeypatch.setattr(progress, "REPORT_PERIOD", 0.0)
    robot = SimulatedRobot("turtlebot3_house", "turtlebot3_burger", rate=10.0, start="spawn")
    run = Drive(robot=robot, policy="pursuit", goal=(3.0, 1.0), map=known_map(robot.area))
    said = []
    for _ in range(400):
        caplog.clear()
        run.step()
        belief, line = run.session.driver.belief, next(r.getMessage() for r in caplog.records if "m2" in r.getMessage())
        said.append((belief.is_lost, len(belief.hypotheses), line))
        if len(said) > 2 and not belief.is_lost:
            break
    assert said[0][0]
    assert not said[-1][0]
    for is_lost, count, line in said:
        assert ("not localized yet" in line) == is_lost == (" at " not in line) == ("to the goal" not in line)
        assert (f"({count} hypotheses)" in line) == (is_lost and count > 1)


@pytest.mark.parametrize("count", [0, 2])
def test_a_lost_robot_has_reached_no_goal(count, caplog, monkeypatch):
    caplog.set_level("INFO")
    monkeypatch.setattr(progress, "REPORT_PERIOD", 0.0)
    run = Drive(goal=(0.0, 0.0))
    run.step(2)
    driver = run.session.driver
    assert driver.reason == "reached"
    driver.belief.is_lost, driver.belief.rivals = True, np.ones((count, 4))
    assert driver._why_stopped(run.session.time) == ""
    caplog.clear()
    run.session._progress.note(driver, run.session.time)
    assert caplog.messages[-1].split(", ")[1:] == ["lost (3 hypotheses)" if count else "lost"]


def test_a_driver_is_imported_on_first_use():
    from lidarnaut import driver

    assert driver.Driver is Driver
    with pytest.raises(AttributeError, match="Drivers"):
        driver.Drivers  # noqa: B018
