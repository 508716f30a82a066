"""Parts of a ROS 2 system over Zenoh, in processes of their own: a router, and publishers of an IMU.

The router is a Zenoh session with the settings of rmw_zenohd (DEFAULT_RMW_ZENOH_ROUTER_CONFIG.json5). A publisher
is a peer of it with the settings of a ROS 2 session: it takes part in the gossip and sends its data to others
directly. It is written without imumon, from ROS2.md. Each process reads commands on standard input.

    python ros2_actors.py router ENDPOINT
    python ros2_actors.py publish ENDPOINT TOPIC RATE [key=value ...]
"""

from __future__ import annotations

import json
import random
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import IO, Any

from free_ports import free_port

IMU_HASH = "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
ROUTER = {
    "mode": "router",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": {"router": True, "peer": True, "client": True},
    "routing/router/peers_failover_brokering": False,
    "transport/shared_memory/enabled": False,
}
PEER = {
    "mode": "peer",
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "scouting/gossip/autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
    "timestamping/enabled": {"router": True, "peer": True, "client": True},
    "transport/shared_memory/enabled": False,
}


def free_router() -> str:
    """Endpoint on which a router can listen."""
    return f"tcp/127.0.0.1:{free_port()}"


class Actor:
    """One of these processes; a context manager that ends it."""

    def __init__(self, *words: object) -> None:
        command = [sys.executable, str(Path(__file__)), *map(str, words)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._out.readline() == "ready\n"

    @property
    def _out(self) -> IO[str]:
        assert self.process.stdout is not None
        return self.process.stdout

    def ask(self, command: str) -> str:
        """Send a command; return its answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{command}\n")
        self.process.stdin.flush()
        return self._out.readline().strip()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def __enter__(self) -> Actor:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self._out.close()
        assert self.process.stdin is not None
        self.process.stdin.close()


def router(endpoint: str) -> Actor:
    return Actor("router", endpoint)


def publisher(endpoint: str, topic: str, rate_hz: float, **options: object) -> Actor:
    words = [f"{name}={value}" for name, value in options.items()]
    return Actor("publish", endpoint, topic, rate_hz, *words)


def imu_payload(stamp_ns: int, gyro: list[float], accel: list[float], frame: bytes = b"imu_link") -> bytes:
    """A sensor_msgs/msg/Imu as ROS2.md describes it."""
    head = (
        struct.pack("<4siII", b"\0\1\0\0", stamp_ns // 10**9, stamp_ns % 10**9, len(frame) + 1)
        + frame
        + b"\0"
    )
    head += bytes(-(len(head) - 4) % 8)
    orientation = [0.0, 0.0, 0.0, 1.0, -1.0, *[0.0] * 8]
    return head + struct.pack("<37d", *orientation, *gyro, *[0.0] * 9, *accel, *[0.0] * 9)


# ---------------------------------------------------------------------- in the processes


def _open(values: dict[str, Any]) -> Any:
    import zenoh

    config = zenoh.Config()
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def _run_router(endpoint: str) -> None:
    session = _open({**ROUTER, "listen/endpoints": [endpoint]})
    print("ready", flush=True)
    sys.stdin.read()
    session.close()


class _Publisher:
    """White noise of 1e-3 rad/s and 1e-2 m/s^2 at rest, until told otherwise."""

    def __init__(self, endpoint: str, topic: str, rate_hz: float, options: dict[str, str]) -> None:
        self.topic, self.rate_hz = topic, rate_hz
        self.session = _open({**PEER, "connect/endpoints": [endpoint]})
        self.hash = options.get("hash", IMU_HASH)
        self.domain, self.node = options.get("domain", "0"), options.get("node", "driver")
        self.tokens: list[Any] = []
        self.gid = random.randbytes(16)
        self.sequence, self.index, self.begin = 0, 0, time.time_ns()
        self.hide = 0
        self.drop = 0
        key = f"{self.domain}/{topic.strip('/')}/sensor_msgs::msg::dds_::Imu_/{self.hash}"
        self.publisher = self.session.declare_publisher(key)
        if options.get("tokens", "yes") == "yes":
            self.declare()

    def declare(self) -> None:
        start = f"@ros2_lv/{self.domain}/{self.session.zid()}/0"
        tail = f"{self.topic.replace('/', '%')}/sensor_msgs::msg::dds_::Imu_/{self.hash}/::,7:,:,:,,"
        live = self.session.liveliness()
        self.tokens = [
            live.declare_token(f"{start}/0/NN/%/%/{self.node}"),
            live.declare_token(f"{start}/10/MP/%/%/{self.node}/{tail}"),
        ]

    def send(self) -> None:
        """Publish the next sample; `drop` are lost on the way, `hide` are never published."""
        stamp = self.begin + round(self.index / self.rate_hz * 1e9)
        self.index += 1
        if self.hide:
            self.hide -= 1
            return
        self.sequence += 1
        if self.drop:
            self.drop -= 1
            return
        gyro = [random.gauss(0.0, 1e-3) for _ in range(3)]
        accel = [random.gauss(0.0, 1e-2) for _ in range(2)] + [random.gauss(9.81, 1e-2)]
        attachment = struct.pack("<qqB16s", self.sequence, time.time_ns(), 16, self.gid)
        self.publisher.put(imu_payload(stamp, gyro, accel), attachment=attachment)


def _run_publisher(endpoint: str, topic: str, rate_hz: float, options: dict[str, str]) -> None:
    import select

    made = _Publisher(endpoint, topic, rate_hz, options)
    print("ready", flush=True)
    paused = options.get("paused") == "yes"
    while True:
        due = made.begin + made.index / made.rate_hz * 1e9
        wait = 0.5 if paused else max(0.0, (due - time.time_ns()) * 1e-9)
        if select.select([sys.stdin], [], [], wait)[0]:
            name, _, value = sys.stdin.readline().strip().partition(" ")
            if name == "":
                break
            if name == "unplug":
                paused = True
                for token in made.tokens:
                    token.undeclare()
            elif name == "replug":
                made.declare()
                paused = False
                made.index = int((time.time_ns() - made.begin) * 1e-9 * made.rate_hz)
            elif name in ("hide", "drop"):
                setattr(made, name, int(value))
            elif name == "rate":
                made.begin, made.index, made.rate_hz = time.time_ns(), 0, float(value)
            elif name == "pause":
                paused = True
            elif name == "heard":
                print(int(made.publisher.matching_status.matching), flush=True)
                continue
            print(made.sequence, flush=True)
        elif not paused:
            made.send()
    made.session.close()


if __name__ == "__main__":
    if sys.argv[1] == "router":
        _run_router(sys.argv[2])
    else:
        _run_publisher(
            sys.argv[2], sys.argv[3], float(sys.argv[4]), dict(word.split("=", 1) for word in sys.argv[5:])
        )
