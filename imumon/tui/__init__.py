"""Terminal UI: draws reports, computes nothing.

tui            entry: `run` on a terminal
app            the application: polls the source of reports, owns the state, handles keys
view_state     everything that the screen shows at one moment
views          the six views and the dialog windows
widgets        widgets that draw lines in the colours of the theme
panels         status line, footer, headline grades, selected channel, welcome
text_panels    device, events, sensors, drift
channel_table  table of all channels
charts         Allan deviation, signal, histogram, spectrum
over_time      coefficients while the record grew, and the history
braille_canvas numbers in, character cells out
formatting     numbers as text of limited width
export         the saved report, and numbers for other programs
terminal       what the screen needs of the terminal
web            the screen in a browser
"""

from imumon.tui.tui import run

__all__ = ["run"]
