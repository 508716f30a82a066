"""Combined 95 % limits of the coefficients of a report: one interval a number, with everything that is known of it.

The formulas are those of `noise.uncertainty`. The limits of a coefficient that is measured hold

- the statistics of the fit;
- the scatter between the quarters of the record, where the quarters show it;
- the scatter between the days of the history, where it has enough of them;
- what rounding to the steps of the values adds to N;
- the clock that stamps the samples, or that a given rate rests on.

Those of a bound are its own: nothing else is known of it. Aliasing is a factor and not a spread: a caveat has it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from imumon.model.coefficients import MARKOV, Estimate, MarkovEstimate
from imumon.model.history_report import DayScatter
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL, ChannelName
from imumon.noise import uncertainty
from imumon.noise.uncertainty import StandardUncertainty

CLOCK_TOLERANCE = 1e-4
"""Share by which the time of the samples is assumed to be off at most: 100 parts in a million, ten times a usual
crystal over temperature. A rate that is given counts as the stamps that say the same: those of a sensor come from the
oscillator that makes its rate, so neither knows more than the other."""


def with_combined(
    report: Report, history: Mapping[str, Mapping[str, DayScatter]] | None = None
) -> dict[ChannelName, Channel]:
    """Return the channels of a report with the combined limits of their coefficients.

    Parameters
    ----------
    history : scatter between the days, by channel and letter; None: no history of the sensor is known.
    """
    return {
        name: _channel(report, name, channel, (history or {}).get(name, {}))
        for name, channel in report.channels.items()
    }


def shared_share(report: Report, name: ChannelName, letter: str) -> float:
    """Return what all records of a sensor have in common of the uncertainty of a coefficient, as a share of it."""
    channel = report.channels[name]
    part = channel.estimates.get(letter)
    if part is None or not part.value:
        return 0.0
    shared = _shared(report, name, channel, letter, part.value)
    return math.hypot(*(component.standard for component in shared)) / part.value


def _channel(report: Report, name: ChannelName, channel: Channel, days: Mapping[str, DayScatter]) -> Channel:
    """Return a channel with the combined limits of its coefficients."""

    def combined(letter: str, part: Estimate) -> Estimate:
        return _combined(report, name, letter, part, days.get(letter))

    single = {letter: combined(letter, part) for letter, part in channel.coefficients.items()}
    if channel.M is None:
        return replace(channel, coefficients=single)
    pairs = zip(MARKOV, (channel.M.sigma, channel.M.time_constant_s), strict=True)
    sigma, time_constant = (combined(letter, part) for letter, part in pairs)
    return replace(channel, coefficients=single, M=MarkovEstimate(sigma=sigma, time_constant_s=time_constant))


def _combined(
    report: Report, name: ChannelName, letter: str, part: Estimate, days: DayScatter | None
) -> Estimate:
    """Return a coefficient with its combined limits."""
    value = part.value
    if part.status != "measured" or not value or part.low is None or part.high is None:
        return replace(part, combined_low=part.low, combined_high=part.high, dof=None)
    statistics = uncertainty.of_limits(value, part.low, part.high)
    scatter = StandardUncertainty(0.0)
    if part.excess is not None and part.excess.value:
        scatter = uncertainty.of_scatter(value, part.excess.value, statistics.standard)
    components = [statistics, scatter]  # `combine` expects that of the limits first
    if days is not None:
        components.append(uncertainty.of_days(days.days, days.std, days.statistics, scatter.standard))
    components += _shared(report, name, report.channels[name], letter, value)
    whole = uncertainty.combine(value, part.low, part.high, components)
    return replace(part, combined_low=whole.low, combined_high=whole.high, dof=whole.dof)


def _shared(
    report: Report, name: ChannelName, channel: Channel, letter: str, value: float
) -> Iterator[StandardUncertainty]:
    """Yield what does not vary from record to record: the steps of the values and the clock."""
    # rounding of noisy values is white; where the steps are coarser than the noise, what it adds is unknown
    if letter == "N" and channel.resolution is not None:
        rate_hz = report.device.sample_rate_hz
        rounding = uncertainty.of_resolution(value, channel.resolution, channel.std, rate_hz)
        yield from filter(None, [rounding])
    averaged = report.device.stream == "deltas" and name.sensor in INERTIAL
    yield uncertainty.of_time_base(value, letter, CLOCK_TOLERANCE, averaged=averaged)
