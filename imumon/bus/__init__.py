"""Bus: reports on Zenoh, and back. The only package that knows Zenoh.

session     addresses, security and errors: what both ends share
publisher   the daemon's end: the keys of docs/ZENOH.md, never in the way of the data
link        one session of a daemon, and what is declared on it
texts       the JSON of a report, of which little is new each time
answers     the last value of every key, for those who ask
viewer      the other end: newest report of every device there is
"""

from imumon.bus.publisher import Publisher
from imumon.bus.subscriber import Subscriber
from imumon.bus.zenoh_session import PORTS, BusError, SessionOptions, clean_id

__all__ = ["PORTS", "BusError", "Publisher", "SessionOptions", "Subscriber", "clean_id"]
