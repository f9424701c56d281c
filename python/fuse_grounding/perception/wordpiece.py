"""Text into the pieces of words that BERT's uncased vocabularies are made of.

Lower case, accents off, cut at white space and around punctuation; then each word from left to right into the
longest pieces that the vocabulary has (inner pieces begin with `##`), or `[UNK]` where that fails. A
vocabulary may have whole phrases, too (`water bottle`): the longest run of words that is one comes first.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence

UNKNOWN = "[UNK]"
LONGEST_WORD = 100
"""Characters; a longer word is unknown, as in BERT."""
MOST_PIECES = 64
"""What comes later in a text is left out: a label is short."""


class WordPiece:
    """A vocabulary and how texts are cut by it; an id is a place in `vocabulary`."""

    def __init__(self, vocabulary: Sequence[str]):
        self._ids = {piece: i for i, piece in enumerate(vocabulary)}
        self._unknown = self._ids[UNKNOWN]
        self._longest = max(piece.count(" ") for piece in vocabulary) + 1

    def ids(self, text: str) -> list[int]:
        """The pieces of a text, at most 64 of them; none for a text without a visible character."""
        found: list[int] = []
        left = words(text)
        while left and len(found) < MOST_PIECES:
            count, ids = self._first(left)
            found += ids
            left = left[count:]
        return found[:MOST_PIECES]

    def _first(self, left: list[str]) -> tuple[int, list[int]]:
        """How many of the words come first, and their pieces."""
        for count in range(min(self._longest, len(left)), 1, -1):
            if (phrase := self._ids.get(" ".join(left[:count]))) is not None:
                return count, [phrase]
        return 1, self._pieces(left[0])

    def _pieces(self, word: str) -> list[int]:
        if len(word) > LONGEST_WORD:
            return [self._unknown]
        found, start = [], 0
        while start < len(word):
            prefix = "##" if start else ""
            for end in range(len(word), start, -1):
                if (piece := self._ids.get(prefix + word[start:end])) is not None:
                    found.append(piece)
                    start = end
                    break
            else:
                return [self._unknown]
        return found


def words(text: str) -> list[str]:
    """Lower-case words and single punctuation marks. `_` counts as a space: labels are written with it."""
    plain = unicodedata.normalize("NFD", text.replace("_", " ").lower())
    spaced = []
    for character in plain:
        category = unicodedata.category(character)
        if category in ("Mn", "Cc", "Cf") and not character.isspace():
            continue
        spaced.append(f" {character} " if _stands_alone(character, category) else character)
    return "".join(spaced).split()


def _stands_alone(character: str, category: str) -> bool:
    """Punctuation (ASCII symbols are some), and ideographs, which are words of their own."""
    ascii_symbol = character.isascii() and not character.isalnum() and not character.isspace()
    return ascii_symbol or category.startswith("P") or "\u4e00" <= character <= "\u9fff"
