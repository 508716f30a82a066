"""Hostile actors on the bus: queries, messages, and reports beside which every command is tried."""

from __future__ import annotations

import json

import attackers
from bus_actors import event, report
from hostile_input import TITLE, Hostile

from imumon.model.report_json import to_json

GOOD = to_json(report("b", 5))
CRAFTED = {
    TITLE: GOOD,
    "x": GOOD,  # the id of another device
    "y": GOOD.replace('"mean":0.5', f'"mean":1{"0" * 400}'),
    "z": GOOD.replace('"mean":0.5', '"mean":1e308'),
    "b": GOOD.replace('"model":null', f'"model":{json.dumps(TITLE)}', 1),  # that of the device
}
"""Reports beside which every command is tried, by the name in their keys."""
BAD_NAMES = {"escapes": TITLE, "capital": "A", "blank": "a b"}
BUS = (
    *(
        Hostile(
            "query", way.__name__.replace("_", "-"), lambda _, way=way: way, "bounded",
        )
        for way in (
            attackers.payload, attackers.many, attackers.forge,
        )
    ),
    *(
        Hostile("message", f"{kind}-of-{name}", lambda _, key=f"{text}/{kind}", data=data: (key, data), "ignored")
        for name, text in BAD_NAMES.items()
        for kind, data in (("report", to_json(report("a", 1))), ("event", to_json(event("a", 1))), ("alive", None))
    ),
    Hostile("message", "report-of-another-device", lambda _: ("b/report", to_json(report("c", 6))), "ignored"),
    Hostile("message", "report-of-1-MB", lambda _: ("b/report", to_json(report("b", 7)) + " " * 1_000_000), "ignored"),
    Hostile("message", "event-of-another-device", lambda _: ("b/event", to_json(event("c", 1))), "ignored"),
    Hostile("message", "event-of-100-kB", lambda _: ("b/event", to_json(event("b", 1)) + " " * 100_000), "ignored"),
    Hostile("command", "status", lambda _: ("status",), "0"),
    *(
        Hostile("command", "-".join(words).replace("--", ""), lambda _, words=words: words, code)
        for *words, code in (
            ("status", "--json", "0"),
            ("report", "0"),
            ("wait", "--timeout", "5s", "0"),
            ("status", "--id", "x", "3"),
            ("status", "--id", "y", "3"),
            ("status", "--id", "z", "3"),
        )
    ),
    Hostile("command", "doctor", lambda _: ("doctor", "--port", "/dev/null"), "1", says="running: b;"),
)  # fmt: skip
