"""Parameters of GTSAM as its own object; gtsam is imported where this is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imumon.model.errors import ImumonError

SETTERS = (
    "setAccelerometerCovariance",
    "setGyroscopeCovariance",
    "setBiasAccCovariance",
    "setBiasOmegaCovariance",
)
"""Functions of the object that take a covariance."""


def combined_params(numbers: Mapping[str, float], gravity: float) -> Any:
    """Return ``gtsam.PreintegrationCombinedParams`` with z up.

    Parameters
    ----------
    numbers : variance by the name of the function that sets it.
    gravity : m/s^2.

    Raises
    ------
    ImumonError : gtsam is not installed, or a number is unknown.
    """
    import numpy as np

    missing = [name for name in SETTERS if name not in numbers]
    if missing:
        text = f"the record does not show what {', '.join(missing)} needs"
        raise ImumonError(
            "not_measured", text, "record gyroscope and accelerometer, and record longer, or pass bounds=True"
        )
    try:
        import gtsam
    except ModuleNotFoundError:
        text = "the object needs gtsam, which is not installed"
        raise ImumonError(
            "package_missing", text, "pip install gtsam, or use Measurement.text('gtsam')"
        ) from None
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(gravity)
    for name in SETTERS:
        getattr(params, name)(np.eye(3) * numbers[name])
    return params
