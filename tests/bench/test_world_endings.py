"""One hang of the bench's own daemon; the whole list is `labdaemon bench world`'s."""

from __future__ import annotations

import pytest

from labdaemon.bench.world import endings
from labdaemon.bench.world.row import WorldOptions


@pytest.mark.slow
def test_a_hang_leaves_a_table_at_rest_and_nothing_lost(monkeypatch):
    kept = {name: endings.ENDINGS[name] for name in ("hung event loop",)}
    monkeypatch.setattr(endings, "ENDINGS", kept)
    monkeypatch.setattr(endings, "QUICK", 1)
    *found, last = endings.rows(WorldOptions(quick=True))
    assert [row.what for row in found] == list(kept)
    assert not any("inf" in row.result for row in found)  # limits of seconds are the bench's; here the machine is busy
    assert last.holds, last.result
