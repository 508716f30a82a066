"""Doctor: checks of the settings, port, device, Zenoh, state and service."""

from imumon.doctor.doctor import Case, examine

__all__ = ["Case", "examine"]
