"""Judge: facts in, checks out, purely: what was seen is `ok`, a `warning`, or `failed`, with the cure.

`failed` is what keeps `imumon run` from working or spoils its figures, a `warning` what a user should know.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from imumon.config import Settings
from imumon.devices.vn100.registers import DELTA_CONTROL, IMU_FILTER, LOOP_RATE
from imumon.devices.vn100.stream_settings import divisors
from imumon.doctor.observations import BusLook, Heard, PortLook, ServiceLook, StateLook

Status: TypeAlias = Literal["ok", "warning", "failed"]

MANY = 0.01
"""Share of damaged or lost messages above which a line is no good."""
LATENCY_MS = 2
FULL, OVERFULL = 0.8, 0.955
"""Share of the baud in use that is much, and that a VN-100 is known to carry."""
ROOM_BYTES = 10_000_000
SLOW_HZ = 40.0
"""Below this rate of the deltas another baud is worth it."""


@dataclass(frozen=True, slots=True)
class Check:
    """One line: `name` is one word, `text` what was seen, `cure` how to mend it where that is needed."""

    name: str
    status: Status
    text: str
    cure: str | None = None


COME_BACK = "check the sensor's plug, cable and power; the daemon goes on by itself when it is back"
NO_PORT = Check(
    "port",
    "failed",
    "no serial port on this machine",
    "plug the sensor in, and pass it through to a container or virtual machine; "
    "without a sensor: imumon demo",
)


def config(settings: Settings, faults: Sequence[str]) -> Check:
    """Whether the settings can be used."""
    if faults:
        first, *others = faults
        more = f" (and {len(others)} more)" if others else ""
        return Check("config", "failed", first + more, "imumon config check tells them all")
    return Check("config", "ok", str(settings.path) if settings.path else "no file, the defaults hold")


def passed_over(path: str, checks: Iterable[Check]) -> Check:
    """A port on which no sensor was found while there are others to try."""
    why = next((check.text for check in checks if check.status == "failed"), "no sensor")
    return Check("port", "warning", f"{path} passed over: {why}")


def port(look: PortLook) -> Iterator[Check]:
    """Whether the port is there, may be used, and is free."""
    if look.is_url:
        yield Check("port", "ok", look.path)
        return
    if not look.exists and look.daemon is not None:
        yield Check("port", "failed", f"no port {look.path}: {look.daemon} waits for it", COME_BACK)
        return
    if not look.exists:
        there = f"there is {', '.join(look.others)}" if look.others else "is the sensor plugged in?"
        yield Check("port", "failed", f"no port {look.path}", there)
        return
    if not look.character:
        cure = f"to read a recording: imumon replay {look.path}"
        yield Check("port", "failed", f"{look.path} is not a serial port", cure)
        return
    yield Check("port", "ok", f"{look.path} {look.described}".strip())
    yield _permission(look)
    yield _holder(look)


def _permission(look: PortLook) -> Check:
    if look.accessible:
        return Check("permission", "ok", f"{look.user} may read and write it")
    if look.group is None or look.group == "root":
        cure = "a udev rule gives it to a group: see docs/SENSOR.md"
    elif look.member:
        cure = "log out and in again: the group is new"
    else:
        cure = f"sudo usermod -aG {look.group} {look.user}, then log in again"
    return Check("permission", "failed", f"{look.user} may not read and write {look.path}", cure)


def _holder(look: PortLook) -> Check:
    if look.daemon is not None:
        return Check("holder", "ok", f"the daemon {look.daemon} reads it and is asked instead")
    if not look.holders:
        return Check("holder", "ok", "no other program has it open")
    who = ", ".join(look.holders)
    ours = any(name.startswith(("imumon", "python")) for name in look.holders)
    cure = "end that program first" + ("; a daemon of ours: name its endpoint with --connect" if ours else "")
    if any(name.startswith("ModemManager") for name in look.holders):
        cure = "sudo systemctl disable --now ModemManager, or a udev rule with ID_MM_DEVICE_IGNORE=1"
    return Check("holder", "failed", f"{look.path} is in use by {who}", cure)


def latency(look: PortLook) -> Iterator[Check]:
    """The FTDI adapter's timer, where there is one."""
    if look.latency_ms is None:
        return
    text = f"the adapter hands bytes over every {look.latency_ms} ms"
    if look.latency_ms <= LATENCY_MS:
        yield Check("latency", "ok", text)
    else:
        name = os.path.basename(os.path.realpath(look.path))
        cure = (
            f"echo 1 | sudo tee /sys/bus/usb-serial/devices/{name}/latency_timer; N, B and K do not suffer, "
            "time is the sensor's own"
        )
        yield Check("latency", "warning", text, cure)


def unheard(why: str) -> Check:
    """No sensor could be heard; the reason holds the cure behind its first colon."""
    text, _, cure = why.partition(": ")
    return Check("sensor", "failed", text, cure or None)


def sensor(heard: Heard, settings: Settings) -> Iterator[Check]:
    """Everything about a sensor that was heard."""
    if heard.gone is not None:
        yield Check("sensor", "failed", heard.gone, "check the plug and the cable's strain relief")
    yield _baud(heard, settings)
    yield _identity(heard)
    yield _stream(heard)
    if heard.facts.stream is not None:
        yield _aliasing(heard)
        yield _compensation(heard)
    if heard.messages:
        yield _bandwidth(heard)
        yield _checksums(heard)
    if heard.samples:
        yield _rate(heard)
        yield from _clock(heard)


def _baud(heard: Heard, settings: Settings) -> Check:
    baud, told = heard.facts.baud, settings.device.baud
    if baud is None or (heard.facts.port or "").startswith("socket://"):
        return Check("baud", "ok", "does not matter on this port")
    if told not in ("auto", baud):
        cure = 'set device.baud = "auto"'
        return Check("baud", "failed", f"the sensor is at {baud} baud, the settings say {told}", cure)
    best = LOOP_RATE / divisors("deltas", baud)[0]
    if best < SLOW_HZ:
        text = f"{baud} baud carries the deltas at {best:g} Hz only"
        return Check("baud", "warning", text, "imumon run --set-baud 115200 (until its next power-up)")
    return Check("baud", "ok", f"{baud} baud, carries the deltas at {best:g} Hz")


def _identity(heard: Heard) -> Check:
    facts = heard.facts
    if facts.model is None:
        text = "not asked for: the sensor is only listened to"
        return Check("identity", "warning", text, "without listen_only its model and settings are read")
    who = f"{facts.model} {facts.serial or 'without a serial number'}, firmware {facts.firmware or 'unknown'}"
    if not facts.model.upper().startswith("VN-100"):
        return Check(
            "identity", "warning", f"{who}: it is treated like a VN-100", "check its filter yourself"
        )
    return Check("identity", "ok", who)


def _stream(heard: Heard) -> Check:
    facts = heard.facts
    if heard.daemon is not None and heard.state != "running":
        text = f"the daemon is {heard.state}: no samples come"
        return Check("stream", "failed", text, "check the sensor's power and its cable")
    if heard.longest_pause_s > 1.0 and heard.samples:
        text = f"{facts.source}, but for {heard.longest_pause_s:.1f} s nothing came"
        return Check("stream", "warning", text, "check power and cable; another program may be stalling USB")
    if heard.samples:
        return Check("stream", "ok", f"{facts.source}, {facts.stream}")
    if heard.messages:
        text = "messages come, but none that can be characterised"
    elif heard.discarded or heard.bad_checksums:
        text = "bytes come, but nothing valid"
        return Check("stream", "failed", text, "check the cable and its ground, and try a shorter one")
    else:
        text = "the sensor answers and sends nothing by itself"
    return Check("stream", "warning", text, "imumon run sets up its own stream; --listen-only cannot")


def _aliasing(heard: Heard) -> Check:
    facts = heard.facts
    window = next((t for n, t in facts.settings.items() if n.startswith(f"{IMU_FILTER} ")), None)
    behind = f", register {IMU_FILTER} is {window}" if window else ""
    if facts.alias_factor is None:
        text = "not known: the sensor's filter or rate could not be read"
        return Check("aliasing", "warning", text, "without listen_only it is read, and deltas have none")
    if facts.alias_factor <= 1.001:
        return Check("aliasing", "ok", f"none{behind}")
    text = f"N of {facts.source} reads {facts.alias_factor:.2f} times too high{behind}"
    cure = "imumon run takes the deltas, which are right; docs/SENSOR.md tells why, and what else helps"
    return Check("aliasing", "warning", text, cure)


def _compensation(heard: Heard) -> Check:
    control = next((t for n, t in heard.facts.settings.items() if n.startswith(f"{DELTA_CONTROL} ")), "")
    if heard.facts.stream == "deltas" and any(field.strip("0") for field in control.split(",")[1:3]):
        text = f"the deltas are compensated, register {DELTA_CONTROL} is {control}"
        return Check("compensation", "warning", text, "imumon run sets it to 0 for as long as it runs")
    if heard.facts.stream != "compensated":
        return Check(
            "compensation", "ok", f"the stream is {heard.facts.stream}: B and K are the sensor's own"
        )
    text = f"{heard.facts.source} has the filter's bias taken out: B and K would be the filter's"
    return Check("compensation", "warning", text, "imumon run takes the uncompensated deltas")


def _bandwidth(heard: Heard) -> Check:
    if not heard.facts.baud or (heard.facts.port or "").startswith("socket://"):
        return Check("bandwidth", "ok", f"{heard.bytes / heard.seconds:.0f} bytes/s")
    share = heard.bytes / heard.seconds / (heard.facts.baud / 10)
    text = f"{share:.0%} of {heard.facts.baud} baud"
    if share <= FULL:
        return Check("bandwidth", "ok", text)
    status: Status = "warning" if share <= OVERFULL or share > 1.05 else "failed"
    if share > 1.05:  # no serial line carries that: a pseudo-terminal, or an adapter that ignores the baud
        return Check("bandwidth", "ok", f"{text}: no real line, the baud limits nothing")
    return Check("bandwidth", status, text, "ask for a lower rate, or raise the baud with --set-baud")


def _checksums(heard: Heard) -> Check:
    bad, all_of_it = heard.bad_checksums, heard.messages + heard.bad_checksums
    text = f"{bad} of {all_of_it} messages damaged in {heard.seconds:.0f} s"
    stray = f", {heard.discarded} bytes of no message" if heard.discarded else ""
    if not bad and not heard.discarded:
        return Check("checksums", "ok", text)
    share = max(bad / all_of_it, heard.discarded / max(heard.bytes, 1))
    cure = "check the cable and its ground, keep it short and away from motors; a lower baud forgives more"
    return Check("checksums", "failed" if share > MANY else "warning", text + stray, cure)


def _rate(heard: Heard) -> Check:
    nominal, rate = heard.facts.sample_rate_hz, heard.rate_hz
    missing = heard.missing or 0
    text = f"{rate:.1f} Hz" if rate is not None else f"{heard.samples} samples"
    if missing:
        lost = missing / (missing + heard.samples)
        text += f", {missing} samples missing"
        cure = (
            "gaps are known and harmless when few; a full line, a bad cable or a busy machine loses samples"
        )
        return Check("rate", "failed" if lost > 10 * MANY else "warning", text, cure)
    if nominal is None:
        cure = "give imumon run the rate with --rate where the stream has no clock"
        return Check("rate", "warning", f"{text}, what it should be is not known", cure)
    if rate is None:
        return Check("rate", "ok", f"{text}, {nominal:g} Hz set")
    ratio, slack = rate / nominal, 0.02 + 3.0 / heard.samples
    text += f" of {nominal:g} Hz set"
    if ratio > 1.0 + slack:
        return Check("rate", "warning", text, "messages come twice: does a hub or a splitter echo them?")
    if ratio < 1.0 - slack:
        cure = "messages are lost whole: check power, cable and adapter"
        return Check("rate", "failed" if ratio < 1.0 - 10 * MANY - slack else "warning", text, cure)
    return Check("rate", "ok", text)


def _clock(heard: Heard) -> Iterator[Check]:
    if heard.leaps:
        text = f"the sensor's clock leapt {heard.leaps} time{'s' if heard.leaps > 1 else ''}"
        yield Check("clock", "failed", text, "it restarted: check its power supply")
    elif heard.clock_ratio is not None:
        text = f"the sensor's second lasts {1.0 / heard.clock_ratio:.3f} s of the room"
        slack = 0.02 + 0.1 / heard.seconds
        if abs(heard.clock_ratio - 1.0) <= slack:
            yield Check("clock", "ok", text)
        else:
            cure = "N, B and K are per second of the sensor: check its TimeStartup against a watch"
            yield Check("clock", "warning", text, cure)


def zenoh(look: BusLook) -> Check:
    """Who answers, and whether a daemon would find a place to listen."""
    who = ", ".join(report.device.id for report in look.reports)
    if look.exposed:
        text = f"{look.exposed[0]} is open to everybody on the network"
        return Check("zenoh", "warning", text, "use tls/ with certificates: docs/ZENOH.md")
    if look.unreachable:
        text = f"nobody answers at {', '.join(look.unreachable)}"
        return Check("zenoh", "warning", text, "start the router there, or take it out of zenoh.connect")
    if look.free is None and not look.reports:
        text, _, cure = (look.fault or "no place to listen").rpartition("; ")
        return Check("zenoh", "failed", text or cure, cure if text else None)
    if not look.reports:
        return Check("zenoh", "ok", f"no daemon answers, {look.free} is free for one")
    lost = [report.device for report in look.reports if report.state == "waiting"]
    if lost:
        others = [report.device.id for report in look.reports if report.device != lost[0]]
        text = f"{lost[0].id} answers, but waits for its sensor on {lost[0].port or 'its port'}"
        text += f"; {', '.join(others)} answers too" if others else ""
        return Check("zenoh", "warning", text, COME_BACK)
    room = f", {look.free} is free for another" if look.free else ""
    return Check("zenoh", "ok", f"{who} answers{room}")


def state(look: StateLook) -> Check:
    """Whether statistics can be kept."""
    if not look.writable:
        cure = "choose another with --state or state.directory, or mend its owner"
        return Check("state", "failed", look.fault or f"{look.path} cannot be written", cure)
    if look.free_bytes is not None and look.free_bytes < ROOM_BYTES:
        text = f"{look.path}: only {look.free_bytes / 1e6:.1f} MB free"
        return Check("state", "warning", text, "make room: a state takes a megabyte, a recording more")
    known = f", {look.records} saved in it" if look.records else ""
    return Check("state", "ok", f"{look.path} can be written{known}")


def service(look: ServiceLook) -> Check:
    """Whether the daemon runs as a service, where there are services."""
    if not look.running:
        return Check("service", "ok", "no systemd here: imumon run by hand")
    if not look.installed:
        return Check("service", "ok", "not installed: imumon run by hand, or as the README says")
    failed = [name for name, state in look.units if state == "failed"]
    if failed:
        cure = f"journalctl -u {failed[0]} tells why; then systemctl restart {failed[0]}"
        return Check("service", "failed", f"{failed[0]} has failed", cure)
    active = [name for name, state in look.units if state in ("active", "activating", "reloading")]
    if active:
        return Check("service", "ok", f"{', '.join(active)} active")
    cure = "systemctl enable --now imumon@ttyUSB0 (the name of the port)"
    return Check("service", "warning", "installed, but not active", cure)
