"""Printed texts are the same if their words are, and their numbers within a margin."""

import re

NUMBER = re.compile(r"-{3,}|[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
# By this many units of its last digit a number may be off on another machine.
DIGITS = 2


def words(text):
    return NUMBER.sub("#", text).split()


def differences(printed, shown, tolerance=0.0, of_counts=0.0):
    """Return the pairs of numbers that differ by more than a tolerance and the last digits.

    Arguments:
        printed, shown: two texts, with the same words between the numbers.
        tolerance, of_counts: relative to each number with a point, and to each integer.
    """
    pairs = zip(*(NUMBER.findall(text) for text in (printed, shown)), strict=True)
    numbers = [(one, other) for one, other in pairs if not other.startswith("---")]

    def margin(text):
        last = digit(text)
        return (tolerance if last else of_counts) * abs(float(text)) + DIGITS * last

    return [(x, y) for x, y in numbers if abs(float(x) - float(y)) > margin(y)]


def digit(text):
    """Return the size of the last digit of a number, zero for an integer."""
    mantissa, _, exponent = text.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 1.01 * 10.0 ** (int(exponent or 0) - decimals) if "." in text or exponent else 0
