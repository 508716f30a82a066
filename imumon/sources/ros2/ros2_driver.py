"""Driver of IMU topics of ROS 2: the interface for other packages, through the registry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from imumon.sources.device import Check, Device, DeviceDriver, DeviceOptions, Observation

FILTER = "The messages do not say how the driver filters: see its settings."


TOPICS_CURE = (
    "check the messages of each topic: ros2 topic echo; a driver should stamp with the clock of the sensor"
)


class Ros2Driver(DeviceDriver):
    """`sensor_msgs/msg/Imu` on a topic."""

    scheme = "ros2"
    title = "ROS 2 topic"
    settings = frozenset({"listen_only"})  # it never writes

    def create(self, options: DeviceOptions) -> Device:
        from imumon.sources.ros2.ros2_device import Ros2Device

        return Ros2Device(options)

    def checks(self, observation: Observation, settings: Any) -> Iterator[Check]:
        """Yield what the graph shows of the publisher, and each doubt about the messages.

        That there is no topic, no router or no ROS 2 at all is the error of `open`.
        """
        info = observation.info
        yield _publisher(info.settings.get("publisher"))
        for remark in info.remarks:
            yield Check("topics", "warning", remark, TOPICS_CURE)
        if observation.bad_checksums:
            text = f"{observation.bad_checksums} messages are invalid or of another publisher"
            cure = "check the type of the topic, and that one node publishes it: ros2 topic info -v"
            yield Check("checksums", "warning", text, cure)

    def filter_advice(self, rate_hz: float | None) -> Mapping[str, str]:
        return {"unknown": FILTER}


def _publisher(nodes: str | None) -> Check:
    """Return the check of the nodes that publish the topic, instead of that of a model."""
    if nodes:
        return Check("model", "ok", f"published by {nodes}")
    text = "the publisher does not show in the graph"
    return Check("model", "warning", text, "a node of ROS 2 declares liveliness tokens: check its program")
