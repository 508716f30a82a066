"""Runs of the pipeline on synthesised noise of a known sensor, and the reports of them that are saved as files.

    python tests/report_runs.py    makes the files of tests/data/reports again

A run feeds a `Record` with a sensor of known N, B and K that has gaps, a knock, a vibration and a slowly
cycling temperature. The seed is fixed, so the numbers are the same on every machine. Tests that draw or print a report
read the files (`reports.report`); `test_saved_reports.py` makes them again every night, and compares.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import numpy as np
from reports import BEGIN, FOLDER, ID, LENGTH_S, LONG_RATE, LONG_S, NOISE, RATE, TRUTH, written

from imumon.model.report import DeviceDescription, Report, SessionCounters, Signal, stamp
from imumon.model.samples import ACCEL, GYRO, Floats, SampleBlock, Stream
from imumon.noise import OctaveCascade, fit_curve
from imumon.noise.synthesis import synthesise
from imumon.record import Record, RecordOptions
from imumon.sources import registry

SETTINGS = {
    "75 binary output 1": "1,40,01,0739",
    "82 delta theta and delta velocity": "0,0,0,0,0",
    "85 IMU filtering": "0,4,4,4,0,0,3,3,3,0",
    "of tomorrow": "a value without a text",
}
DEVICE = DeviceDescription(
    id=ID,
    driver="vn100",
    model="VN-100T-CR",
    serial="0100056785",
    firmware="2.1.0.0",
    port="/dev/ttyUSB0",
    baud=115200,
    alias_factor=3.162,
    settings=SETTINGS,
    setting_texts=registry.setting_texts(registry.driver("vn100"), SETTINGS),
)
STREAM = Stream("uncompensated", (*NOISE, "temperature", "pressure"), "binary 01:0739", "startup")
AMBIENT_S = 7200.0
"""s, period of the ambient temperature."""
VIBRATION_HZ = 4.37
"""Hz, vibration along accel/y."""
CHUNK = 2000
"""Samples per block."""


class Run:
    """A monitor that is fed with a synthetic sensor.

    Parameters
    ----------
    scale : factor of all noise.
    walk : factor of K.
    moving_s : s of motion at the end of the record.
    warm_up : let the gyroscopes settle with the temperature.
    convergence : of `RecordOptions`.
    """

    def __init__(
        self,
        length_s: float = LENGTH_S,
        rate_hz: float = RATE,
        *,
        seed: int = 1,
        scale: float = 1.0,
        walk: float = 1.0,
        moving_s: float = 0.0,
        warm_up: bool = False,
        convergence: bool = False,
    ) -> None:
        self.monitor = Record(RecordOptions(convergence=convergence))
        self._rate_hz = rate_hz
        self._values = _samples(
            round(length_s * rate_hz), rate_hz, seed, (scale, scale, scale * walk), moving_s, warm_up
        )
        self._kept = np.ones(len(self._values), dtype=np.bool_)
        for begin_s, count in ((1000.0, 24), (2300.0, 36), (5000.0, 1)):
            self._kept[round(begin_s * rate_hz) :][:count] = False
        self._at = 0

    def report_at(self, elapsed_s: float, state: str = "running") -> Report:
        """Feed the samples up to a time, and return the report; times must not decrease."""
        end = min(round(elapsed_s * self._rate_hz), len(self._values))
        while self._at < end:
            rows = np.arange(self._at, min(self._at + CHUNK, end))
            rows = rows[self._kept[rows]]
            stamps = 10**9 + np.rint(rows * 1e9 / self._rate_hz).astype(np.int64)
            self._at = min(self._at + CHUNK, end)
            self.monitor.feed(
                SampleBlock(STREAM, self._values[rows], stamps, np.zeros(len(rows), dtype=np.int64))
            )
        session = SessionCounters(
            started=stamp(BEGIN),
            discarded_bytes=118,
            bad_checksums=2,
            received_bytes=62 * end,
            restarts=1,
        )
        now = BEGIN + timedelta(seconds=elapsed_s)
        # a full analysis: a report depends only on its time, not on earlier reports
        report = self.monitor.report(now, DEVICE, "stopped", session)
        return replace(report, state=state)  # type: ignore[arg-type]


def _samples(
    count: int, rate_hz: float, seed: int, scales: tuple[float, float, float], moving_s: float, warm_up: bool
) -> Floats:
    """Return (count, 11) samples of `STREAM`."""
    n, b, k = ([scale * TRUTH[name][i] for name in NOISE] for i, scale in enumerate(scales))
    noise = synthesise(count, rate_hz, N=n, B=b, K=k, seed=seed, averaged=False)
    time = np.arange(count) / rate_hz
    rng = np.random.default_rng([seed, 1])  # not the numbers of the noise: they would follow the temperature
    ambient = 0.5 - 0.5 * np.cos(2.0 * np.pi * time / AMBIENT_S)
    heat = 1.0 - np.exp(-time / 400.0) if warm_up else ambient
    values = noise + [TRUTH[name][3] for name in NOISE]
    if 0.5 * rate_hz > VIBRATION_HZ:
        values[:, 4] += 0.6 * values[:, 4].std() * np.sin(2.0 * np.pi * VIBRATION_HZ * time)
    if warm_up:
        values[:, :3] += 0.004 * heat[:, None]
    knock = (time >= 4000.0) & (time < 4000.8)
    values[knock, 1] += 0.8 * np.sin(2.0 * np.pi * 3.0 * time[knock])
    if moving_s:
        moving = time >= time[-1] - moving_s
        values[moving, :3] += 0.5 * np.sin(2.0 * np.pi * 0.3 * time[moving])[:, None]
        values[moving, 3:6] += 2.0 * np.sin(2.0 * np.pi * 0.3 * time[moving])[:, None]
    temperature = 24.9 + 6.6 * heat + 0.01 * rng.standard_normal(count)
    pressure = 101.32 + 0.002 * rng.standard_normal(count)
    return np.column_stack((values, temperature, pressure))


def correlated() -> Report:
    """Return the report of gyroscopes with Gauss–Markov noise: x shows it, y does not separate it from B and K.

    The noise of z is flicker.
    """
    rate_hz, count = 10.0, 108_000
    rng = np.random.default_rng(3)
    values = rng.standard_normal((count, 6)) * np.sqrt(rate_hz) * np.repeat((3e-4, 2e-3), 3)
    values[:, 0] += markov_noise(np.random.default_rng([2, 7]), count, 4e-4, rate_hz * 30.0)
    values[:, 1] += _not_separable(values[:, 1], rate_hz)
    values[:, 2] += synthesise(count, rate_hz, N=1e-9, B=1.5e-4, seed=9)[:, 0]
    values[:, 5] -= 9.80665
    monitor, stream = Record(), Stream("uncompensated", (*GYRO, *ACCEL), "binary 01:0739", "startup")
    for begin in range(0, count, CHUNK):
        rows = np.arange(begin, min(begin + CHUNK, count))
        stamps = 10**9 + np.rint(rows * 1e9 / rate_hz).astype(np.int64)
        monitor.feed(SampleBlock(stream, values[rows], stamps, np.zeros(len(rows), dtype=np.int64)))
    session = SessionCounters(started=stamp(BEGIN))
    return monitor.report(BEGIN + timedelta(seconds=count / rate_hz), DEVICE, "running", session)


def _not_separable(white: Floats, rate_hz: float) -> Floats:
    """Return the first of some Gauss–Markov noises which, beside white noise, a fit does not separate from flicker."""
    for seed in range(12):
        rng = np.random.default_rng([seed, 7])
        noise = markov_noise(rng, len(white), 0.6e-4, rate_hz * 100.0)
        cascade = OctaveCascade(1, tau0=1.0 / rate_hz)
        cascade.update((white + noise)[:, None])
        if fit_curve(cascade.result(), averaged=False)[0].B.status == "indistinct":
            return noise
    raise AssertionError("every noise is separable")


def markov_noise(rng: np.random.Generator, count: int, sigma: float, time: float) -> Floats:
    """Return (count,) Gauss–Markov noise; its time constant is in samples."""
    import scipy.signal

    ratio = np.exp(-1.0 / time)
    drive = sigma * np.sqrt(1.0 - ratio**2) * rng.standard_normal(count)
    drive[0] = sigma * rng.standard_normal()  # it begins stationary
    noise: Floats = scipy.signal.lfilter([1.0], [1.0, -ratio], drive)
    return noise


def saved() -> dict[str, Report | tuple[Signal, ...]]:
    """Return what tests/data/reports has, by the names of the files."""
    hours, long = Run(), Run(LONG_S, LONG_RATE, seed=4, walk=2.0, convergence=True)
    # the last report contains what the fits of those before showed
    grown = {age: hours.report_at(age) for age in (8.0, 60.0, 200.0, 400.0, 900.0, 3600.0, LENGTH_S)}
    unknown = DeviceDescription(id="vn100", port="/dev/ttyUSB0")
    return {
        "nothing": Record().report(BEGIN, unknown, "starting", SessionCounters()),
        "seconds": grown[8.0],
        "minutes": grown[200.0],
        "hours": grown[LENGTH_S],
        "signals": tuple(make() for name, make in hours.monitor.signals().items() if name in NOISE),
        "long": long.report_at(LONG_S),
        "other": Run(900.0, seed=2, scale=2.0).report_at(900.0),
        "correlated": correlated(),
        "moving": Run(150.0, moving_s=20.0).report_at(150.0),
        "warming_up": Run(200.0, warm_up=True).report_at(200.0),
    }


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, part in saved().items():
        (FOLDER / f"{name}.json.gz").write_bytes(written(part))
