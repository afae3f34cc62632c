"""A readable duration."""


def duration(seconds: float) -> str:
    """Seconds as a readable duration.

    >>> duration(0.0), duration(12.5), duration(5400.0), duration(200000.0)
    ('-', '12.5 s', '1 h 30 min', '2 d 7 h 33 min')
    """
    if seconds < 60.0:
        return f"{seconds:.3g} s" if seconds else "-"
    minutes = round(seconds / 60.0)
    parts = ((minutes // 1440, "d"), (minutes // 60 % 24, "h"), (minutes % 60, "min"))
    return " ".join(f"{count} {unit}" for count, unit in parts if count)
