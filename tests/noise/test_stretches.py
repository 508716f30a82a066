"""Parts of a record: quarters, stretches, changes and the end of a warm-up, each by the fit of its own samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from noise_fits import curve_of

from imumon.model.coefficients import Estimate
from imumon.model.samples import Floats
from imumon.model.saved_state import pack, unpack
from imumon.noise import ChannelFit, Estimator, synthesise
from imumon.noise.allan import AllanCurve
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.stretches import Sums
from imumon.noise.stretches.change import detect_changes, joined
from imumon.noise.stretches.parts import Parts
from imumon.noise.stretches.quarters import excess
from imumon.noise.stretches.stretches import LENGTHS_S, Stretch
from imumon.noise.stretches.warmup import still_heats_up

RATE, N, B = 10.0, 1e-4, 1e-5
HOUR = round(3600 * RATE)


def fitted(values: Floats) -> tuple[ChannelFit, ...]:
    return Estimator(averaged=True, time_to=False).fit(curve_of(values, RATE))


# --- quarters ----------------------------------------------------------------------------------------------


def sums(channels: int, warmup: tuple[int, ...] = ()) -> Sums:
    return Sums([0] * channels, channels, 1.0 / RATE, averaged=[True] * channels, warmup_channels=warmup)


def noise(n: int, channels: int = 2, seed: int = 1) -> Floats:
    return synthesise(n, RATE, N=[N] * channels, B=B, seed=seed)


def test_the_quarters_follow_a_change_of_n_and_their_limits_hold_it() -> None:
    n = 64 * 1024
    record, estimator, held = sums(4), Estimator(averaged=True, time_to=False), []
    record.add(noise(n, channels=4) * np.repeat([1.0, 1.1, 1.2, 1.3], n // 4)[:, None])
    for factor, (quarter, samples) in zip((1.0, 1.1, 1.2, 1.3), record.equal_parts(4), strict=True):
        assert samples == pytest.approx(n / 4, rel=0.2)
        for fit in estimator.fit_sums(quarter, samples):
            assert fit.N.value == pytest.approx(factor * N, rel=0.04)
            held += [fit.N.low <= factor * N <= fit.N.high, fit.B.low <= factor * B <= fit.B.high]
    assert sum(held) >= 27  # of 32, at 95 %


@pytest.mark.slow
def test_the_excess_of_quarters_is_that_of_random_effects() -> None:
    """Steady quarters show none in three of four records; limits hold the deviation that is there in 95 %."""
    rng = np.random.default_rng(8)
    errors = np.array([0.01, 0.01, 0.02, 0.015])
    for deviation in (0.0, 0.1):
        logs = rng.standard_normal((400, 4)) * np.hypot(errors, deviation)
        found = [excess(np.exp(row), errors) for row in logs]
        shows = np.mean([each.value is not None for each in found])
        assert shows > 0.97 if deviation else 0.17 < shows < 0.33
        held = np.mean([each.low <= deviation <= each.high for each in found if each.value or not deviation])
        assert 0.91 < held < 0.99 if deviation else held > 0.8  # those that show are the largest
    assert float(np.median([each.value or 0.0 for each in found])) == pytest.approx(0.09, abs=0.02)
    alike = excess(np.exp(1e-5 * np.arange(4)), errors)  # by chance: no proof that the sensor varies less
    assert alike.value is None
    assert alike.high > errors.max()


# --- stretches ---------------------------------------------------------------------------------------------


def finished(values: Floats, chunk: int) -> list[Stretch]:
    record, out = sums(values.shape[1]), []
    for at in range(0, len(values), chunk):
        record.add(values[at : at + chunk])
        out += record.ended().stretches
    return out


def test_a_finished_stretch_is_fitted_as_its_samples_alone() -> None:
    """N agrees within a fifth of its limits; B within half, because a stretch has fewer blocks."""
    values = noise(2 * HOUR + 1000, channels=4)
    found = finished(values, 7000)
    assert [each.length_s for each in found].count(3600) == 2
    estimator = Estimator(averaged=True, time_to=False)
    for each in found:
        assert each.end - each.start == each.length_s * RATE
        assert each.moments.result().channels[0].count == each.end - each.start
        own, alone = (
            estimator.fit_sums(each.sums, each.end - each.start),
            fitted(values[each.start : each.end]),
        )
        for a, b in zip(own, alone, strict=True):
            assert a.N.value == pytest.approx(b.N.value, abs=0.3 * (b.N.high - b.N.low))  # type: ignore[operator]
            assert a.B.high == pytest.approx(b.B.high, rel=0.5)
            assert a.N.high - a.N.low == pytest.approx(b.N.high - b.N.low, rel=0.3)  # type: ignore[operator]


def test_a_stretch_in_progress_grows_and_one_without_samples_is_none() -> None:
    record = sums(2)
    assert record.stretch_in_progress(3600) is None
    record.add(noise(HOUR + 9000))
    counts = [record.stretch_in_progress(step) for step in LENGTHS_S]
    assert [each and each.end - each.start for each in counts] == [9000, HOUR + 9000]
    record.skip(10 * HOUR)
    assert record.stretch_in_progress(3600) is None
    assert [each.length_s for each in record.ended().stretches].count(3600) == 2
    record.add(noise(HOUR))  # a gap ends only the stretches that it lies in
    stretch = record.stretch_in_progress(3600)
    assert stretch.moments.result().channels[0].count == 9000
    assert [each.length_s for each in record.ended().stretches] == [3600]


def test_record_and_quarters_are_the_same_for_any_chunking_and_after_a_restart() -> None:
    values = noise(2 * HOUR)
    whole, chunked = (sums(2, (0, 1)) for _ in range(2))
    whole.add(values)
    for at in range(0, len(values), 4321):
        chunked.add(values[at : at + 4321])
        if at == 4321 * 8:
            restored = unpack(pack(chunked))
        elif at > 4321 * 8:
            restored.add(values[at : at + 4321])
    for other in (chunked, restored):
        assert other.position == len(values)
        np.testing.assert_array_equal(whole.curve().avar, other.curve().avar)
        pairs = [(whole.curve().sums, other.curve().sums)]
        for (one, samples), (two, count) in zip(whole.equal_parts(4), other.equal_parts(4), strict=True):
            assert samples == count
            pairs.append((one, two))
        for one, two in pairs:
            np.testing.assert_array_equal(one.blocks.means, two.blocks.means)
            for a, b in zip(one.levels, two.levels, strict=True):
                np.testing.assert_array_equal(a.power, b.power)


# --- changes -----------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("seed", range(2))
def test_ordinary_hours_are_no_change(seed: int) -> None:
    values = synthesise(4 * HOUR, RATE, N=[N] * 4, B=[B, 5e-6, 2e-5, 0.0], K=[1e-7, 1e-6, 0, 0], seed=seed)
    record = sums(4)
    record.add(values)
    assert [changes for _, changes in record.ended().hours] == [{}, {}, {}]


def test_an_hour_with_another_n_is_a_change() -> None:
    values = noise(3 * HOUR + 100, channels=3, seed=9)
    values[2 * HOUR :, 1] *= 1.4
    values[2 * HOUR :, 2] += 3e-4  # another bias is no change of the noise
    record = sums(3)
    record.add(values)
    assert list(record.changes()) == [1]
    (change,) = [each for each in record.changes()[1] if each.letter == "N"]
    assert change.ratio == pytest.approx(1.4, rel=0.03)
    restored = unpack(pack(record))
    assert restored.changes() == record.changes()


def limited(n: float) -> dict[str, Estimate]:
    return {"N": Estimate(value=n, low=0.99 * n, high=1.01 * n, status="measured"), "B": Estimate()}


def test_a_change_is_beyond_chance_and_large() -> None:
    assert detect_changes(limited(1e-4), limited(1.01e-4), pairs=18) == ()
    assert detect_changes(limited(1e-4), limited(1.03e-4), pairs=18) == ()
    (change,) = detect_changes(limited(1e-4), limited(1.4e-4), pairs=18)
    assert (change.letter, change.ratio) == ("N", pytest.approx(1.4))
    assert detect_changes({}, limited(1e-4), pairs=18) == ()
    without_limits = {"N": Estimate(value=1e-4, low=1e-4, high=1e-4, status="measured")}
    assert detect_changes(without_limits, limited(1.4e-4), pairs=18) == ()


def test_parts_together_are_known_as_well_as_their_number_says() -> None:
    (whole,) = joined([limited(1e-4), limited(1e-4)]).values()
    assert whole.value == pytest.approx(1e-4)
    assert whole.high / 1e-4 - 1.0 == pytest.approx(0.01 / np.sqrt(2.0), rel=0.05)
    assert joined([limited(1e-4), {"N": Estimate()}]) == {}


# --- warm-up -----------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize(("time_s", "least", "most"), [(150.0, 300.0, 1200.0), (500.0, 600.0, 2400.0)])
def test_an_exponential_is_excluded_when_it_is_over(time_s: float, least: float, most: float) -> None:
    values = noise(round(2.2 * HOUR), channels=3, seed=3)
    at = np.arange(len(values)) / RATE
    record = sums(3, (0, 1, 2))
    record.add(values + 5e-4 * np.exp(-at / time_s)[:, None])
    assert least <= record.warmup_s == record.begin_s <= most
    begin = round(record.warmup_s * RATE)
    after = record.moments().channels[0]
    assert after.count == len(values) - begin
    for fit in Estimator(averaged=True, time_to=False).fit(record.curve()):
        assert fit.K.status == "upper_bound"
        assert fit.N.value == pytest.approx(N, rel=0.03)
    assert [warmup for _, warmup in record.ended().warmups][-1] == record.warmup_s


def test_a_warm_up_counts_its_valid_samples_only() -> None:
    values = noise(2 * HOUR, channels=2, seed=3)
    values += 5e-4 * np.exp(-np.arange(len(values)) / RATE / 150.0)[:, None]
    ok = np.ones((len(values), 1), dtype=bool)
    ok[100:300] = False
    record = sums(2, (0, 1))
    record.add(values[:1000], ok[:1000])
    record.skip(200)
    record.add(values[1200:], ok[1200:])
    assert record.warmup_s > 0.0
    total = record.moments().channels[0].count + round(record.warmup_s * RATE)
    assert total == len(values) - 400
    again = unpack(pack(record))
    assert again.warmup_s == record.warmup_s


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", ["walk", "step", "noise", "drift"])
def test_what_does_not_settle_is_no_warm_up(kind: str) -> None:
    values = noise(2 * HOUR, channels=4, seed=5)
    at = np.arange(len(values))[:, None] / RATE
    if kind == "walk":
        values += synthesise(len(values), RATE, K=[1e-6] * 4, seed=6)
    elif kind == "drift":
        values += 1e-6 * at
    elif kind == "step":
        values += 3e-4 * (at > 2000.0)
    record = sums(4, (0, 1, 2, 3))
    record.add(values)
    assert record.warmup_s == 0.0


@pytest.mark.few
@pytest.mark.parametrize(
    ("minutes", "time_s", "warming"),
    [(2.5, 300.0, True), (20.0, 300.0, True), (90.0, 300.0, False), (0.5, 300.0, False), (60.0, 1e9, False)],
)
def test_a_temperature_that_rises_is_a_warm_up_until_it_rests(
    minutes: float, time_s: float, warming: bool
) -> None:
    block_s = 0.4
    at = np.arange(0.0, 60.0 * minutes, block_s)
    degrees = 20.0 + 8.0 * (1.0 - np.exp(-at / time_s)) + np.random.default_rng(1).normal(0.0, 0.03, at.size)
    degrees[at.size // 3 : at.size // 3 + 3] = np.nan
    assert still_heats_up(degrees, block_s) == warming


# --- temperature -------------------------------------------------------------------------------------------


def heated(hours: float, chunk: int) -> tuple[Sums, list[Stretch]]:
    """Return the statistics of a record whose second channel follows the temperature, its third column."""
    values = noise(round(hours * HOUR), channels=2, seed=8)
    at = np.arange(len(values)) / RATE
    degrees = 30.0 - 8.0 * np.exp(-at / 600.0) + 0.5 * np.sin(at / 300.0)
    values[:, 1] += 1e-4 * degrees
    degrees[1000:1500] = np.nan
    record = Sums([0, 0, 1], 2, 1.0 / RATE, averaged=[True] * 2, temperature=2)
    columns, found = np.column_stack((values, degrees)), []
    valid = np.isfinite(columns[:, 1:])
    for start in range(0, len(columns), chunk):
        record.add(columns[start : start + chunk], valid[start : start + chunk])
        found += record.ended().stretches
    return record, found


def test_the_temperature_of_a_record_and_of_its_stretches_explains_the_bias() -> None:
    record, found = heated(2.1, 10_000)
    estimator = Estimator(averaged=True, time_to=False)
    parts = [estimator.fit(record.curve())]
    parts += [estimator.fit_sums(each.sums, each.end - each.start) for each in found if each.length_s == 3600]
    assert len(parts) == 3
    for steady, following in parts:
        assert not steady.follows_temperature
        slope = following.regressor("temperature")
        assert following.follows_temperature
        assert slope.value == pytest.approx(1e-4, abs=4.0 * slope.error)
        assert following.K.is_bound


def test_a_record_warms_up_as_long_as_its_temperature_rises() -> None:
    for hours, warming in ((0.2, True), (2.5, False)):
        record, _ = heated(hours, 10_000)
        assert record.still_heats_up(record.curve()) == warming
    record = sums(2)
    record.add(noise(9000))
    assert not record.still_heats_up(record.curve())


# ---------- laws of parts: what is known since a marked place is what a record that begins there would know


def two_channels() -> Parts:
    return Parts([0, 0], [0, 1], 0.01)


def marked(values: Floats, place: int) -> Parts:
    """Return the parts of a record with a mark, at which a curve begins."""
    parts = two_channels()
    parts.update(values[:place])
    parts.mark(curve=True)
    parts.update(values[place:])
    return parts


def test_a_part_equals_a_cascade_that_begins_there() -> None:
    """Segments may begin up to a hop later, and the filters have a past; blocks lie on the grid of the record."""
    x, place = np.random.default_rng(7).normal(size=(40_000, 2)) + 100.0, 7 * BLOCK
    parts = marked(x, place)
    curve, expected = parts.curve(place), curve_of(x[place:], 100.0)
    assert (len(curve.m), curve.span) == (len(expected.m), expected.span)
    # at most one block of differences is missing at each octave, and none is added
    lost = expected.terms - curve.terms
    assert np.all(lost >= 0)
    assert np.all(lost <= BLOCK / expected.stride[:, None])
    np.testing.assert_allclose(curve.avar[:8], expected.avar[:8], rtol=0.05)
    part, other = parts.sums(place), expected.sums
    assert part.pooled
    assert not other.pooled
    for level, (a, b) in enumerate(zip(part.levels, other.levels, strict=False)):
        assert abs(int(a.averages[0]) - int(b.averages[0])) <= 2
        if level < 3:
            np.testing.assert_allclose(a.power.sum(axis=1), b.power.sum(axis=1), rtol=0.05)
    whole = parts.cascade.blocks.result()
    first = -(-place // whole.length)
    np.testing.assert_array_equal(part.blocks.means, whole.means[first : first + len(part.blocks.means)])


@settings(max_examples=25)
@given(st.lists(st.integers(1, 9_000), max_size=5), st.integers(0, 12_000))
def test_any_chunking_gives_the_same_part(cuts: list[int], place: int) -> None:
    x = np.random.default_rng(5).normal(size=(14_000, 2))
    curves: list[AllanCurve] = []
    for pieces in ([], cuts):
        parts, begin = two_channels(), 0
        for end in sorted({*(cut for cut in pieces if cut < 14_000), place, 14_000}):
            parts.update(x[begin:end])
            begin = end
            if end == place:
                parts.mark(curve=True)
        parts.mark(curve=True)  # at the place, or of no use
        curves.append(parts.curve(place))
    one, other = curves
    np.testing.assert_array_equal(one.terms, other.terms)
    np.testing.assert_array_equal(one.avar, other.avar)
    if place:  # the whole record is by bin
        assert one.sums.pooled
    np.testing.assert_array_equal(one.sums.blocks.means, other.sums.blocks.means)
    for level, same in zip(one.sums.levels, other.sums.levels, strict=True):
        np.testing.assert_array_equal(level.power, same.power)
        np.testing.assert_array_equal(level.averages, same.averages)
