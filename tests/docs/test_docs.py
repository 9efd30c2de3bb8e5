"""The documentation builds without warnings and without network, and its examples are true."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def sphinx(builder: str, out: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", builder, "-d", str(out / "trees")]
    done = subprocess.run([*command, str(DOCS), str(out / builder)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sphinx", reason="Sphinx is not installed (extra labdaemon[docs])")
    out = tmp_path_factory.mktemp("docs")
    sphinx("html", out)
    return out


@pytest.mark.slow
def test_builds_without_warnings_and_shows_the_model(built: Path) -> None:
    page = (built / "html" / "explanation" / "method.html").read_text(encoding="utf-8")
    assert "Y = H * F + N" in page
    assert "J_0" in page


@pytest.mark.slow
def test_pages_load_nothing_from_the_network(built: Path) -> None:
    for page in (built / "html").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=\"(https?:)?//", text), page


@pytest.mark.slow
def test_examples_are_true(built: Path) -> None:
    sphinx("doctest", built)
