"""Schema of the history: its tables and their version, which is the ``PRAGMA user_version`` of a file.

Version 2 is the first that was released. A later one must bring the files of this one up to date. What is added to a
file of version 2 when it is opened for writing, older programs ignore: columns for further coefficients. A column
``checksum`` of an earlier program is not used.
"""

from __future__ import annotations

from imumon.model.coefficients import BIAS_SLOPE, COEFFICIENTS

SCHEMA = """
CREATE TABLE channel (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE);
CREATE TABLE period (
    id INTEGER PRIMARY KEY,
    step INTEGER NOT NULL,      -- s
    record TEXT NOT NULL,       -- when the record began
    number INTEGER NOT NULL,    -- of the period in its record
    begin REAL NOT NULL,        -- s since 1970
    end REAL NOT NULL,
    complete INTEGER NOT NULL,
    samples INTEGER NOT NULL,
    missing INTEGER NOT NULL,
    excluded_s REAL NOT NULL,
    temperature REAL,           -- degC
    warming_up INTEGER NOT NULL,
    UNIQUE (step, record, number)
);
CREATE INDEX period_time ON period (step, begin);
CREATE INDEX period_open ON period (step) WHERE complete = 0;
CREATE TABLE noise (
    period INTEGER NOT NULL,
    channel INTEGER NOT NULL,
    mean REAL, std REAL, grade INTEGER,
    PRIMARY KEY (period, channel)
) WITHOUT ROWID;
CREATE TABLE event (
    id INTEGER PRIMARY KEY,
    time REAL NOT NULL,         -- s since 1970, of the first
    kind TEXT NOT NULL,
    channel TEXT,
    text TEXT NOT NULL,         -- of the first
    count INTEGER NOT NULL      -- of this kind and channel within 10 minutes
);
CREATE INDEX event_time ON event (time);
CREATE TABLE power_up (
    id INTEGER PRIMARY KEY,
    time REAL NOT NULL,         -- s since 1970
    clock_s REAL NOT NULL,      -- s since the power-up, when it was last seen
    seen REAL NOT NULL,         -- s since 1970, when it was last seen
    settled INTEGER NOT NULL    -- whether turn_on has its bias
);
CREATE TABLE turn_on (
    power_up INTEGER NOT NULL,
    channel INTEGER NOT NULL,
    mean REAL NOT NULL,         -- channel unit, once settled
    PRIMARY KEY (power_up, channel)
) WITHOUT ROWID;
"""
VERSION = 2

ESTIMATE_COLUMNS = {
    letter: tuple(f"{letter.lower()}{part}" for part in ("", "_low", "_high", "_status"))
    for letter in (*COEFFICIENTS, BIAS_SLOPE)
}
"""Columns of ``noise`` by letter. A file that does not have some of them gets them when it is opened for writing."""
