"""Network: who is on Zenoh, and whether a daemon would find room there."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from typing import Any

from imumon.bus import BusError, SessionOptions, Subscriber
from imumon.bus.zenoh_session import Unreachable, is_local, local_endpoints, open_session
from imumon.doctor.observations import BusLook

HEAR_S = 1.0
GATHER_S = 0.3


class Network:
    """The bus as a viewer sees it, a context.

    Attributes
    ----------
    feed : the viewer; None where the settings allow none.
    """

    def __init__(self, settings: object, connect: tuple[str, ...]) -> None:
        self._options = SessionOptions.of(settings)
        self._connect = connect
        self.feed: Any = None
        self._fault: str | None = None

    def __enter__(self) -> Network:
        try:
            self.feed = Subscriber(self._connect or None, settings=self._options)
        except BusError as error:
            self._fault = str(error)
        return self

    def __exit__(self, *_: object) -> None:
        if self.feed is not None:
            self.feed.close()

    def look(self) -> BusLook:
        """Who answers within a second, and whether there is room to listen."""
        if self.feed is None:
            return BusLook(fault=self._fault)
        if self.feed.wait_report(None, HEAR_S) is not None:
            time.sleep(GATHER_S)  # others may be a little later
        reports = tuple(report for report, _ in self.feed.reports().values())
        free, fault = self._room()
        listen = self._options.listen
        with contextlib.suppress(BusError):  # an endpoint that is none is the fault above
            return BusLook(
                reports=reports,
                free=free,
                fault=fault,
                exposed=tuple(e for e in listen if not is_local(e) and not e.startswith(("tls/", "quic/"))),
                unreachable=self._unreachable(),
            )
        return BusLook(reports=reports, free=free, fault=fault)

    def _room(self) -> tuple[str | None, str | None]:
        """Endpoint that is free for a daemon, else why there is none."""
        fault = None
        for endpoint in self._options.listen or local_endpoints():
            try:
                open_session(self._options, [endpoint], (), access_control=True).close()
            except BusError as error:
                fault = str(error)
                if self._options.listen or error.code != "address_in_use":
                    break
            else:
                if not self._options.listen or endpoint == self._options.listen[-1]:
                    return endpoint, None
        return None, fault

    def _unreachable(self) -> tuple[str, ...]:
        client = replace(self._options, mode="client", listen=(), users_file="")
        silent = []
        for endpoint in self._options.connect:
            try:
                open_session(client, (), [endpoint], access_control=False).close()
            except Unreachable:
                silent.append(endpoint)
        return tuple(silent)
