"""Registry of device drivers: URL scheme → driver, by entry points.

A driver is an entry point of the group ``imumon.devices``: its name is the URL scheme, its value a subclass of
`DeviceDriver`. This distribution registers its own drivers in the same way. A driver is imported when it is
needed, so one that fails to import disturbs no other.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from imumon.model.report import DeviceDescription
from imumon.model.samples import DeviceInfo
from imumon.sources.device import DeviceDriver, DeviceError

GROUP = "imumon.devices"
DEFAULT_SCHEME = "vn100"
"""Driver of plain paths, of pyserial URLs and of ``sim``."""

# not before //: socket://HOST:PORT is a URL of pyserial, and names no driver
_SCHEME = re.compile(r"([a-z][a-z0-9+.-]*):(?!//)")


def schemes() -> list[str]:
    """Return the URL schemes of all registered drivers."""
    return sorted(_entry_points())


@cache
def driver(scheme: str = DEFAULT_SCHEME) -> DeviceDriver:
    """Return the driver of a scheme.

    Raises
    ------
    DeviceError : no driver has this scheme, or its package cannot be imported.
    """
    point = _entry_points().get(scheme)
    if point is None:
        known = ", ".join(f"{name}:..." for name in schemes())
        raise DeviceError(
            "unknown_device_scheme",
            f"no device driver is named {scheme!r}",
            f"write the path of a serial port, sim, or one of {known}",
        )
    try:
        instance = point.load()()
    except Exception as error:  # whatever another distribution does wrong
        raise DeviceError(
            "driver_not_importable",
            f"the device driver {scheme!r} ({point.value}) cannot be imported ({type(error).__name__}: {error})",
            "repair or uninstall its package",
        ) from error
    if not isinstance(instance, DeviceDriver) or instance.scheme != scheme:
        raise DeviceError(
            "driver_invalid",
            f"the entry point {scheme!r} ({point.value}) is no DeviceDriver of this scheme",
            "repair or uninstall its package",
        )
    return instance


def driver_of(url: str) -> DeviceDriver:
    """Return the driver of a value of ``--port``.

    ``NAME:...`` is the driver NAME; a path, a pyserial URL (with ``//``), ``sim`` and nothing are the default.

    Raises
    ------
    DeviceError : no driver has this scheme, or its package cannot be imported.
    """
    return driver(scheme_of(url))


def scheme_of(url: str) -> str:
    """Return the scheme of a value of ``--port``.

    >>> scheme_of("/dev/ttyUSB0"), scheme_of("socket://10.0.0.2:4001"), scheme_of("fake:a?rate=101")
    ('vn100', 'vn100', 'fake')
    """
    match = _SCHEME.match(url)
    return match[1] if match else DEFAULT_SCHEME


def scheme_of_bytes(data: bytes) -> str | None:
    """Return the scheme of the driver that finds messages in bytes which do not name it; None: none does."""
    # a driver of another distribution that cannot be imported does not prevent the others from being tried
    for scheme in (DEFAULT_SCHEME, *schemes()):
        with suppress(DeviceError):
            decoder = driver(scheme).decoder()
            if decoder is not None and (decoder.feed(data) or decoder.messages):
                return scheme
    return None


def installed(scheme: str | None) -> DeviceDriver | None:
    """Return the driver that a file or a report names; None if it names none, or one that is not installed."""
    return driver(scheme) if scheme in _entry_points() else None


def setting_texts(driver: DeviceDriver | None, settings: Mapping[str, str]) -> dict[str, str]:
    """Return what the settings of a device do, for those that its driver knows."""
    texts = {name: driver.setting_text(name, value) for name, value in settings.items()} if driver else {}
    return {name: text for name, text in texts.items() if text is not None}


@cache
def _entry_points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def description(info: DeviceInfo, name: str) -> DeviceDescription:
    """Return the device in a report, under its name on the bus."""
    shared = {field.name for field in fields(DeviceDescription)} & {field.name for field in fields(info)}
    known = {field: getattr(info, field) for field in shared - {"id"}}
    texts = setting_texts(installed(info.driver), info.settings)
    return DeviceDescription(**known, id=name, setting_texts=texts)
