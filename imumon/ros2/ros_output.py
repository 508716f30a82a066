"""What the daemon publishes in a ROS 2 system: its reports as diagnostics, and messages with measured covariances.

A thread opens the node and publishes the newest report; the daemon never waits for it. While the system is not there,
it tries again. A second thread passes on each message of the input topic as soon as it arrives, with the covariances
of the newest report. What cannot be measured stays as it is in the input.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from imumon.model.report import Report
from imumon.ros2.diagnostics import DIAGNOSTICS, diagnostics, sample_variances
from imumon.ros2.node import RosError, RosNode
from imumon.ros2.ros_messages import DIAGNOSTIC_ARRAY, IMU, CdrError, with_imu_covariances
from imumon.ros2.topic_url import TopicUrl, open_node, parse_url, topic_name

RETRY_S = 2.0
"""s between two attempts to reach the system."""
WAIT_S = 0.2
"""s after which the thread sees the end of the run."""
CLOSE_S = 3.0
"""s that the threads may take to end."""


class RosOutput:
    """Diagnostics and covariances of one daemon.

    Parameters
    ----------
    settings : the table ``[ros2]``.
    url : of the device, whose system is used if it is a topic; otherwise that of the settings.

    Raises
    ------
    RosError : a topic is invalid, is the input itself, or the device has no topic.
    """

    def __init__(self, settings: Any, url: str) -> None:
        self._diagnostics, self._node_name = bool(settings.diagnostics), settings.node
        is_topic = url.startswith("ros2:")
        self._url = (
            parse_url(url, settings)
            if is_topic
            else TopicUrl(topic="", rmw=settings.rmw, domain=settings.domain, router=settings.router)
        )
        self._covariance = topic_name(settings.covariance) if settings.covariance else ""
        if self._covariance and not is_topic:
            text = "ros2.covariance needs messages to pass on"
            raise RosError("covariance_needs_topic", text, "read a topic with --port ros2:TOPIC")
        if self._covariance == self._url.topic and self._covariance:
            text = f"ros2.covariance {self._covariance} is the topic that is read"
            raise RosError("covariance_is_input", text, "choose another topic")
        # the node of the device has the plain name
        self._name = f"{self._node_name}_output" if is_topic else self._node_name
        self._variances: tuple[Sequence[float] | None, Sequence[float] | None] = (None, None)
        self._reports: queue.Queue[Report] = queue.Queue(1)
        self._problems: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="imumon-ros2", daemon=True)
        self._relay: threading.Thread | None = None

    @property
    def needed(self) -> bool:
        """Whether anything is to be published."""
        return self._diagnostics or bool(self._covariance)

    def update(self, report: Report) -> None:
        """Publish a report; never wait."""
        if not self._thread.is_alive() and not self._stop.is_set():
            self._thread.start()
        # the accelerometer of another topic is not the one in the messages of this topic
        accel = None if self._url.accel else sample_variances(report, "accel")
        self._variances = (sample_variances(report, "gyro"), accel)
        with suppress(queue.Empty):
            self._reports.get_nowait()
        with suppress(queue.Full):
            self._reports.put_nowait(report)

    def problems(self) -> list[str]:
        """Return what went wrong since the last call, one line each."""
        texts = []
        with suppress(queue.Empty):
            while True:
                texts.append(self._problems.get_nowait())
        return texts

    def close(self) -> None:
        """Publish the last report and leave the system."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(CLOSE_S)

    # ------------------------------------------------------------------ in the threads

    def _run(self) -> None:
        node = self._open()
        if node is None:
            return
        try:
            if self._covariance:
                self._relay = threading.Thread(
                    target=self._pass_on, args=(node,), name="imumon-ros2-covariance", daemon=True
                )
                self._relay.start()
            if self._diagnostics:
                self._publish_reports(node)
            else:
                self._stop.wait()
        finally:
            node.close()
            if self._relay is not None:
                self._relay.join(CLOSE_S)

    def _open(self) -> RosNode | None:
        """Return a node as soon as the system is there; None: the run has ended."""
        last = ""
        while not self._stop.is_set():
            try:
                return open_node(self._url, self._name)
            except RosError as error:
                if str(error) != last:
                    last = str(error)
                    self._problems.put(f"nothing is published in ROS 2 yet: {error}")
            self._stop.wait(RETRY_S)
        return None

    def _publish_reports(self, node: RosNode) -> None:
        topic = node.advertise(DIAGNOSTICS, DIAGNOSTIC_ARRAY)
        while True:
            ending = self._stop.is_set()
            try:
                report = self._reports.get(block=not ending, timeout=WAIT_S)
            except queue.Empty:
                if ending:
                    return
                continue
            now = time.time_ns()
            topic.publish(diagnostics(report, now, self._node_name), now)

    def _pass_on(self, node: RosNode) -> None:
        """Publish each message of the input with measured covariances."""
        topic = node.advertise(self._covariance, IMU)
        for message in node.subscribe(self._url.topic, IMU).messages():
            with suppress(CdrError):  # the device counts it
                payload = with_imu_covariances(message.payload, *self._variances)
                topic.publish(payload, time.time_ns())
