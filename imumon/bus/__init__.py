"""Bus: publish reports on Zenoh, and subscribe to them.

zenoh_session   session options, endpoints, access rules and errors
uplink          one session of a daemon, with its publishers, queryable and liveliness token
publisher       `Publisher`: publishes the reports and events of one device
queryable       the last value of every key, which answers a ``get``
subscriber      `Subscriber`: newest report, last events and liveliness of every device

docs/ZENOH.md describes the keys and the payloads.
"""

from imumon.bus.publisher import Publisher
from imumon.bus.subscriber import Subscriber
from imumon.bus.zenoh_session import BusError, SessionOptions, clean_id

__all__ = ["BusError", "Publisher", "SessionOptions", "Subscriber", "clean_id"]
