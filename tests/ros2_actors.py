"""Parts of a ROS 2 system over Zenoh: a router, and publishers of an IMU, each with a session of its own.

The router has the settings of rmw_zenohd (DEFAULT_RMW_ZENOH_ROUTER_CONFIG.json5). A publisher is a peer of it with the
settings of a ROS 2 session: it takes part in the gossip and sends its data to others directly. It is written without
imumon, from ROS2.md.
"""

from __future__ import annotations

import random
import struct
import threading
import time
from typing import Any

import zenoh
from zenoh_sessions import opened

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


def router(endpoint: str) -> zenoh.Session:
    return opened({**ROUTER, "listen/endpoints": [endpoint]})


def imu_payload(stamp_ns: int, gyro: list[float], accel: list[float], frame: bytes = b"imu_link") -> bytes:
    """A sensor_msgs/msg/Imu as ROS2.md describes it."""
    stamp = divmod(stamp_ns, 10**9)
    head = struct.pack("<4siII", b"\0\1\0\0", *stamp, len(frame) + 1) + frame + b"\0"
    head += bytes(-(len(head) - 4) % 8)
    orientation = [0.0, 0.0, 0.0, 1.0, -1.0, *[0.0] * 8]
    return head + struct.pack("<37d", *orientation, *gyro, *[0.0] * 9, *accel, *[0.0] * 9)


class Driver:
    """A node that publishes white noise of 1e-3 rad/s and 1e-2 m/s^2 at rest, from a thread.

    Attributes
    ----------
    hide, drop : so many of the next messages are never published, or lost on the way.
    """

    def __init__(
        self,
        endpoint: str,
        topic: str,
        rate_hz: float,
        *,
        hash: str = IMU_HASH,
        domain: int = 0,
        tokens: bool = True,
        paused: bool = False,
    ) -> None:
        self.hide = self.drop = 0
        self._session = opened({**PEER, "connect/endpoints": [endpoint]})
        kind = f"sensor_msgs::msg::dds_::Imu_/{hash}"
        self._publisher = self._session.declare_publisher(f"{domain}/{topic.strip('/')}/{kind}")
        node = f"@ros2_lv/{domain}/{self._session.zid()}/0"
        end = f"{node}/10/MP/%/%/driver/{topic.replace('/', '%')}/{kind}/::,7:,:,:,,"
        self._names = [f"{node}/0/NN/%/%/driver", end] if tokens else []
        self._gid, self._sequence = random.randbytes(16), 0
        self._ending, self._lock = threading.Event(), threading.Lock()
        self.set_rate(rate_hz)
        self._paused, self._tokens = paused, list[Any]()
        self._declare()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Driver:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        if not self._ending.is_set():
            self._ending.set()
            self._thread.join()
            self._session.close()

    def set_rate(self, rate_hz: float) -> None:
        with self._lock:
            self._begin, self._index, self._rate_hz = time.time_ns(), 0, rate_hz

    def unplug(self) -> None:
        self._paused = True
        for token in self._tokens:
            token.undeclare()

    def replug(self) -> None:
        """Continue with the samples that are due by now."""
        with self._lock:
            self._index = int((time.time_ns() - self._begin) * 1e-9 * self._rate_hz)
        self._declare()
        self._paused = False

    def _declare(self) -> None:
        self._tokens = [self._session.liveliness().declare_token(name) for name in self._names]

    def _run(self) -> None:
        while not self._ending.is_set():
            with self._lock:
                due_ns = self._begin + round(self._index * 1e9 / self._rate_hz)
                if ready := not self._paused and time.time_ns() >= due_ns:
                    self._index += 1
            if ready:
                self._send(due_ns)
            else:
                self._ending.wait(0.05 if self._paused else max(0.0, (due_ns - time.time_ns()) * 1e-9))

    def _send(self, stamp_ns: int) -> None:
        if self.hide:
            self.hide -= 1
            return
        self._sequence += 1
        if self.drop:
            self.drop -= 1
            return
        gyro = [random.gauss(0.0, 1e-3) for _ in range(3)]
        accel = [random.gauss(0.0, 1e-2) for _ in range(2)] + [random.gauss(9.81, 1e-2)]
        attachment = struct.pack("<qqB16s", self._sequence, time.time_ns(), 16, self._gid)
        self._publisher.put(imu_payload(stamp_ns, gyro, accel), attachment=attachment)
