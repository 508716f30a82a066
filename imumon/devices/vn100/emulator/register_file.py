"""Memory of the device: its registers as they are, and as they would be after a reset.

Fields are text, as on the wire. Registers 5-7 exist once for each of the two ports, and the one that the
host talks through is the active one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from imumon.devices.vn100.registers import REGISTERS, Generation, Value

Key: TypeAlias = tuple[int, int]
"""Register and port; port 0 where the register is the same for both."""


class RegisterFile:
    """Registers of one device.

    Parameters
    ----------
    generation : of the firmware.
    port : the active one, 1 or 2.
    """

    def __init__(self, generation: Generation, port: int) -> None:
        self.generation: Generation = generation
        self.port = port
        self._saved: dict[Key, tuple[str, ...]] = {}
        self.forget()
        self._now = dict(self._saved)

    def key(self, register: int, port: int | None = None) -> Key:
        return register, (port or self.port) if REGISTERS[register].ports else 0

    def __contains__(self, register: int) -> bool:
        return self.key(register) in self._now

    def read(self, register: int, port: int | None = None) -> tuple[str, ...]:
        """Fields of a register, of the active port unless another is named."""
        return self._now[self.key(register, port)]

    def parse(self, register: int) -> dict[str, Value]:
        """Values of a register by field name."""
        return REGISTERS[register].parse(self.read(register))

    def write(self, register: int, values: Sequence[str], port: int | None = None) -> None:
        """Replace a register's fields; they are the caller's to check."""
        self._now[self.key(register, port)] = tuple(values)

    def changed(self, register: int, values: Sequence[str], port: int | None = None) -> RegisterFile:
        """The memory as it would be after `write`."""
        other = RegisterFile(self.generation, self.port)
        other._now = {**self._now, self.key(register, port): tuple(values)}
        return other

    def save(self) -> None:
        """Make the registers as they are those of the next start."""
        self._saved = dict(self._now)

    def restore(self) -> None:
        """What was not saved is lost."""
        self._now = dict(self._saved)

    def forget(self) -> None:
        """The next start is one with factory values."""
        self._saved = {
            (register.id, port): register.factory_values(self.generation)
            for register in REGISTERS.values()
            if register.in_generation(self.generation) and register.access == "setting"
            for port in ((1, 2) if register.ports else (0,))
        }
