"""zenoh-ros2-sdk, another implementation of a ROS 2 node over Zenoh, in a process of its own.

    python ros2_sdk.py publish HOST PORT TOPIC
    python ros2_sdk.py info HOST PORT TOPIC

``publish`` sends 400 messages at 200 Hz with the sample number as angular_velocity.x. ``info`` prints what
`ros2 topic list` and `ros2 topic info` show, as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

IMU_HASH = "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
COUNT, RATE_HZ = 400, 200.0


def publish(topic: str, where: dict[str, Any]) -> None:
    import numpy as np
    from rosbags.typesys import Stores, get_typestore
    from zenoh_ros2_sdk import ROS2Publisher

    definition, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    made = ROS2Publisher(
        topic, "sensor_msgs/msg/Imu", definition, node_name="sdk_driver", type_hash=IMU_HASH, **where
    )
    types = made.session_mgr.store.types
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    print("ready", flush=True)
    sys.stdin.readline()
    while not made.pub.matching_status.matching:  # the subscription is on its way
        time.sleep(0.01)
    begin = time.time()
    for k in range(COUNT):
        stamp_ns = 1_700_000_000_000_000_000 + round(k * 1e9 / RATE_HZ)
        stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        made.publish(
            header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="sdk"),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=zeros,
            angular_velocity=vector(x=float(k), y=0.25, z=-0.5),
            angular_velocity_covariance=zeros,
            linear_acceleration=vector(x=0.0, y=0.0, z=9.8125 + k),
            linear_acceleration_covariance=zeros,
        )
        time.sleep(max(0.0, begin + (k + 1) / RATE_HZ - time.time()))
    print("sent", flush=True)
    sys.stdin.readline()


def info(topic: str, where: dict[str, Any]) -> None:
    from zenoh_ros2_sdk import discovery

    end, ends, topics = time.monotonic() + 60.0, [], {}
    while len(ends) < 2 and time.monotonic() < end:  # a publisher and a subscription
        topics = discovery.get_topic_names_and_types(**where)
        found = discovery.get_topic_info(topic, verbose=True, **where)
        ends = [] if found is None else [*found.publishers, *found.subscribers]
    print(json.dumps({"topics": dict(topics), "nodes": [each.node_name for each in ends]}), flush=True)


if __name__ == "__main__":
    where = {"router_ip": sys.argv[2], "router_port": int(sys.argv[3])}
    if sys.argv[1] == "publish":
        publish(sys.argv[4], where)
    else:
        info(sys.argv[4], where)
