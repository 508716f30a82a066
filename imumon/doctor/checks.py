"""Checks: observations to lines with a status and a cure, as pure functions.

`failed` prevents `imumon run` from working or falsifies its figures; a `warning` is what a user should know.
The checks of a device apply to any kind; its driver replaces or adds those that need more knowledge.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from imumon.config import Settings
from imumon.doctor.observed import ServiceObservation, StateObservation, ZenohObservation
from imumon.grid.interval import RATE_TOLERANCE
from imumon.model.report import MAX_LOSS
from imumon.model.samples import ALIASED
from imumon.model.units import counted
from imumon.sources.device import (
    ARRIVAL_SAMPLES,
    READ_S,
    Check,
    CheckStatus,
    DeviceError,
    Observation,
)

MAX_MISSING = 0.1  # share of missing samples, or relative deficit of the rate, above which a line is unusable
MAX_PAUSE_S = 1.0  # s without data that need no warning
MIN_FREE_BYTES = 10_000_000  # bytes on the file system of the state directory: ten states

DEVICE_CHECKS = (
    "sensor", "baud", "model", "stream", "aliasing", "compensation", "load", "checksums", "rate",
    "clock",
)  # fmt: skip
"""Order of the checks of a device; others follow."""

REQUEST = "imumon run requests a better stream, if the sensor has one"
RECONNECT_CURE = "check the plug, cable and power of the sensor; the daemon reconnects by itself"
OTHER_READER = " or another user's program (sudo fuser -v PORT)"


def config(settings: Settings, faults: tuple[str, ...]) -> Check:
    """Check whether the settings can be used."""
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return Check("config", "failed", faults[0] + more, "imumon config check shows all of them")
    return Check("config", "ok", str(settings.path) if settings.path else "no file: the defaults apply")


# ---------------------------------------------------------------------- device


def no_device(error: DeviceError) -> Check:
    """Return the check of a port that does not open, or of a device that cannot be used."""
    name = "port" if error.code.startswith("port_") else "sensor"
    return Check(name, "failed", error.message, error.cure or None)


def port(path: str, daemon: str | None) -> Check:
    """Return the check of a port that is open: here, or in a daemon."""
    used = f", read by the daemon {daemon}: its counters are checked" if daemon is not None else ""
    return Check("port", "ok", f"{path}{used}")


def device(observation: Observation, specific: Iterable[Check], max_loss: float = MAX_LOSS) -> list[Check]:
    """Return the checks of a device in order.

    Parameters
    ----------
    specific : checks of its driver; each replaces the generic one of the same name.
    max_loss : share of missing or damaged messages that is no fault.
    """
    by_name = {check.name: check for check in (*_generic(observation, max_loss), *specific)}
    known = [by_name.pop(name) for name in DEVICE_CHECKS if name in by_name]
    return [*known, *by_name.values()]


def _generic(observation: Observation, max_loss: float) -> Iterator[Check]:
    """Yield the checks that apply to any device."""
    if observation.lost is not None:
        yield Check("sensor", "failed", observation.lost, "check the plug and the strain relief of the cable")
    yield _model(observation)
    yield _stream(observation)
    if observation.info.stream is not None:
        yield _aliasing(observation)
        yield _compensation(observation)
    if observation.messages:
        yield _checksums(observation, max_loss)
    if observation.samples:
        yield _rate(observation)
        yield from _clock(observation)


def _model(observation: Observation) -> Check:
    info = observation.info
    if info.model is None:
        return Check(
            "model",
            "warning",
            f"the {info.kind} does not report its model",
            "identify it by its port, or let imumon ask it",
        )
    serial = info.serial or "without a serial number"
    return Check("model", "ok", f"{info.model} {serial}, firmware {info.firmware or 'unknown'}")


def _stream(observation: Observation) -> Check:
    """Check whether samples arrive, without long pauses."""
    info, pause = observation.info, observation.longest_pause_s
    if observation.daemon is not None and observation.state != "running":
        text = f"the daemon is {observation.state}: no samples arrive"
        return Check("stream", "failed", text, "check the power and the cable of the sensor")
    if pause > MAX_PAUSE_S and observation.samples:
        text = f"{info.source}, but no data for {pause:.1f} s"
        return Check("stream", "warning", text, "check power and cable; another program may delay USB")
    if observation.samples:
        return Check("stream", "ok", f"{info.source}, {info.stream}")
    if observation.messages:
        text = "messages arrive, but none that can be characterised"
    elif observation.discarded or observation.bad_checksums:
        text = "bytes arrive, but no valid message"
        return Check("stream", "failed", text, "check the cable and its ground, and try a shorter one")
    else:
        text = f"the {info.kind} answers and sends nothing by itself"
    return Check("stream", "warning", text, "imumon run starts a stream, but not with --listen-only")


def _aliasing(observation: Observation) -> Check:
    """Check whether the alias factor is known and harmless."""
    info = observation.info
    cure = f"{REQUEST}; else configure its filter to average over the output interval"
    if info.alias_factor is None and info.stream != "deltas":
        text = f"unknown: the {info.kind} does not report its filter or its rate"
        return Check("aliasing", "warning", text, cure)
    if info.alias_factor is None or info.alias_factor <= ALIASED:
        return Check("aliasing", "ok", "none")
    text = f"N of {info.source} reads {info.alias_factor:.2f} times too high"
    return Check("aliasing", "warning", text, cure)


def _compensation(observation: Observation) -> Check:
    """Check whether the samples are those of the sensor or of a filter behind it."""
    info = observation.info
    if info.stream == "compensated" or "compensated" in info.caveats:
        text = f"{info.source} is compensated by a filter: B and K would be those of the filter"
        return Check("compensation", "warning", text, f"{REQUEST}; else select an uncompensated one")
    if info.stream == "unknown" or "unknown_compensation" in info.caveats:
        text = f"unknown whether {info.source} is compensated: B and K may be those of a filter"
        return Check("compensation", "warning", text, "see the settings of its driver or of the sensor")
    return Check("compensation", "ok", f"the stream is {info.stream}: B and K are those of the sensor")


def _checksums(observation: Observation, max_loss: float) -> Check:
    """Check how many messages were damaged."""
    bad = observation.bad_checksums
    total = observation.messages + bad
    text = f"{bad} of {total} messages damaged in {observation.seconds:.0f} s"
    if not bad and not observation.discarded:
        return Check("checksums", "ok", text)
    if observation.discarded:
        text += f", {observation.discarded} unrelated bytes"
    share = max(bad / total, observation.discarded / max(observation.bytes, 1))
    cure = (
        "check the cable and its ground, keep it short and away from motors; a lower baud rate is more robust"
    )
    return Check("checksums", "failed" if share > max_loss else "warning", text, cure)


def _rate(observation: Observation) -> Check:
    """Check whether samples are missing, and the rate against the configured one."""
    nominal, rate, samples = observation.info.sample_rate_hz, observation.rate_hz, observation.samples
    text = f"{rate:.1f} Hz" if rate is not None else f"{samples} samples"
    if missing := observation.missing or 0:
        share = missing / (missing + samples)
        cure = f"few gaps are harmless; a full line, a bad cable, a busy machine{OTHER_READER} loses samples"
        status: CheckStatus = "failed" if share > MAX_MISSING else "warning"
        return Check("rate", status, f"{text}, {counted(missing, 'sample')} missing", cure)
    if nominal is None and observation.clock_ratio is not None:  # the samples have a clock
        return Check("rate", "ok", text)
    if nominal is None:
        cure = "give the rate to imumon run (--rate) if the stream has no clock"
        return Check("rate", "warning", f"{text}, the configured rate is unknown", cure)
    if rate is None:
        return Check("rate", "ok", f"{text}, {nominal:g} Hz configured")
    excess, tolerance = rate / nominal - 1.0, RATE_TOLERANCE + ARRIVAL_SAMPLES / samples
    text += f" of {nominal:g} Hz configured"
    if excess > tolerance:
        return Check(
            "rate", "warning", text, "messages arrive twice: remove hubs and splitters that echo them"
        )
    if excess < -tolerance:
        status = "failed" if excess < -MAX_MISSING - tolerance else "warning"
        return Check("rate", status, text, f"whole messages are lost to power, cable, adapter{OTHER_READER}")
    return Check("rate", "ok", text)


def _clock(observation: Observation) -> Iterator[Check]:
    """Check whether the sample clock is continuous, and its rate against the host clock."""
    jumps, ratio = observation.clock_jumps, observation.clock_ratio
    if jumps:
        text = f"the sample clock jumped {jumps} time{'s' if jumps > 1 else ''}"
        yield Check("clock", "failed", text, "the sensor restarted: check its power supply")
    elif ratio is not None:
        text = f"one second of the sample clock takes {1.0 / ratio:.3f} s of the host clock"
        if abs(ratio - 1.0) <= RATE_TOLERANCE + READ_S / observation.seconds:
            yield Check("clock", "ok", text)
        else:
            cure = "the coefficients use the sample clock: check it against an independent clock"
            yield Check("clock", "warning", text, cure)


# ---------------------------------------------------------------------- Zenoh, state, service


def zenoh(zenoh: ZenohObservation) -> Check:
    """Check which daemons answer, and whether another one could listen."""
    if zenoh.rivals:
        id, sessions = next(iter(zenoh.rivals.items()))
        text = f"{len(sessions)} programs publish {id}: the Zenoh sessions {' and '.join(sessions)}"
        cure = "the first is shown; end the other, or use a Unix socket: see docs/ZENOH.md"
        return Check("zenoh", "warning", text, cure)
    if zenoh.unreachable:
        text = f"no answer from {', '.join(zenoh.unreachable)}"
        return Check("zenoh", "warning", text, "start the router there, or remove it from zenoh.connect")
    if zenoh.reports:
        return _running(zenoh)
    if zenoh.free is not None:
        return Check("zenoh", "ok", f"no daemon is running; the next one can listen on {zenoh.free}")
    if zenoh.error is None:
        return Check("zenoh", "failed", "no free endpoint", "give one with --listen")
    return Check("zenoh", "failed", zenoh.error.message, zenoh.error.cure or None)


def _running(zenoh: ZenohObservation) -> Check:
    """Return which daemons answer, and which of them waits for its sensor."""
    waiting = next((report.device for report in zenoh.reports if report.state == "waiting"), None)
    if waiting is not None:
        others = [report.device.id for report in zenoh.reports if report.device != waiting]
        text = f"the daemon {waiting.id} waits for its sensor on {waiting.port or 'its port'}"
        text += f"; also running: {', '.join(others)}" if others else ""
        return Check("zenoh", "warning", text, RECONNECT_CURE)
    ids = ", ".join(report.device.id for report in zenoh.reports)
    free = f"; another daemon can listen on {zenoh.free}" if zenoh.free else ""
    return Check("zenoh", "ok", f"running: {ids}{free}")


def state(state: StateObservation) -> Check:
    """Check whether statistics can be saved."""
    if state.problem is not None:
        cure = "choose another with --state or state.directory, or correct its owner"
        return Check("state", "failed", state.problem, cure)
    if state.free_bytes is not None and state.free_bytes < MIN_FREE_BYTES:
        text = f"{state.path}: only {state.free_bytes / 1e6:.1f} MB free"
        return Check("state", "warning", text, "free some space: a state takes a megabyte, a recording more")
    saved = f", {state.records} saved in it" if state.records else ""
    return Check("state", "ok", f"{state.path} can be written{saved}")


def service(service: ServiceObservation) -> Check:
    """Check whether the daemon runs as a service, if there is a service manager."""
    if not service.running:
        return Check("service", "ok", "no systemd here: start imumon run yourself")
    if not service.installed:
        return Check("service", "ok", "not installed: start imumon run yourself, or see the README")
    failed = [name for name, state in service.units if state == "failed"]
    if failed:
        cure = f"journalctl -u {failed[0]} shows the reason; then systemctl restart {failed[0]}"
        return Check("service", "failed", f"{failed[0]} has failed", cure)
    active = [name for name, state in service.units if state in ("active", "activating", "reloading")]
    if active:
        return Check("service", "ok", f"{', '.join(active)} active")
    cure = "systemctl enable --now imumon@ttyUSB0 (the name of the port)"
    return Check("service", "warning", "installed, but not active", cure)
