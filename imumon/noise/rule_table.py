"""Rules: the thresholds that lie between data and a decision, with their reasons.

A number such as "7 standard deviations" decides what a report states, but the number alone does not say why it is 7
and not 6, nor what happens without it. A package therefore keeps its thresholds in one file, `*_rules.py`, as rows of
one `RuleTable`:

>>> RULES = RuleTable()
>>> KNOCK_SIGMA = RULES.add(
...     "KNOCK_SIGMA",
...     7.0,
...     unit="sigma",
...     decides="a sample farther off is a knock",
...     without="knocks raise N",
...     origin="3e-12",
...     benchmark="guards.py",
... )

`add` returns the value. The code therefore compares with a plain number, whose type mypy knows, at no cost, and a jump
to the definition of the name leads to its explanation:

>>> 2.0 * KNOCK_SIGMA, RULES["KNOCK_SIGMA"].unit
(14.0, 'sigma')

docs/THEORY.md prints the rows:

>>> print(RULES.markdown())
- **KNOCK_SIGMA**, 7 sigma: a sample farther off is a knock. *Else:* knocks raise N. *Origin:* 3e-12 (`guards.py`).
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

Value: TypeAlias = float | tuple[float, ...]
"""Numbers of a rule; mypy takes an int for a float as well."""
AnyValue = TypeVar("AnyValue", bound=Value)


@dataclass(frozen=True, slots=True)
class Rule:
    """One threshold between data and a decision.

    Attributes
    ----------
    name : of the constant that code reads.
    value : number, or numbers if the rule is a range or a sequence.
    unit : of the value; "" for a pure number.
    decides : which decision the value takes, and for which side of it.
    without : what goes wrong if the rule is removed.
    origin : the formula, source or measurement that the value comes from.
    benchmark : script in `benchmarks/` (or test) that shows the effect; "" if none does.
    """

    name: str
    value: Value
    unit: str
    decides: str
    without: str
    origin: str
    benchmark: str

    def sentence(self) -> str:
        """Return the rule as one line of a document."""
        numbers = self.value if isinstance(self.value, tuple) else (self.value,)
        value = f"{', '.join(f'{number:.6g}' for number in numbers)} {self.unit}".strip()
        source = f" (`{self.benchmark}`)" if self.benchmark else ""
        text = f"**{self.name}**, {value}: {self.decides}. *Else:* {self.without}. *Origin:* {self.origin}{source}."
        return " ".join(text.split())


class RuleTable:
    """Rules of one package, in the order of their definition."""

    def __init__(self) -> None:
        self._rules: dict[str, Rule] = {}

    def add(
        self,
        name: str,
        value: AnyValue,
        *,
        unit: str,
        decides: str,
        without: str,
        origin: str,
        benchmark: str = "",
    ) -> AnyValue:
        """Add a rule (see `Rule`) and return its value.

        Raises
        ------
        ValueError : the table has a rule of this name.
        """
        if name in self._rules:  # one number would explain itself with the reasons of another
            raise ValueError(f"two rules have the name {name}")
        self._rules[name] = Rule(name, value, unit, decides, without, origin, benchmark)
        return value

    def __iter__(self) -> Iterator[Rule]:
        return iter(self._rules.values())

    def __len__(self) -> int:
        return len(self._rules)

    def __getitem__(self, name: str) -> Rule:
        return self._rules[name]

    def markdown(self, width: int = 140) -> str:
        """Return the rules as a list in Markdown, with lines of at most `width` characters."""
        wrapped = (textwrap.wrap(rule.sentence(), width - 2, break_on_hyphens=False) for rule in self)
        return "\n".join("- " + "\n  ".join(lines) for lines in wrapped)
