"""The emulator against clients of a VN-100 that others wrote: their commands, and their own checks of what comes back.

`vectornav-vn200` polls a sensor of VectorNav. `vn100-inm-pt` configures a VN-100 and checks both checksums. It asks for
an older pyserial than imumon and works with this one: `pip install --no-deps vn100-inm-pt`.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

import numpy as np
import pytest
from faulty_sensor import spawn
from serial import Serial

from imumon.sources.vn100 import binary
from imumon.sources.vn100.emulator import EmulatorSettings

pytestmark = pytest.mark.slow


def test_a_client_that_polls_reads_everything_that_a_vn100_has() -> None:
    client = pytest.importorskip("vectornav", reason="vectornav-vn200 is not installed (extra peers)")
    with spawn(EmulatorSettings(seed=1)) as running, client.VN200(running.path) as sensor:
        refused = {}
        for name, read in inspect.getmembers(sensor, inspect.ismethod):
            if name.startswith("read_"):
                try:
                    read()
                except client.VN200Error as error:
                    refused[name] = error.code
        assert set(refused.values()) == {8}  # the sensor has no such register
        assert all(re.match("read_(gps|ins)", name) for name in refused), refused
        assert sensor.read_model_number().startswith("VN-100")
        assert np.linalg.norm(list(sensor.read_accel().values())) == pytest.approx(9.79, abs=0.2)


def test_a_client_that_configures_checks_every_reply_and_binary_message() -> None:
    client = pytest.importorskip("vn100.vn100_modules", reason="pip install --no-deps vn100-inm-pt")
    from vn100.iusd import inm_user_settings_descriptor as settings
    from vn100.vn100_modules.resources.mod_16bit_crc import CRC16_CCITT

    system = client.VN100_System_module
    modules = {
        "SYSTEM": system,
        "IMU": client.VN100_IMU_Subsystem,
        "ATTITUDE": client.VN100_Attitude_Subsystem,
    }
    modules["HSIE"] = client.VN100_HSIE_Subsystem
    with spawn(EmulatorSettings(seed=1)) as running, Serial(running.path, 115200, timeout=5) as port:

        def reply_to(command: bytes) -> bytes:
            port.write(command)
            for _ in range(200):  # sentences of 40 Hz
                line: bytes = port.read_until(b"\r\n")
                sentence = line[max(0, line.rfind(b"$VN")) :].strip()
                assert not sentence.startswith(b"$VNERR"), (command, sentence)
                if sentence[:6] == command[:6]:
                    assert client.C8bit_cksm.check_data(sentence)
                    return sentence
            raise AssertionError((command, line))

        for module in modules.values():  # every register that it can read
            for name, read in inspect.getmembers(module, inspect.isfunction):
                if name.startswith("get_") and not inspect.signature(read).parameters:
                    reply_to(read())
        for step in settings["content"].values():  # what it writes at its start
            subsystem, _, function = str(step["function"]).partition("_")
            arguments: dict[str, Any] = step["args"]
            reply_to(getattr(modules[subsystem], function.lower())(**arguments))
            if function == "RESET":
                assert port.read_until(b"\r\n")  # it runs again
        port.reset_input_buffer()
        data = port.read(4096)
    headers = [i for i in range(len(data) - 200) if data[i] == binary.SYNC and binary.parse_header(data[i:])]
    lengths = {i: layout.length for i in headers if (layout := binary.parse_header(data[i:]))}
    messages = [data[i : i + length] for i, length in lengths.items()]
    assert sum(CRC16_CCITT.check_vn_binary_data(message) for message in messages) >= 10
