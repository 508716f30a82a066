"""`imumon explain`: every word that a user meets has at most three sentences and a page that exists."""

from __future__ import annotations

import re

import pytest
from paths import ROOT

from imumon.cli.exit_codes import SUCCESS, USAGE
from imumon.cli.explain_command import errors_listed
from imumon.cli.main import main
from imumon.model.coefficients import COEFFICIENTS, STATUSES
from imumon.model.glossary import explain, explanations
from imumon.model.messages import CAVEATS


def test_every_word_has_at_most_three_sentences_and_a_page() -> None:
    for entry in explanations():
        most = 5 if entry.word in CAVEATS else 3
        assert len(re.findall(r"[.?!](?: |$)", entry.text)) <= most, entry.word
        assert (ROOT / entry.page).is_file(), entry.word


@pytest.mark.parametrize(
    "word", [*CAVEATS, *STATUSES, *COEFFICIENTS, "open", "×÷", "alias factor", "Not At Rest"]
)
def test_what_the_screen_shows_is_explained(word: str) -> None:
    assert explain(word) is not None


def test_the_command_prints_a_word_or_names_a_close_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "misfit"]) == SUCCESS
    assert capsys.readouterr().out.startswith("misfit: ")
    assert main(["explain", "mistfit"]) == USAGE
    assert "did you mean misfit?" in capsys.readouterr().err
    assert main(["explain"]) == SUCCESS
    assert "walk" in capsys.readouterr().out


def test_the_code_of_each_error_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "port_busy"]) == SUCCESS
    text = capsys.readouterr().out
    assert "port_busy" in text
    assert "What to do:" in text
    assert "docs/ERRORS.md" in text
    assert main(["explain", "port_buzy"]) == USAGE
    assert "did you mean port_busy?" in capsys.readouterr().err
    listed = list(errors_listed())
    assert len({code for codes, _, _ in listed for code in codes}) > 150
    assert all(codes and cause and cure for codes, cause, cure in listed)
