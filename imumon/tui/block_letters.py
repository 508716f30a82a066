"""Letters: a headline three cells high, of half blocks."""

from __future__ import annotations

_SHAPES = {
    "A": (".#.", "#.#", "###", "#.#", "#.#"),
    "C": ("###", "#..", "#..", "#..", "###"),
    "D": ("##.", "#.#", "#.#", "#.#", "##."),
    "E": ("###", "#..", "##.", "#..", "###"),
    "G": ("###", "#..", "#.#", "#.#", "###"),
    "I": ("#", "#", "#", "#", "#"),
    "L": ("#..", "#..", "#..", "#..", "###"),
    "M": ("#...#", "##.##", "#.#.#", "#...#", "#...#"),
    "N": ("#..#", "##.#", "#.##", "#..#", "#..#"),
    "O": ("###", "#.#", "#.#", "#.#", "###"),
    "R": ("##.", "#.#", "##.", "#.#", "#.#"),
    "S": ("###", "#..", "###", "..#", "###"),
    "T": ("###", ".#.", ".#.", ".#.", ".#."),
    "U": ("#.#", "#.#", "#.#", "#.#", "###"),
    "V": ("#.#", "#.#", "#.#", "#.#", ".#."),
}
"""The letters that occur in names of grades, five dots high."""

_BLOCK = {"..": " ", "#.": "▀", ".#": "▄", "##": "█"}


def headline(word: str) -> list[str]:
    """Three rows of cells that spell a word; one with a letter that has no shape stands as it is.

    >>> headline("it"), headline("x")
    (['█ ▀█▀', '█  █ ', '▀  ▀ '], ['', 'X', ''])
    """
    if not set(word.upper()) <= set(_SHAPES):
        return ["", word.upper(), ""]
    shapes = [_SHAPES[letter] for letter in word.upper()]
    dots = [".".join(shape[row] for shape in shapes) for row in range(5)]
    dots.append("." * len(dots[0]))
    return ["".join(_BLOCK[a + b] for a, b in zip(dots[r], dots[r + 1], strict=True)) for r in (0, 2, 4)]
