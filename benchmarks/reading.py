"""Reading never stalls: 800 Hz at 921600 baud from the emulator, behind a reader that is busy elsewhere.

Every few seconds the loop does something else for a second and a half, as a fit, a slow disk or a stuck
subscriber would have it do. Printed: samples that the sensor's clock says were made, those that are missing,
overruns, and the share of a core that port, session and decoder take.

    python benchmarks/reading.py [SECONDS]
"""

from __future__ import annotations

import resource
import sys
import time

import numpy as np

from imumon.emulator import EmulatorSettings, spawn
from imumon.samples import SampleBlock
from imumon.sensors.vn100.session import Session, Wanted
from imumon.sources import SerialPort

STALL_S, EVERY_S = 1.5, 5.0


def main(seconds: float) -> None:
    with spawn(EmulatorSettings(seed=1)) as emulator, SerialPort(emulator.path) as port:
        session = Session(port, Wanted(set_baud=921600), time.monotonic)
        session.connect()
        rate = session.configure().sample_rate_hz
        times: list[np.ndarray] = []
        used = resource.getrusage(resource.RUSAGE_SELF)
        begun = time.monotonic()
        stall = begun + EVERY_S
        while (now := time.monotonic()) < begun + seconds:
            blocks = [item for item in session.decode(session.read(0.2)) if isinstance(item, SampleBlock)]
            times += [block.time_ns for block in blocks if block.time_ns is not None]
            for notice in session.tick():
                print(notice.text)
            if now > stall:
                time.sleep(STALL_S)
                stall = time.monotonic() + EVERY_S
        after = resource.getrusage(resource.RUSAGE_SELF)
        steps = np.rint(np.diff(np.concatenate(times)) / (1e9 / (rate or 1.0)))
        cpu = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
        print(f"{rate:.0f} Hz at {port.baud} baud for {seconds:.0f} s, {STALL_S} s stalls every {EVERY_S} s")
        print(f"samples {len(steps) + 1}, missing {int((steps - 1).sum())}, overruns {port.overruns}")
        print(f"bad checks {session.decoder.bad_checksums}, discarded {session.decoder.discarded} bytes")
        print(f"reading and decoding take {100 * cpu / (time.monotonic() - begun):.1f} % of a core")
        session.restore()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
