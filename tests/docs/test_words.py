"""The words of the README and of the documentation: short sentences, and none of some phrases."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^(```|:::).*?^\1\s*$", re.DOTALL | re.MULTILINE)
# Formulas and code count as a word, addresses as none.
WORDS = [(re.compile(r"\$[^$]*\$|`[^`]*`"), "x"), (re.compile(r"\]\([^)]*\)"), "]")]
BANNED = re.compile(
    r"\bwhat is (done|found|known|said)\b|\bwhat was (done|found|seen)\b"
    r"|(?<!outside )of which nothing\b|\bsuch as is\b|\bwithout a word\b|\bmakes something of\b"
    r"|\bnowhere in particular\b|\bis rid of\b|\bdraws? (it )?off\b"
    r"|\bparts? company\b|\bwith nothing said\b|\bcounts? for nothing\b",
    re.IGNORECASE,
)


def sentences(text):
    """The sentences of a page, without tables, headings and code."""
    for part in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.)\s)", BLOCK.sub("", text)):
        lines = [line for line in part.splitlines() if line[:1] not in set("|#%(:")]
        for sentence in re.split(r"(?<=[.!?])[)\"*]*\s+(?=[^a-z])", "\n".join(lines)):
            yield " ".join(sentence.split())


def count(sentence):
    for pattern, word in WORDS:
        sentence = pattern.sub(word, sentence)
    return len(re.findall(r"[A-Za-z][\w'-]*", sentence))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_no_sentence_of_a_page_is_long_or_has_a_banned_phrase(path):
    text = path.read_text()
    assert [sentence for sentence in sentences(text) if count(sentence) > 35] == []
    assert [match.group() for match in BANNED.finditer(" ".join(text.split()))] == []


def test_a_sentence_has_16_words_on_average():
    numbers = [count(sentence) for path in PAGES for sentence in sentences(path.read_text())]
    numbers = [number for number in numbers if number > 2]
    assert len(numbers) > 500
    assert sum(numbers) / len(numbers) <= 16
