from __future__ import annotations

import json

import pytest

from labdaemon.clock import SystemClock
from labdaemon.journal.journal import Journal
from labdaemon.plain_json import dump_json, plain_text


@pytest.mark.parametrize("value", [1, "a", "é", "\U0001f600", "\\ud800", {"a": ["\U0001f600", None, 1.5]}])
def test_text_stays_as_it_is(value: object):
    assert json.loads(dump_json(value)) == value


def test_halves_of_pairs_are_spelled_out():
    assert json.loads(dump_json({"\udcff": ["a\ud800b"]})) == {"\\udcff": ["a\\ud800b"]}
    assert plain_text("d\udcff") == "d\\udcff"
    with pytest.raises(ValueError, match="Out of range"):
        dump_json(float("nan"))


def test_the_journal_takes_names_that_are_no_text(tmp_path):
    journal = Journal(tmp_path, SystemClock())
    with journal.transaction("t") as write:
        write.execute("INSERT INTO meta VALUES (?, ?)", "k\udcff", "v\ud800")
        write.emit("fault", None, {"message": "/data/\udcff: is full"})
    assert journal.read("SELECT value FROM meta WHERE key = ?", "k\udcff") == [("v\\ud800",)]
    [text] = journal.recent(0, 10, 1000)
    assert json.loads(text.json)["data"] == {"message": "/data/\\udcff: is full"}
    journal.close()
