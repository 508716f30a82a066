"""Bus: publish reports on Zenoh, and subscribe to them.

zenoh_session   session options, endpoints and access rules
bus_error       errors of Zenoh with code, message and cure
uplink          one session of a daemon, with its publishers, queryable and liveliness token
publisher       `Publisher`: publishes the reports and events of one device
queryable       the last value of every key, which answers a ``get``
device_states   what a subscriber knows of each device, and whose reports it shows
subscriber      `Subscriber`: newest report, last events and liveliness of every device

docs/ZENOH.md describes the keys and the payloads.
"""

from imumon.bus.bus_error import BusError
from imumon.bus.publisher import Publisher
from imumon.bus.subscriber import Subscriber
from imumon.bus.zenoh_session import clean_id

__all__ = ["BusError", "Publisher", "Subscriber", "clean_id"]
