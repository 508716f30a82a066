"""Choice of the stream that is characterised, where a device sends several.

The best one counts: deltas, else uncompensated, else compensated; of equal ones that with more inertial channels. A
stream without a clock needs a rate. Before one is required, the other streams of the device have time to appear.
"""

from __future__ import annotations

from dataclasses import dataclass

from imumon.model.cures import option
from imumon.model.errors import RateRequired
from imumon.model.samples import INERTIAL, Stream

NO_CLOCK_SAMPLES = 100
"""Samples of a stream without clock and rate after which a record stops waiting for another stream: a device that sends
several streams has sent all of them by then."""

NO_CLOCK_S = 5.0
"""s, the same limit by the host clock, because 100 samples of a slow stream take long."""

STREAM_RANK = {"compensated": 0, "unknown": 1, "uncompensated": 2, "deltas": 3}
"""Rank of a kind of stream: the highest is characterised."""


def rank(stream: Stream) -> tuple[int, int, int]:
    """Return the rank of a stream: the stream of the highest rank is characterised."""
    inertial = sum(sensor in INERTIAL for sensor in stream.sensors)
    return STREAM_RANK[stream.kind], inertial, len(stream.channels)


@dataclass(slots=True)
class WithoutRate:
    """Samples of streams that need a rate, before any other stream appears."""

    source: str = ""  # message that needs a rate
    samples: int = 0
    seconds: float = 0.0  # by the host clock

    def add(self, stream: Stream, samples: int, host_s: float) -> None:
        """Count samples; raise `RateRequired` if no other stream has appeared soon."""
        if samples or self.source:
            self.source = stream.source
            self.samples += samples
            self.seconds += host_s
            if self.samples > NO_CLOCK_SAMPLES or self.seconds > NO_CLOCK_S:
                raise self.error()

    def error(self) -> RateRequired:
        """Return that the rate of the stream is needed."""
        text = f"{self.source} has no clock"
        return RateRequired("rate_required", text, f"give its sample rate with {option('rate_hz')}")
