"""Settings of the emulator: identity, noise and speed.

The defaults are a VN-100 with the noise of its datasheet (gyroscope 0.0035 deg/s/sqrt(Hz), 5 deg/h in run;
accelerometer 0.14 mg/sqrt(Hz)), equal on the three axes, so that measured values can be compared with
configured ones.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from imumon.sources.clock import HostClock
from imumon.sources.device import InvalidOption
from imumon.sources.vn100.registers import ASCII_RATES, LOOP_RATE

Axes: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise coefficients of a sensor for its axes x, y, z (IEEE Std 952).

    Attributes
    ----------
    n : random walk, channel unit / sqrt(Hz).
    b : bias instability, channel unit; the floor of the Allan deviation is 0.664 b.
    k : rate random walk, channel unit * sqrt(Hz).
    """

    n: Axes
    b: Axes
    k: Axes

    @staticmethod
    def equal(n: float, b: float, k: float) -> Noise:
        """Return the same coefficients for each axis."""
        return Noise((n, n, n), (b, b, b), (k, k, k))


FASTEST = 1e4
"""Largest time-lapse factor."""

GYRO = Noise.equal(6.1e-5, 2.4e-5, 1e-6)
ACCEL = Noise.equal(1.37e-3, 2e-4, 1e-5)
MAG = Noise.equal(1.4e-4, 2e-5, 1e-6)
_UNITS = {"gyro": "rad/s", "accel": "m/s^2"}


@dataclass(frozen=True, slots=True)
class EmulatorSettings:
    """Settings of the emulator; most are options of `imumon sim` of the same names.

    Attributes
    ----------
    rate : Hz, output rate at power-up: VNYMR if it can have that rate, else a binary output.
    baud : bit/s; None: the factory baud, or the next higher one that carries the rate.
    speed : seconds of the sensor clock per second of the host clock; above 1 the sensor waits for its reader.
    seed : of the noise; None: a different one each time.
    link : symbolic link to maintain to the pseudo-terminal.
    serial_port : number of the port of the sensor that is the pseudo-terminal.
    warm_up, warm_up_s : degC and s, temperature rise after power-up and its time constant.
    gyro_thermal : rad/s/degC, temperature coefficient of the gyroscope bias.
    """

    rate: float = 40.0
    baud: int | None = None
    speed: float = 1.0
    gyro: Noise = GYRO
    accel: Noise = ACCEL
    mag: Noise = MAG
    seed: int | None = None
    link: str | None = None
    firmware: str = "3.1.0.0"
    model: str = "VN-100T-CR"
    serial: str = "0100056785"
    serial_port: int = 1
    warm_up: float = 8.0
    warm_up_s: float = 600.0
    gyro_thermal: float = 1e-6

    def __post_init__(self) -> None:
        def require(valid: bool, name: str, cure: str) -> None:
            if not valid:
                value = getattr(self, name)
                text = f"{value:g}" if isinstance(value, float) else value
                raise InvalidOption(f"{name}_invalid", f"--{name} {text}", cure)

        rate_valid = self.rate == 0 or (self.rate > 0 and LOOP_RATE % self.rate == 0)
        require(rate_valid, "rate", f"a VN-100 sends at {LOOP_RATE} Hz divided by a whole number")
        require(0 < self.speed <= FASTEST, "speed", f"give a number above 0, up to {FASTEST:.0f}")
        require(self.seed is None or self.seed >= 0, "seed", "give 0 or a positive whole number")

    @property
    def time_lapse(self) -> bool:
        return self.speed > 1.0


def time_lapse_settings(clock: HostClock, seed: int | None) -> EmulatorSettings:
    """Return the settings of an emulator whose sample clock runs beside a host clock."""
    return EmulatorSettings(speed=clock.time_lapse, seed=seed)


def _noise(text: str) -> Noise:
    """Return the noise of N, B and K, which are separated by commas."""
    try:
        n, b, k = (float(part) for part in text.split(","))
    except ValueError:
        n = b = k = -1.0
    if not all(0.0 <= number < float("inf") for number in (n, b, k)):
        raise argparse.ArgumentTypeError(f"{text!r}: give N,B,K, three numbers of 0 or more")
    return Noise.equal(n, b, k)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the emulator; the help shows their defaults."""
    standard = EmulatorSettings()
    line = parser.add_argument_group("serial line")
    noise = parser.add_argument_group("noise")

    def number(group: Any, name: str, metavar: str, text: str) -> None:
        default = getattr(standard, name)
        text = f"{text} (default {default:g})"
        option = f"--{name.replace('_', '-')}"
        group.add_argument(option, type=float, default=default, metavar=metavar, help=text)

    rates = ", ".join(map(str, ASCII_RATES))
    number(line, "rate", "HZ", f"output rate: VNYMR at {rates}, others in binary")
    number(line, "speed", "X", "time-lapse: the sensor clock runs X times faster and waits for the reader")
    line.add_argument("--link", metavar="PATH", help="create a symbolic link to the pseudo-terminal")
    for sensor, unit in _UNITS.items():
        default: Noise = getattr(standard, sensor)
        given = ",".join(f"{values[0]:g}" for values in (default.n, default.b, default.k))
        text = f"in {unit}/sqrt(Hz), {unit} and {unit}*sqrt(Hz) (default {given})"
        noise.add_argument(f"--{sensor}", type=_noise, default=default, metavar="N,B,K", help=text)
    text = "seed of the noise (default: a different one each time)"
    noise.add_argument("--seed", type=int, metavar="N", help=text)
    number(noise, "warm_up", "DEGC", "temperature rise after power-up, degC")


def from_arguments(arguments: argparse.Namespace) -> EmulatorSettings:
    """Return the settings of parsed options.

    Raises
    ------
    InvalidOption : a value that no VN-100 can have.
    """
    names = [entry.name for entry in fields(EmulatorSettings)]
    return EmulatorSettings(**{name: getattr(arguments, name) for name in names if hasattr(arguments, name)})
