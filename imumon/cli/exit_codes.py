"""Exit codes of the commands, and the exit code of each error.

Commands raise errors and do not choose exit codes for those of other packages: `exit_code` is the only place
that does. An error that arises in a command itself is a `CommandError` and carries its own exit code.
"""

from __future__ import annotations

from imumon.model.errors import ImumonError, RateRequired

SUCCESS = 0
FAILURE = 1
"""Any failure; ``doctor``: at least one check failed."""
USAGE = 2
"""Wrong usage or faults in the settings."""
NOT_FOUND = 3
"""No port, no device or no daemon."""
NOT_REACHED = 4
"""A condition was not reached or a device not found in time."""
INTERRUPTED = 130
"""Interrupted from the keyboard."""

_USAGE_CODES = (
    "columns_unclear",
    "rate_required",
    "invalid_settings",
    "endpoint_invalid",
    "id_invalid",
    "listen_insecure",
    "datasheet_unreadable",
    "datasheet_invalid",
    "datasheet_of_other_device",
    "filter_unknown",
    "time_invalid",
    "step_invalid",
    "too_many_rows",
    "ros2_topic_invalid",
    "covariance_needs_topic",
    "covariance_is_input",
)
"""Codes of wrong usage, where the type of the error does not decide."""


WITHOUT_SAMPLES = ("no_rows", "no_messages", "no_inertial_messages", "no_complete_row", "empty")
"""Codes of a recording that ended and has no sample."""


class CommandError(ImumonError):
    """End the command with one line on standard error and this exit code."""

    def __init__(self, code: str, message: str, cure: str = "", exit_code: int = FAILURE) -> None:
        super().__init__(code, message, cure)
        self.exit_code = exit_code


def exit_code(error: ImumonError) -> int:
    """Return the exit code of an error that a user sees."""
    if isinstance(error, CommandError):
        return error.exit_code
    if error.code == "no_history" or error.code in WITHOUT_SAMPLES:
        return NOT_FOUND
    if error.code in _USAGE_CODES or isinstance(error, RateRequired) or getattr(error, "setting", None):
        return USAGE
    from imumon.sources.device import DeviceError, DeviceNotFound, InvalidOption
    from imumon.sources.files.base import OptionError

    unknown_device = isinstance(error, DeviceError) and error.code == "unknown_device_scheme"
    if unknown_device or isinstance(error, InvalidOption | OptionError):
        return USAGE
    return NOT_FOUND if isinstance(error, DeviceNotFound) else FAILURE
