"""Python words: names of options in messages, as a program writes them.

Errors, remarks and cures are those of the command line, because both go one way. A program that reads ``--rate 200``
has no such option: its argument is ``rate_hz=200``.

>>> python_words("give the sample rate with --rate, or name one with --map t=COLUMN:UNIT")
'give the sample rate with rate_hz=, or name one with columns={"t": "COLUMN:UNIT"}'
>>> python_words("--map 'gyro/x=w x:deg/s,gyro/y=w y:deg/s' --where sensor=4 --rate 100")
'columns={"gyro/x": "w x:deg/s", "gyro/y": "w y:deg/s"} where={"sensor": "4"} rate_hz=100'
>>> python_words("use --sensor gyro, or --map gyro/x=wx:deg/s,...; not --no-guards")
'use sensor="gyro", or columns={"gyro/x": "wx:deg/s", ...}; not guards=False'
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from imumon.errors import ImumonError

ARGUMENTS = {
    "--rate": "rate_hz", "--map": "columns", "--topic": "topic", "--sensor": "sensor", "--stream": "stream",
    "--filter": "filter", "--baseline": "baseline", "--datasheet": "datasheet",
    "--horizon": "horizon_s", "--where": "where", "--msg": "msg",
}  # fmt: skip
"""Arguments of `imumon.analyse` and of `Measurement.filter`, by the option of a command."""

FLAGS = {"--no-guards": "guards=False"}
"""The same of options without a value."""

NUMBERS = ("--rate", "--horizon")
"""Options whose value is a number."""

_MAP = re.compile(r"--(?:map|where) (?:'([^']*)'|(\w[\w/]*=[^\s;]*?,\.\.\.|\w[\w/]*=[^\s;]*[^\s;,.:)]))")
_VALUE = re.compile(
    r"(--(?:rate|topic|sensor|stream|filter|baseline|datasheet|horizon|msg)) "
    r"(\d[\w.@+-]*|[A-Z]{2,}\b|gyro\b|accel\b|deltas\b|uncompensated\b|compensated\b|/[\w/]+)"
)
_FLAG = re.compile("|".join(map(re.escape, FLAGS)))
_OPTION = re.compile("|".join(map(re.escape, ARGUMENTS)))


def python_words(text: str) -> str:
    """Return a text with the arguments of Python in place of the options of the commands."""
    text = _MAP.sub(lambda match: _assigned(match[0].split()[0], match[1] or match[2]), text)
    text = _VALUE.sub(lambda match: _argument(match[1], match[2]), text)
    text = _FLAG.sub(lambda match: FLAGS[match[0]], text)
    return _OPTION.sub(lambda match: f"{ARGUMENTS[match[0]]}=", text)


def _assigned(option: str, assignments: str) -> str:
    """Return the value of ``--map`` or ``--where`` as a dict."""
    parts = []
    for assignment in assignments.split(","):
        channel, equals, column = assignment.partition("=")
        parts.append(f'"{channel}": "{column}"' if equals else channel)
    return f"{ARGUMENTS[option]}={{{', '.join(parts)}}}"


def _argument(option: str, value: str) -> str:
    return f"{ARGUMENTS[option]}={value}" if option in NUMBERS else f'{ARGUMENTS[option]}="{value}"'


@contextmanager
def python_wording() -> Iterator[None]:
    """Let errors name the arguments of a call."""
    try:
        yield
    except ImumonError as error:
        message, cure = python_words(error.message), python_words(error.cure)
        if (message, cure) == (error.message, error.cure):
            raise
        error.message, error.cure = message, cure
        error.args = (f"{message}: {cure}" if cure else message,)
        raise
