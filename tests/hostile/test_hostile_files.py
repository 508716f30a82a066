"""Files that somebody made to harm: an error or a normal read, in bounded time and memory."""

from __future__ import annotations

import json
import os
import random
import threading
from pathlib import Path

import pytest
from corpus_messages import SAVED
from corpus_recordings import RECORDINGS, SETTINGS, capture, table
from damage import OWN_PROCESS, SAMPLES, damaged, read_damaged
from hostile_input import Hostile, file, go_through, little_memory, printable, rows
from paths import ROOT
from tables import read

from imumon.api.replay_options import ReplayOptions
from imumon.config import ConfigError, load


@pytest.mark.timeout(150)
@pytest.mark.parametrize("hostile", rows((*RECORDINGS, *SETTINGS, *SAVED)))
def test_a_hostile_file_does_what_the_corpus_says(hostile: Hostile, tmp_path: Path) -> None:
    go_through(hostile, tmp_path)


# ---------------------------------------------------------------------- random damage


@pytest.mark.few
@pytest.mark.parametrize("kind", SAMPLES)
def test_a_damaged_recording_is_an_error_or_is_read(tmp_path: Path, kind: str) -> None:
    with little_memory(2 << 30):
        read_damaged(SAMPLES[kind](tmp_path), range(2 if kind in OWN_PROCESS else 30))


def test_damaged_settings_are_faults_or_are_read(tmp_path: Path) -> None:
    data = (ROOT / "config.toml").read_bytes()
    path = tmp_path / "config.toml"
    for seed in range(150):
        path.write_bytes(damaged(random.Random(seed), data))
        try:
            load(path)
        except ConfigError as error:
            printable(str(error))


# ---------------------------------------------------------------------- more than one file or process


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    data = table(tmp_path).read_bytes()
    os.mkfifo(tmp_path / "pipe.csv")
    writer = threading.Thread(target=(tmp_path / "pipe.csv").write_bytes, args=(data,))
    writer.start()
    assert len(read(tmp_path / "pipe.csv")) == 300
    writer.join()


def test_a_part_lies_in_the_folder_of_its_recording(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for part, name in enumerate(("in/a.bin", "b.0001.bin")):
        header = {"run": "r", "part": part, "base": "../b.bin"}
        file(name, capture(json.dumps(header).encode()))(tmp_path)
    source = ReplayOptions(path=str(tmp_path / "in/a.bin")).open()
    list(source)
    assert source.fed == 3
