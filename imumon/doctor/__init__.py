"""Doctor: checks of the settings, port, device, Zenoh, state and service."""

from imumon.doctor.checks import DEVICE_CHECKS as NAMES
from imumon.doctor.doctor import Case, examine

__all__ = ["NAMES", "Case", "examine"]
