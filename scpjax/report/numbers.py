"""Numbers as people write them."""

from __future__ import annotations

import math

_STUCK = 1e-7
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """``digits`` significant digits, powers of ten where plain digits would be long: 0.0123, 4.5 × 10⁻⁷."""
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}".replace("-", "−")
    return _power(value, exponent, digits - 1)


def plus_minus(value: float, std: float) -> str:
    """Value and standard error to two digits of the error: 4.21 ± 0.13, (4.2 ± 1.3) × 10⁻⁷."""
    if not (math.isfinite(std) and std > 0):
        return number(value, 4)
    if std > 100 * abs(value):
        return f"{number(value)} (open)"
    lead = math.floor(math.log10(float(f"{std:.1e}")))
    size = math.floor(math.log10(max(abs(value), std)))
    if -4 <= size < 6 and lead >= -8:
        places = max(1 - lead, 0)
        return f"{value:.{places}f} ± {std:.{places}f}".replace("-", "−")
    places = max(1 + size - lead, 0)
    scale, power = 10.0**size, str(size).translate(_SUPERSCRIPT)
    text = f"({value / scale:.{places}f} ± {std / scale:.{places}f}) × 10{power}"
    return text.replace("-", "−")


def estimate(value: float, std: float, low: float, high: float, at_limit: bool = False) -> str:
    """``value ± std``; for a positive quantity known within no better than a factor, only about what."""
    if at_limit:
        return f"{number(value, 4)}, at its limit"
    if low > 0 and high > 9 * low:
        return f"about {number(float(f'{value:.1e}'), 2)}"
    return plus_minus(value, std)


def interval(low: float, high: float, at_limit: bool = False) -> str:
    """``4.0 to 4.4``, with digits enough to tell the ends apart; none of what stands at a limit, where the data would
    go on.
    """
    width = abs(high - low)
    if at_limit or width < 2 * _STUCK * max(abs(low), abs(high)):
        return "–"
    digits = 3
    if math.isfinite(width) and width > 0:
        biggest = max(abs(low), abs(high))
        digits = min(max(math.floor(math.log10(biggest / width)) + 2, 3), 8)
    return f"{number(low, digits)} to {number(high, digits)}"


def percent(share: float) -> str:
    """``0.037`` as ``3.7 %``; never 100 % for what is only near."""
    if not math.isfinite(share):
        return "–"
    if 0.995 < share <= 1:
        return "> 99 %"
    if 0 < share < 0.005:
        return "< 1 %"
    return f"{100 * share:.0f} %"


def unit(text: str) -> str:
    """A unit for the eye: nothing for ``1``."""
    return "" if text in ("1", "") else text.replace("degC", "°C").replace("ohm", "Ω").replace("_per_", "/")


def column(name: str) -> tuple[str, str]:
    """(words, unit) of a file column: ``temperature_agonist_degC`` is ``Temperature agonist``, ``°C``."""
    from scpjax.errors import ScpjaxError
    from scpjax.units import parse_column

    try:
        stem, u = parse_column(name, allow_unknown=True)
    except ScpjaxError:
        return name.replace("_", " "), ""
    words = stem.replace("_", " ")
    suffix = {"degC": "°C", "deg": "°", "pct": "%", "ohm": "Ω", "pwm": "counts"}.get(u.suffix, u.suffix)
    return words[:1].upper() + words[1:], suffix


def _power(value: float, exponent: int, places: int) -> str:
    text = f"{value / 10.0**exponent:.{places}f} × 10{str(exponent).translate(_SUPERSCRIPT)}"
    return text.replace("-", "−")
