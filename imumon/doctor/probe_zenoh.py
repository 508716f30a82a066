"""Zenoh probe: observation of the daemons that answer, and of the endpoints on which another could listen."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace

from imumon.bus import BusError, Subscriber
from imumon.bus.bus_error import Unreachable
from imumon.bus.subscriber import GATHER_S
from imumon.bus.zenoh_session import local_endpoints, open_session
from imumon.config import ZenohSettings
from imumon.doctor.observed import ZenohObservation

ANSWER_S = 1.0  # s to wait for the first daemon


class ZenohProbe:
    """The bus as a subscriber sees it; a context manager. `subscriber` is None if the settings allow none."""

    def __init__(self, settings: ZenohSettings, connect: tuple[str, ...]) -> None:
        self._settings = settings
        self._connect = connect
        self.subscriber: Subscriber | None = None
        self._error: BusError | None = None

    def __enter__(self) -> ZenohProbe:
        try:
            self.subscriber = Subscriber(self._connect or None, settings=self._settings)
        except BusError as error:
            self._error = error
        return self

    def __exit__(self, *_: object) -> None:
        if self.subscriber is not None:
            self.subscriber.close()

    def observe(self) -> ZenohObservation:
        """Return which daemons answer, and whether another one could listen."""
        if self.subscriber is None:
            return ZenohObservation(error=self._error)
        if self.subscriber.wait_report(None, ANSWER_S) is not None:
            time.sleep(GATHER_S)
        free, error = self._free_endpoint()
        reports = tuple(report for report, _ in self.subscriber.reports().values())
        rivals = self.subscriber.rivals()
        observation = ZenohObservation(reports=reports, rivals=rivals, free=free, error=error)
        with suppress(BusError):  # an invalid endpoint is the error above
            observation = replace(observation, unreachable=self._unreachable())
        return observation

    def _free_endpoint(self) -> tuple[str | None, BusError | None]:
        """Return an endpoint on which a daemon could listen, or why there is none."""
        listen, last_error = self._settings.listen, None
        for endpoint in listen or local_endpoints():
            try:
                open_session(self._settings, [endpoint], (), access_control=True).close()
            except BusError as error:
                last_error = error
                if listen or error.code != "address_in_use":
                    break
            else:
                if not listen or endpoint == listen[-1]:
                    return endpoint, None
        return None, last_error

    def _unreachable(self) -> tuple[str, ...]:
        """Return the configured routers that do not answer."""
        unreachable = []
        for endpoint in self._settings.connect:
            try:
                open_session(self._settings, (), [endpoint], access_control=False, client=True).close()
            except Unreachable:
                unreachable.append(endpoint)
        return tuple(unreachable)
