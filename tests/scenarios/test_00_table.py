"""The table of the scenarios is that of docs/dev/RELIABILITY.md."""

from __future__ import annotations

import re
from pathlib import Path

HERE = Path(__file__).parent


def test_every_scenario_stands_in_the_table_and_none_else() -> None:
    there = re.findall(
        r"^def test_(\d\d)_(\w+)",
        "\n".join(p.read_text() for p in sorted(HERE.glob("test_0[1-9]_*.py"))),
        re.M,
    )
    table = (HERE.parents[1] / "docs" / "dev" / "RELIABILITY.md").read_text().partition("## Scenarios")[2]
    shown = re.findall(r"^\| (\d\d) \| `(\w+)` \|", table, re.M)
    assert shown == there
    numbers = [int(number) for number, _ in there]
    assert numbers == sorted(set(numbers))  # the number of a scenario that is removed is not given again
