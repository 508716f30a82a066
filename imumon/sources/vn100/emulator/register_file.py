"""Register file of the emulated device: current values, and the values after the next reset.

Values are text, as on the wire. Registers 5 to 7 exist once for each of the two serial ports; the port that
the host uses is the active one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from imumon.sources.vn100.registers import REGISTERS

Key: TypeAlias = tuple[int, int]
"""Register and port; port 0 if the register is common to both."""


class RegisterFile:
    """Registers of one device.

    Parameters
    ----------
    port : the active serial port, 1 or 2.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self._saved: dict[Key, tuple[str, ...]] = {}
        self.reset_saved()
        self._current = dict(self._saved)

    def _key(self, register: int, port: int | None = None) -> Key:
        return register, (port or self.port) if REGISTERS[register].ports else 0

    def __contains__(self, register: int) -> bool:
        return self._key(register) in self._current

    def read(self, register: int, port: int | None = None) -> tuple[str, ...]:
        """Return the fields of a register; of the active port unless another one is given."""
        return self._current[self._key(register, port)]

    def numbers(self, register: int) -> list[int]:
        """Return the values of a register of whole numbers."""
        return [int(text) for text in self.read(register)]

    def write(self, register: int, values: Sequence[str], port: int | None = None) -> None:
        """Replace the fields of a register; the caller has validated them."""
        self._current[self._key(register, port)] = tuple(values)

    def with_values(self, register: int, values: Sequence[str], port: int | None) -> RegisterFile:
        """Return the register file as it would be after `write`."""
        other = RegisterFile(self.port)
        other._current = {**self._current, self._key(register, port): tuple(values)}
        return other

    def save(self) -> None:
        """Keep the current values over the next reset."""
        self._saved = dict(self._current)

    def load_saved(self) -> None:
        """Return to the saved values, as a reset does."""
        self._current = dict(self._saved)

    def reset_saved(self) -> None:
        """Replace the saved values by the factory values; they apply after the next reset."""
        self._saved = {
            (register.id, port): register.factory_values
            for register in REGISTERS.values()
            if register.access == "setting"
            for port in ((1, 2) if register.ports else (0,))
        }
