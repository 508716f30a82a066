"""Elements of a datasheet that support its numbers: data sheet, uncertainty, exact curve, traceability.

Everything is in `Report.evaluation`; a report without it has none of these elements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta

from imumon.coefficients import COEFFICIENTS, unit_of
from imumon.datasheet.elements import DataTable, Element, Heading, Paragraph
from imumon.datasheet.tables import coefficient_text, with_limits
from imumon.evaluation import Conformity, LimitCheck, Provenance, UncertaintyBudget, UncertaintyComponent
from imumon.messages import one_warmup
from imumon.report import Event, Report, stamp
from imumon.samples import sensor_of
from imumon.units import figures, pretty, sentence, share_text

QUANTITIES = {"floor": "floor (0.664 B)", "density": "density (√2 N)"}
"""Names of quantities that are not N, B or K."""
MEANINGS = {
    "floor": "Floor: the lowest Allan deviation, the in-run bias stability of most data sheets.",
    "density": "Density: one-sided, the noise in a bandwidth.",
}
SOURCES = ("statistics", "scatter", "repeatability", "resolution", "aliasing", "time base")
"""Components of a budget, in the order of the columns."""
BIAS_SOURCES = ("statistics", "repeatability")
"""Components of the budget of a bias."""
EXCLUDING = ("disturbance", "warmup")
"""Kinds of events that are stretches whose samples do not count."""
LEAST_SHARE = 1e-5
"""Share of a value below which a component is shown as smaller."""


def conformity_elements(report: Report) -> Iterator[Element]:
    """Yield the check against the data sheet of the device."""
    conformity = report.evaluation.conformity if report.evaluation is not None else None
    if conformity is None:
        return
    yield Heading(f"Data sheet: {conformity.title}")
    remarks = any(check.reason for check in conformity.checks)
    rows = [_check_row(check)[: 7 if remarks else 6] for check in conformity.checks]
    head = ("", "quantity", "measured (95 % limits)", "at most", "verdict", "probability", "remark")
    if rows:
        yield DataTable(head[: 7 if remarks else 6], tuple(rows))
    yield Paragraph(_sheet_text(conformity))
    yield Paragraph(
        "Pass: the upper 95 % limit does not exceed the limit. Fail: the lower one does. Else undecided (guard band "
        "after JCGM 106:2012). The limits are the combined ones of the uncertainty budget, and the probability of "
        "being at most the limit follows from them. A typical value is no guarantee: about half of "
        "the devices exceed it."
    )


def _sheet_text(conformity: Conformity) -> str:
    """Return where the limits come from, and what their quantities mean."""
    parts = [
        conformity.document,
        f"edition: {conformity.edition or 'not named'}",
        conformity.source and f"source: {conformity.source}",
    ]
    meanings = [text for name, text in MEANINGS.items() if any(c.quantity == name for c in conformity.checks)]
    text = f"{'; '.join(part for part in parts if part)}. {' '.join(meanings)} {conformity.note or ''}"
    return " ".join(text.split())


def _check_row(check: LimitCheck) -> tuple[str, ...]:
    name = f"{QUANTITIES.get(check.quantity, check.quantity)}, {pretty(check.unit)}"
    chance = "–" if check.probability is None else _percent(check.probability)
    limit = f"{check.limit:g} ({check.basis})"
    return (check.channel, name, _measured(check), limit, check.verdict, chance, check.reason or "")


def _measured(check: LimitCheck) -> str:
    if check.value is not None and check.low is not None:
        return with_limits(check.value, check.low, check.high)
    return f"< {figures(check.high)}" if check.high is not None else "not known"


def _percent(probability: float) -> str:
    if probability > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if probability < 0.001 else f"{100.0 * probability:.1f} %"


def evidence_lines(report: Report) -> list[str]:
    """Return the checks and the exact curve as lines of text, for a terminal."""
    evaluation = report.evaluation
    if evaluation is None:
        return []
    lines = []
    if evaluation.conformity is not None and evaluation.conformity.checks:
        lines.append(f"data sheet: {evaluation.conformity.title} ({evaluation.conformity.document})")
        for check in evaluation.conformity.checks:
            name, _, value, limit, verdict, chance, reason = _check_row(check)
            probability = "" if check.probability is None else f", probability {chance}"
            more = f" ({reason})" if reason else ""
            lines.append(
                f"  {name:<8} {check.quantity:<7} {value}, at most {limit}: {verdict}{probability}{more}"
            )
    if evaluation.exact:
        lines.append("exact Allan deviation: largest difference of the curve of the fit")
        lines += [
            f"  {name:<8} {largest} (shorter half {short}; {octaves} octaves)"
            for name, _, octaves, short, largest in _exact_rows(report)
        ]
    return lines


# ---------------------------------------------------------------- uncertainty


def budget_elements(report: Report) -> Iterator[Element]:
    """Yield the uncertainty budget of the measured coefficients."""
    evaluation = report.evaluation
    if evaluation is None or not report.channels:
        return
    yield Heading("Uncertainty budget")
    pairs = [
        (name, letter, budget)
        for name, budgets in evaluation.budgets.items()
        for letter, budget in budgets.items()
        if letter in COEFFICIENTS and sensor_of(name) in COEFFICIENTS[letter].units
    ]
    if pairs:
        sources = [
            source
            for source in SOURCES
            if source != "repeatability" or any(_part(budget, source) for _, _, budget in pairs)
        ]
        head = ("", *sources, "combined", "k", "value (95 % limits)")
        yield DataTable(head, tuple(_budget_row(report, *pair, sources) for pair in pairs))
        yield Paragraph(
            "Standard uncertainties in percent of the value, after JCGM 100:2008 (GUM); k of Student's t for the "
            "effective degrees of freedom. The limits are those of all tables of this document: value × exp(±k u), "
            "with u of each side from the limit of the fit on that side and the other components. In brackets: a 95 % "
            "bound of what the record does not show, not combined. –: not known, not combined. "
            f"{_bases([budget for *_, budget in pairs])}"
        )
    yield from _bias_elements(evaluation.bias_budgets)
    bounded = "Coefficients that are only bounded have no budget." if pairs else "Nothing is measured yet."
    yield Paragraph(f"{bounded} Not covered: {'; '.join(evaluation.not_covered)}.")


def _part(budget: UncertaintyBudget, source: str) -> UncertaintyComponent | None:
    return next((component for component in budget.components if component.source == source), None)


def _bias_elements(budgets: Mapping[str, UncertaintyBudget]) -> Iterator[Element]:
    """Yield the budget of the bias; nothing if no power-ups are known."""
    rows = []
    for name, budget in budgets.items():
        unit = unit_of(sensor_of(name), "B", budget.unit)
        parts = [_part(budget, source) for source in BIAS_SOURCES]
        sizes = [None if part is None or part.standard is None else part.standard for part in parts]
        rows.append(
            (
                f"{name} bias",
                f"{figures(budget.value * unit.factor, 4)} {pretty(unit.unit)}",
                *("–" if size is None else figures(size * unit.factor, 2) for size in sizes),
                figures(budget.combined * unit.factor, 2),
                f"{budget.coverage:.2f}",
                f"±{figures(budget.expanded * unit.factor, 2)} {pretty(unit.unit)}",
            )
        )
    if rows:
        yield DataTable(("", "value", *BIAS_SOURCES, "combined", "k", "expanded, 95 %"), tuple(rows))
        yield Paragraph(
            "Standard uncertainties of the bias in its unit: how much the bias of this record may differ from that "
            f"after another power-up. {_bases(list(budgets.values()))}"
        )


def _budget_row(
    report: Report, name: str, letter: str, budget: UncertaintyBudget, sources: Sequence[str]
) -> tuple[str, ...]:
    """Return a coefficient with its components in percent, the coverage factor and its limits."""
    readable = COEFFICIENTS[letter].units[sensor_of(name)]
    parts = {component.source: component for component in budget.components}
    # a source that a budget does not have contributes nothing, such as resolution to values with enough digits
    shares = (_share(parts[source], budget.value) if source in parts else "0" for source in sources)
    channel = report.channels.get(name)
    limits = coefficient_text(channel.coefficients.get(letter)) if channel is not None else ""
    return (
        f"{name} {letter}, {pretty(readable.unit)}",
        *shares,
        _percent_of(budget.combined, budget.value),
        f"{budget.coverage:.2f}",
        limits or "–",
    )


def _share(part: UncertaintyComponent, value: float) -> str:
    if part.standard is None:
        return "–" if part.bound is None else f"(< {_percent_of(part.bound, value)})"
    if 0.0 < part.standard < LEAST_SHARE * value:
        return f"< {100.0 * LEAST_SHARE:g} %"
    return _percent_of(part.standard, value) if part.standard else "0"


def _percent_of(part: float, whole: float) -> str:
    return f"{figures(100.0 * part / whole, 2)} %"


def _bases(budgets: list[UncertaintyBudget]) -> str:
    """Return on what each component of the budgets rests, a sentence for each."""
    texts = []
    for source in SOURCES:
        components = [c for budget in budgets for c in budget.components if c.source == source]
        bases = dict.fromkeys(component.basis for component in components)
        if components:
            texts.append(f"{source} (type {components[0].kind}): {'; '.join(bases).replace('^2', '²')}")
    text = ". ".join(sentence(part) for part in texts)
    return f"{text}."


# ---------------------------------------------------------------- exact curve


def _exact_rows(report: Report) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield channel, points, octaves of both curves, and the largest differences: shorter half, all."""
    exact = report.evaluation.exact if report.evaluation is not None else {}
    for name, curve in exact.items():
        pairs = [(d, tau) for d, tau in zip(curve.difference, curve.tau_s, strict=True) if d is not None]
        largest = max(pairs, key=lambda pair: abs(pair[0]), default=None)
        short = max((abs(d) for d, _ in pairs[: max(1, len(pairs) // 2)]), default=None)
        allan = report.channels[name].allan if name in report.channels else None
        yield (
            name,
            f"{len(curve.tau_s)}",
            f"{len(pairs)} of {len(allan.tau_s) if allan is not None else 0}",
            "–" if short is None else share_text(short),
            "–"
            if largest is None
            else f"{'+' * (largest[0] > 0.0)}{share_text(largest[0])} at {largest[1]:.4g} s",
        )


def exact_elements(report: Report) -> Iterator[Element]:
    """Yield how much the curve of the report differs from the exact one."""
    rows = list(_exact_rows(report))
    if not rows:
        return
    yield Heading("Exact Allan deviation")
    head = (
        "",
        "points",
        "octaves compared",
        "largest difference, shorter half of these",
        "largest difference",
    )
    yield DataTable(head, tuple(rows))
    yield Paragraph(
        "The fully overlapping Allan deviation (NIST SP 1065, section 5.2.4) of the samples that count, against the "
        "curve above. That has the same samples, and its differences are an eighth of τ apart. Compared are the "
        "octaves that both have, all with --taus octave. An average counts with at least 90 % of its samples."
    )


# ---------------------------------------------------------------- traceability


def traceability_elements(report: Report) -> Iterator[Element]:
    """Yield program, input, options and what was excluded."""
    evaluation = report.evaluation
    if evaluation is None or evaluation.provenance is None:
        return
    sheet = evaluation.conformity.document if evaluation.conformity else _no_sheet(report)
    yield Heading("Traceability")
    rows = (*_provenance_rows(evaluation.provenance, report.schema), ("Data sheet", sheet))
    yield DataTable(("", ""), rows)
    if intervals := list(_excluded(report)):
        yield DataTable(("begin", "end", "begin, UTC", "excluded"), tuple(intervals))


def _provenance_rows(provenance: Provenance, schema: str) -> Iterator[tuple[str, str]]:
    """Yield what made the numbers, of what, and how; what is unknown is named, too."""
    size = f", {provenance.input_bytes:,} bytes" if provenance.input_bytes is not None else ""
    libraries = ", ".join(f"{name} {number}" for name, number in provenance.libraries.items())
    guards = {True: "on", False: "off: nothing is excluded", None: "unknown"}[provenance.guards]
    options = [f"{name} {text}".strip() for name, text in provenance.options.items()]
    yield "Program", "; ".join(filter(None, (provenance.software, libraries)))
    yield "Revision", provenance.commit or "unknown: not recorded when it was built"
    if provenance.written_by:  # a report of a file may be older than the program that writes the document
        yield "Document", f"written by {provenance.written_by}"
    yield "Report format", schema
    yield "Computed", f"{provenance.made or 'unknown'}{f', on {provenance.host}' if provenance.host else ''}"
    yield "Input", f"{provenance.input or provenance.input_reason or 'unknown'}{size}"
    yield "SHA-256", _sha256(provenance.input_sha256, provenance.input_reason)
    yield "Options", ", ".join(options) or "none"
    yield "Guards", guards


def _sha256(digest: str | None, reason: str | None) -> str:
    if digest is None:
        return f"none: {reason or 'unknown'}"
    return f"{digest} {reason}" if reason else digest


def _no_sheet(report: Report) -> str:
    if report.device.model:
        return f"none: no data sheet of {report.device.model} is known"
    return "none: the record does not name the model of the sensor"


def _excluded(report: Report) -> Iterator[tuple[str, ...]]:
    """Yield begin, end and reason of what was excluded; a warm-up begins with the record."""
    try:
        start = datetime.fromisoformat(report.session.started or "")
    except ValueError:
        start = None
    for event in sorted(excluding_events(report), key=_begin_s):
        length, begin = event.length_s or 0.0, _begin_s(event)
        date = stamp(start + timedelta(seconds=begin)) if start is not None else "–"
        yield (f"{begin:,.2f} s", f"{begin + length:,.2f} s", date, event.text)


def _begin_s(event: Event) -> float:
    return 0.0 if event.kind == "warmup" else event.elapsed_s or 0.0


def excluding_events(report: Report) -> list[Event]:
    """Return the events that are stretches whose samples do not count."""
    events = one_warmup(report.events)
    return [e for e in events if e.kind in EXCLUDING and e.length_s and e.elapsed_s is not None]
