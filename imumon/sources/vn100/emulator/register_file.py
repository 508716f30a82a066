"""Register file of the emulated device: current values by register, and the values after the next reset.

Values are text, as on the wire. Registers 5 to 7, which a sensor has for each of its two serial ports, exist once: for
the port that is the pseudo-terminal.
"""

from __future__ import annotations

from imumon.sources.vn100.registers import REGISTERS


class RegisterFile(dict[int, tuple[str, ...]]):
    """Registers of one device."""

    def __init__(self) -> None:
        self.reset_saved()
        self.load_saved()

    def numbers(self, register: int) -> list[int]:
        """Return the values of a register of whole numbers."""
        return [int(text) for text in self[register]]

    def save(self) -> None:
        """Keep the current values over the next reset."""
        self._saved = dict(self)

    def load_saved(self) -> None:
        """Return to the saved values, as a reset does."""
        self.update(self._saved)

    def reset_saved(self) -> None:
        """Replace the saved values by the factory values; they apply after the next reset."""
        settings = (register for register in REGISTERS.values() if register.access == "setting")
        self._saved = {register.id: register.factory_values for register in settings}
