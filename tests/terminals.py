"""A terminal for tests that need a real one: a tmux server with the screen in its pane."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
ENVIRONMENT = {**os.environ, "TERM": "xterm-256color", "LANG": "C.UTF-8", "PYTHONPATH": str(HERE.parent)}


class Tmux:
    """A separate tmux server with one pane that runs the screen."""

    def __init__(self, socket: Path, command: str, size: tuple[int, int] = (150, 40)) -> None:
        self._base = ["tmux", "-S", str(socket)]
        run = f"{command}; echo EXIT=$?; exec cat"
        environment = [part for k in ("LANG", "PYTHONPATH") for part in ("-e", f"{k}={ENVIRONMENT[k]}")]
        where = ["-x", str(size[0]), "-y", str(size[1])]
        self.command("-f", "/dev/null", "new-session", "-d", *environment, *where, "sh", "-c", run)

    def command(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self._base, *arguments], capture_output=True, text=True, check=True, timeout=20
        )
        return done.stdout

    def text(self) -> str:
        return self.command("capture-pane", "-p")

    def flag(self, name: str) -> str:
        return self.command("display-message", "-p", f"#{{{name}}}").strip()

    def press(self, *keys: str) -> None:
        self.command("send-keys", *keys)

    def screen(self) -> int:
        """Process of the screen in the pane."""
        shell = int(self.flag("pane_pid"))
        children = Path(f"/proc/{shell}/task/{shell}/children").read_text().split()
        return int(children[0])

    def close(self) -> None:
        subprocess.run([*self._base, "kill-server"], capture_output=True, check=False, timeout=20)
