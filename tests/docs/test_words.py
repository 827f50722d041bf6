"""The words of the README and of the documentation: none of some phrases."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BANNED = re.compile(
    r"\bwhat is (done|found|known|said)\b|\bwhat was (done|found|seen)\b"
    r"|(?<!outside )of which nothing\b|\bsuch as is\b|\bwithout a word\b|\bmakes something of\b"
    r"|\bnowhere in particular\b|\bis rid of\b|\bdraws? (it )?off\b"
    r"|\bparts? company\b|\bwith nothing said\b|\bcounts? for nothing\b",
    re.IGNORECASE,
)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_has_none_of_some_phrases(path):
    text = path.read_text()
    assert [match.group() for match in BANNED.finditer(" ".join(text.split()))] == []
