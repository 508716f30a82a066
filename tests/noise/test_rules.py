"""docs/THEORY.md prints the rules; ``python tests/noise/test_rules.py`` writes them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imumon.noise.detection.detection_rules import RULES as DETECTION
from imumon.noise.fit.fit_rules import RULES as FIT
from imumon.noise.fit.markov_rules import RULES as MARKOV
from imumon.noise.fit.temperature_rules import RULES as TEMPERATURE
from imumon.noise.rule_table import RuleTable
from imumon.noise.spectrum.spectrum_rules import RULES as SPECTRUM
from imumon.noise.statistics.distribution_rules import RULES as DISTRIBUTION
from imumon.noise.stretches.stretch_rules import RULES as STRETCHES

PAGE = Path(__file__).parents[2] / "docs" / "THEORY.md"
TABLES = {
    "fit": FIT,
    "the temperature": TEMPERATURE,
    "Gauss–Markov noise": MARKOV,
    "detection": DETECTION,
    "stretches": STRETCHES,
    "the spectrum": SPECTRUM,
    "the distribution": DISTRIBUTION,
}


def written(text: str, name: str, rules: RuleTable) -> str:
    """Return a page with the rules of one package as they are in the code."""
    begin, end = f"<!-- rules of {name} -->\n", "<!-- end -->"
    pattern = re.escape(begin) + r".*?" + re.escape(end)
    return re.sub(pattern, lambda _: f"{begin}{rules.markdown()}\n{end}", text, count=1, flags=re.DOTALL)


@pytest.mark.parametrize("name", TABLES)
def test_the_page_prints_the_rules(name: str) -> None:
    text = PAGE.read_text("utf-8")
    assert written(text, name, TABLES[name]) == text, "run python tests/noise/test_rules.py"


@pytest.mark.parametrize("name", TABLES)
def test_every_rule_says_what_it_decides_and_what_goes_wrong_without_it(name: str) -> None:
    for rule in TABLES[name]:
        assert len(rule.decides) > 15, rule.name
        assert len(rule.without) > 15, rule.name
        assert rule.origin, rule.name


def test_the_resolutions_that_are_tried_are_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    import resolution

    for name, values in resolution.TRIED.items():
        assert FIT[name].value not in values, name


if __name__ == "__main__":
    page = PAGE.read_text("utf-8")
    for package, table in TABLES.items():
        page = written(page, package, table)
    PAGE.write_text(page, "utf-8")
