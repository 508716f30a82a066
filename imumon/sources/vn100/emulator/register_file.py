"""Register file of the emulated device: current values, and the values after the next reset.

Values are text, as on the wire. Registers 5 to 7, which a sensor has for each of its two serial ports, exist once: for
the port that is the pseudo-terminal.
"""

from __future__ import annotations

from collections.abc import Sequence

from imumon.sources.vn100.registers import REGISTERS


class RegisterFile:
    """Registers of one device."""

    def __init__(self) -> None:
        self._saved: dict[int, tuple[str, ...]] = {}
        self.reset_saved()
        self._current = dict(self._saved)

    def __contains__(self, register: int) -> bool:
        return register in self._current

    def read(self, register: int) -> tuple[str, ...]:
        """Return the fields of a register."""
        return self._current[register]

    def numbers(self, register: int) -> list[int]:
        """Return the values of a register of whole numbers."""
        return [int(text) for text in self.read(register)]

    def write(self, register: int, values: Sequence[str]) -> None:
        """Replace the fields of a register; the caller has validated them."""
        self._current[register] = tuple(values)

    def save(self) -> None:
        """Keep the current values over the next reset."""
        self._saved = dict(self._current)

    def load_saved(self) -> None:
        """Return to the saved values, as a reset does."""
        self._current = dict(self._saved)

    def reset_saved(self) -> None:
        """Replace the saved values by the factory values; they apply after the next reset."""
        self._saved = {
            register.id: register.factory_values
            for register in REGISTERS.values()
            if register.access == "setting"
        }
