"""Doctor: checks of the port, the device, Zenoh, the state and the service."""

from imumon.doctor.doctor import (
    Case,
    Check,
    examine,
)

__all__ = [
    "Case",
    "Check",
    "examine",
]
