"""Daemon: read a device, feed the record, publish and save.

daemon         the loop
connection     what is known of the device: identity, state, silence
keeper         what keeps the record: state, history, recording
outputs        where reports and events go: log, bus, ROS 2, alert command
run_limits     what to run, what ends it, how long a device may be silent, when a duty is due
persistence    the record on disk: restored, saved, set aside
recorder       the raw bytes on disk
alert_command  a command of the user that runs at warnings
log            standard error: text, journal or JSON
sd_notify      the service manager

Threads of a daemon, and what happens if one is slow:

read PORT                            port → queue of bytes, nothing else: a Linux tty holds 4 kB, 44 ms at 921600 baud
imumon-device                        runs the device; its items go to a bounded queue; if it is slow, the queue of
                                     bytes drops and counts
main                                 the loop: takes items, feeds, reports, publishes, saves; owns the clock; if it is
                                     slow, the item queue blocks the device
checkpoint                           writes one state; there is one thread per save; if it is slow, the next save
                                     waits
record FILE                          writes the recording; if it is slow, the recording ends
history                              writes the history; if it is slow, rows wait
imumon-bus                           sends reports and events; if it is slow, the newest report replaces the one that
                                     waits; the oldest events are dropped
imumon-uplink                        one per router: connects until it succeeds, then ends; if it is slow, later
                                     messages reach that router late
imumon-listener                      one per session: answers queries; if it is slow, older queries get no reply
imumon-bus-close                     closes the sessions at the end; if it is slow, the daemon ends without it
imumon-ros2, imumon-ros2-covariance  publish reports and messages in ROS 2, if configured; if it is slow, the newest
                                     report replaces the one that waits
imumon-alert                         runs the alert command; if it is slow, events wait, then are counted
log                                  writes lines to standard error; if it is slow, lines are dropped and counted
one without a name                   with `--stop-with-stdin`: ends the run when standard input ends

Threads of other commands:

imumon-listener, imumon-request           of a subscriber: take messages; request the signal and the history
                                          that are shown
terminal                                  of the screen: ends it when its terminal, or the server of the browser, is
                                          gone
those of prometheus_client                of `imumon metrics`: one for each connection, answers from the newest
                                          reports
two without a name                        begin and draw the progress bar

Zenoh has threads of its own; none of them runs code of imumon. What a thread shares with others is a queue, or fields
under one lock that the class names.
"""

from imumon.daemon.daemon import Daemon
from imumon.daemon.run_limits import RunOptions, RunResult

__all__ = ["Daemon", "RunOptions", "RunResult"]
